"""What is written and printed: names are never obeyed, and whatever ends a run, files are whole and its code tells."""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from permissions import CAN_BE_BOUND, bound_by_permissions
from rootmatch.cli.app import app
from rootmatch.errors import MOST_QUOTED, InputError, printable, quoted
from rootmatch.io import folder_written_whole, write_table, written_whole
from rootmatch.report.pictures import match_figure, save_figure

PROGRAM = [sys.executable, "-c", "from rootmatch.cli import main; main()"]
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
UNIX = pytest.mark.skipif(os.name == "nt", reason="signals and limits are others there")
NAMES = ["$\\frac{", "$x^2$", "[red]a[/]", "<b>&amp;</b>", "=1+1", "]]>"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five named points against six detections: a match in milliseconds, once its kernels are there."""
    folder = tmp_path_factory.mktemp("scene")
    world = np.random.default_rng(0).uniform(-2.0, 2.0, (6, 3))
    image = 1000.0 * (world[:, :2] / (world[:, 2:] + 12.0)) + [320.0, 240.0]
    rows = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(NAMES, world.tolist(), strict=True)]
    (folder / "model.csv").write_text("\n".join(["id,x,y,z", *rows]))
    (folder / "image.csv").write_text("\n".join(["x,y", *(f"{x},{y}" for x, y in image.tolist())]))
    return folder


def arguments(scene: Path, *more: object) -> list[str]:
    files = [str(scene / "model.csv"), str(scene / "image.csv")]
    return ["match", *files, "--problem", "p3p", "--camera", "1000,1000,320,240", "--noise", "0.5", *map(str, more)]


def run(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
    options.setdefault("stdout", subprocess.PIPE)
    return subprocess.run([*PROGRAM, *command], stderr=subprocess.PIPE, text=True, check=False, **options)


def test_names_are_drawn_and_printed_as_they_are(scene: Path, tmp_path: Path) -> None:
    command = arguments(scene, "--plot", tmp_path / "m.svg", "--output", tmp_path / "m.csv")
    found = CliRunner().invoke(app, command)
    assert found.exit_code == 0, found.stderr
    drawing = (tmp_path / "m.svg").read_text(encoding="utf-8")
    for name in NAMES:
        assert name in found.stdout
        assert name in (tmp_path / "m.csv").read_text(encoding="utf-8")
    assert "<b>" not in drawing
    assert "\x1b" not in found.stdout


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_name_that_is_no_mathematics_is_drawn(tmp_path: Path, suffix: str) -> None:
    points = np.random.default_rng(1).uniform(0.0, 100.0, (6, 2))
    figure = match_figure(points, points, np.arange(6), source_names=NAMES, target_names=NAMES)
    save_figure(figure, tmp_path / f"m{suffix}")
    assert (tmp_path / f"m{suffix}").stat().st_size > 1000


def test_an_error_quotes_without_obeying() -> None:
    assert quoted("\x1b[31m\u202ered") == r"'\x1b[31m\u202ered'"
    assert printable("a\x1b[2Jb") == r"a\x1b[2Jb"
    assert len(quoted("x" * 10_000)) == MOST_QUOTED
    assert quoted(list(range(100))) == "a list of 100"
    assert quoted(10**10_000) == "a number of thousands of digits"


@UNIX
def test_a_file_name_is_no_command_to_the_terminal(tmp_path: Path) -> None:
    found = run(arguments(tmp_path / "\x1b[31mred"))
    assert found.returncode == 2
    assert "\x1b" not in found.stderr
    assert r"\x1b[31mred" in found.stderr


@UNIX
@pytest.mark.parametrize(
    "environment", [{"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}, {"COLUMNS": "20"}]
)
def test_plain_terminals(scene: Path, tmp_path: Path, environment: dict[str, str]) -> None:
    model = tmp_path / "model.csv"
    text = (scene / "model.csv").read_text(encoding="utf-8").replace("=1+1", "λ-9")
    model.write_text(text, encoding="utf-8")
    command = arguments(scene)
    command[1] = str(model)
    found = run(command, env={**os.environ, **environment, "FORCE_COLOR": "1", "NO_COLOR": "1"})
    assert found.returncode == 0, found.stderr
    shown = "".join(found.stdout.split())
    assert "matched" in shown
    assert ("λ-9" if "COLUMNS" in environment else r"\u03bb-9") in shown
    assert "\x1b[3" not in found.stdout  # no colour


@UNIX
@pytest.mark.parametrize("json_wanted", [True, False])
def test_a_reader_that_leaves_early(scene: Path, tmp_path: Path, json_wanted: bool) -> None:
    read, write = os.pipe()
    os.close(read)
    output = tmp_path / "m.csv"
    with os.fdopen(write, "w") as gone:
        found = run(arguments(scene, "--output", output, *(["--json"] if json_wanted else [])), stdout=gone)
    assert found.returncode == 141
    assert "Traceback" not in found.stderr
    assert "BrokenPipe" not in found.stderr
    assert len(output.read_text().splitlines()) == 7


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_standard_output_on_a_full_disk(scene: Path) -> None:
    with open("/dev/full", "w") as full:
        found = run(arguments(scene), stdout=full)
    assert found.returncode == 2
    assert found.stderr == "rootmatch: standard output: No space left on device; free or choose another place\n"


@UNIX
def test_a_closed_standard_output(scene: Path) -> None:
    closing = "import os, sys; os.close(1); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    command = [sys.executable, "-c", closing, *PROGRAM[1:], *arguments(scene)]
    found = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    assert (found.returncode, found.stderr) == (0, "")


@UNIX
@pytest.mark.parametrize("option", ["--output", "--plot"])
def test_a_file_on_a_full_disk(scene: Path, tmp_path: Path, option: str) -> None:
    kept = tmp_path / ("m.csv" if option == "--output" else "m.png")
    kept.write_text("as before")

    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, 20))

    found = run(arguments(scene, option, kept), preexec_fn=little_room)
    assert found.returncode == 2, found.stderr
    assert found.stderr.endswith(f"rootmatch: {kept}: cannot be written (File too large); choose another location\n")
    assert "Traceback" not in found.stderr  # where not even Numba's threads find room it warns of that
    assert kept.read_text() == "as before"
    assert list(tmp_path.iterdir()) == [kept]


@pytest.mark.skipif(not CAN_BE_BOUND, reason="nothing is read-only here")
def test_a_read_only_folder(scene: Path, tmp_path: Path) -> None:
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o500)
    found = run(arguments(scene, "--output", folder / "m.csv"), preexec_fn=bound_by_permissions)
    assert found.returncode == 2
    assert "cannot be written to" in found.stderr


def test_an_error_of_the_system_while_writing_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("as before")

    def rows() -> Any:
        yield ("a", 1)
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(InputError, match=r"cannot be written \(No space left"):
        write_table(path, ("x", "y"), rows())
    assert path.read_text() == "as before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("times", range(6))
def test_ctrl_c_at_any_statement_of_writing(tmp_path: Path, times: int) -> None:
    """An interruption at every line that runs from the first to the last of writing a file and a folder."""
    path, folder = tmp_path / "m.csv", tmp_path / "scene"
    path.write_text("as before")
    steps = 0

    def trace(frame: Any, event: str, argument: Any) -> Any:
        nonlocal steps
        if frame.f_code.co_filename.endswith("atomic_output.py") and event == "line":
            steps += 1
            if steps == stop:
                raise KeyboardInterrupt
        return trace

    for stop in range(1 + times, 60, 6):
        steps = 0
        sys.settrace(trace)
        try:
            with written_whole(path) as temporary:
                temporary.write_text("new")
            with folder_written_whole(folder) as inside:
                (inside / "model.csv").write_text("x,y")
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(None)
        assert path.read_text() in ("as before", "new")
        assert not folder.exists() or (folder / "model.csv").read_text() == "x,y"
        assert {file.name for file in tmp_path.iterdir()} <= {"m.csv", "scene"}, f"interrupted at step {stop}"
        path.write_text("as before")
        if folder.exists():
            (folder / "model.csv").unlink()
            folder.rmdir()


@UNIX
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_signals_during_the_work(scene: Path, tmp_path: Path, number: signal.Signals, code: int) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "m.csv").write_text("as before")
    rng = np.random.default_rng(0)
    for name, points in (("model.csv", rng.normal(size=(40, 3))), ("image.csv", rng.uniform(0, 480, (40, 2)))):
        header = "x,y,z" if points.shape[1] == 3 else "x,y"
        np.savetxt(tmp_path / name, points, delimiter=",", header=header, comments="")
    command = arguments(tmp_path, "--output", out / "m.csv", "--sampler", "exhaustive", "--max-evaluations", 10**15)
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    program = [sys.executable, "-c", heeding + PROGRAM[-1], *command, "--progress"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            assert process.stderr.readline() == "hyper-edges: 0 %\n"
            time.sleep(0.2)
            process.send_signal(number)
            stdout, stderr = process.communicate(timeout=60)
        finally:
            process.kill()
    word = "terminated" if number is signal.SIGTERM else "interrupted"
    assert (process.returncode, stdout) == (code, "")
    assert stderr.endswith(f"rootmatch: {word}; no partial output is left\n")
    assert [path.name for path in out.iterdir()] == ["m.csv"]
    assert (out / "m.csv").read_text() == "as before"


def test_json_is_one_object_whatever_the_names(scene: Path) -> None:
    found = CliRunner().invoke(app, arguments(scene, "--json"))
    assert json.loads(found.stdout)["status"] == "matched"
