"""A CSV file that grows frame by frame: continued wherever it was cut, by one process, with one set of settings."""

from __future__ import annotations

import multiprocessing
import os
from pathlib import Path
from typing import Any

import pytest

from rootmatch.errors import InputError
from rootmatch.io.appended_table import AppendedTable

HEADER = ("frame", "source", "target")
FRAMES: dict[int, list[list[Any]]] = {
    0: [[0, "a", 1], [0, "b,c", 2]],
    1: [[1, "", ""]],
    3: [[3, "a", 0], [3, 'q"', 1], [3, "λ", 2]],
    12: [[12, "a", 4], [12, "b", 5]],
}
SETTINGS = {"--noise": "0.5", "--seed": "0"}


def written(path: Path, *, resume: bool = False, settings: dict[str, str] | None = SETTINGS) -> set[int]:
    """Write the frames that are not done, and say which were."""
    table = AppendedTable(path, HEADER, settings, resume)
    for frame, rows in FRAMES.items():
        if frame not in table.done:
            table.write(rows)
    table.close()
    return table.done


def test_a_file_cut_anywhere_is_continued_to_the_same(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    written(path)
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for cut in range(len(whole) + 1):
        path.write_bytes(whole[:cut])
        done = written(path, resume=True)
        assert path.read_bytes() == whole, f"cut at byte {cut}"
        complete = [frame for frame in FRAMES if len(b"".join(lines[: ends_of(frame)])) <= cut]
        assert done <= set(complete)
        assert len(done) >= len(complete) - 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["m.csv", "m.csv.settings.json"]


def ends_of(frame: int) -> int:
    """Number of lines up to the last one of a frame."""
    return 1 + sum(len(rows) for k, rows in FRAMES.items() if k <= frame)


@pytest.mark.parametrize("there", [b"", b"frame,sou", b"frame,source,target\n"])
def test_a_file_without_rows_is_begun_anew(tmp_path: Path, there: bytes) -> None:
    path = tmp_path / "m.csv"
    path.write_bytes(there)
    assert written(path) == set()
    with pytest.raises(InputError, match="it already exists"):
        written(path)


def test_no_file_is_left_where_no_row_was_written(tmp_path: Path) -> None:
    AppendedTable(tmp_path / "m.csv", HEADER, SETTINGS).close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"--noise": "0.3", "--seed": "0"}, r"--noise: '0\.3' given, but the file was begun with '0\.5'"),
        ({"--noise": "0.5"}, "--seed: None given"),
        ({**SETTINGS, "--rho": "2"}, "--rho: '2' given, but the file was begun with None"),
    ],
)
def test_other_settings_are_not_mixed_in(tmp_path: Path, settings: dict[str, str], says: str) -> None:
    path = tmp_path / "m.csv"
    written(path)
    before = path.read_bytes()
    with pytest.raises(InputError, match=says):
        written(path, resume=True, settings=settings)
    assert path.read_bytes() == before
    (tmp_path / "m.csv.settings.json").write_bytes(b"\xff")
    with pytest.raises(InputError, match="are missing or cannot be read"):
        written(path, resume=True)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"\n", "row 3: '' is not a row of a frame"),
        (b"x,a,1\n", "row 3: 'x,a,1' is not a row"),
        (b"-1,a,1\n", "is not a row"),
        (b"2\n", "is not a row"),
        (b"1" * 5000 + b",a,1\n", "is not a row"),
        (b"2,\xff,1\n", "is not a row"),
        ("٣,a,1\n".encode(), "is not a row"),
        (b"0,a,1\n0,a,1\n", "row 5: frame 0 after frame 1"),
    ],
)
def test_rows_of_another_kind_are_refused(tmp_path: Path, line: bytes, says: str) -> None:
    path = tmp_path / "m.csv"
    written(path)
    lines = path.read_bytes().splitlines(keepends=True)
    spoilt = lines[0] + lines[1] + (lines[3] + line if line.startswith(b"0") else line) + lines[2]
    path.write_bytes(spoilt)
    with pytest.raises(
        InputError, match=says if not line.startswith(b"0") else "row 4: frame 0 after frame 1"
    ) as caught:
        written(path, resume=True)
    assert len(str(caught.value)) < 200 + len(str(path))
    assert path.read_bytes() == spoilt
    path.write_bytes(b"x,y\n1,2\n")
    with pytest.raises(InputError, match="its header is not frame,source,target"):
        written(path, resume=True)


def held(path: str, begun: Any, end: Any) -> None:
    table = AppendedTable(Path(path), HEADER, SETTINGS)
    table.write(FRAMES[0])
    begun.set()
    end.wait(30)
    table.close()


@pytest.mark.skipif(os.name == "nt", reason="no lock there")
def test_two_processes_do_not_write_one_file(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    context = multiprocessing.get_context("fork")
    begun, end = context.Event(), context.Event()
    other = context.Process(target=held, args=(str(path), begun, end))
    other.start()
    assert begun.wait(30)
    (tmp_path / "link.csv").symlink_to(path)
    for name in ("m.csv", "link.csv"):
        with pytest.raises(InputError, match="another process is writing to it"):
            written(tmp_path / name, resume=True)
    end.set()
    other.join()
    assert written(path, resume=True) == set()


def test_a_pipe_gets_the_rows_and_cannot_be_continued(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with pytest.raises(InputError, match="this file cannot be continued"):
        written(path, resume=True)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    written(path)
    assert os.read(reader, 10_000).startswith(b"frame,source,target\n0,a,1\n")
    os.close(reader)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_reported_of_the_file() -> None:
    table = AppendedTable(Path("/dev/full"), HEADER)
    with pytest.raises(InputError, match=r"/dev/full: cannot be written \(No space left"):
        table.write(FRAMES[0])
    table.close()
