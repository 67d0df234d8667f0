"""What is written and printed: names are never obeyed, and whatever ends a run, files are whole and its code tells."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import rootmatch
from commands import Command, started
from permissions import CAN_BE_BOUND, bound_by_permissions
from rootmatch.cli.app import app
from rootmatch.errors import MAX_QUOTED, InputError, escape_unprintable, quote_value
from rootmatch.io import check_output, write_atomically, write_folder_atomically, write_table
from rootmatch.report.pictures import match_figure, save_figure

PROGRAM = [sys.executable, "-c", "from rootmatch.cli import main; main()"]
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
    """A command in a process of its own, for what is settled when that begins."""
    pipe = subprocess.PIPE
    return subprocess.run([*PROGRAM, *command], stdout=pipe, stderr=pipe, text=True, check=False, **options)


@pytest.fixture
def forked(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Command]:
    """A function that runs a command to its end in a child of this process, where all is imported already."""
    assert CliRunner().invoke(app, arguments(scene)).exit_code == 0  # whose compiled code the child finds
    logs = tmp_path_factory.mktemp("logs")

    def runs(command: list[str], folder: Path = scene, **options: Any) -> Command:
        child = started(command, folder, logs, **options)
        assert child.ended(120.0)
        return child

    return runs


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
    assert quote_value("\x1b[31m\u202ered") == r"'\x1b[31m\u202ered'"
    assert escape_unprintable("a\x1b[2Jb") == r"a\x1b[2Jb"
    assert len(quote_value("x" * 10_000)) == MAX_QUOTED
    assert quote_value(list(range(100))) == "a list of 100"
    assert quote_value(10**10_000) == "a number of thousands of digits"
    bomb: list[Any] = ["lol"]
    for _ in range(30):
        bomb = [bomb] * 8
    assert len(quote_value(bomb)) <= MAX_QUOTED


@UNIX
def test_a_file_name_is_no_command_to_the_terminal(forked: Callable[..., Command], tmp_path: Path) -> None:
    found = forked(arguments(tmp_path / "\x1b[31mred"))
    assert found.code == 2
    assert "\x1b" not in found.stderr
    assert r"\x1b[31mred" in found.stderr


@UNIX
@pytest.mark.parametrize("narrow", [False, True])
def test_plain_terminals(
    forked: Callable[..., Command], scene: Path, tmp_path: Path, narrow: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = tmp_path / "model.csv"
    text = (scene / "model.csv").read_text(encoding="utf-8").replace("=1+1", "λ-9")
    model.write_text(text, encoding="utf-8")
    command = arguments(scene)
    command[1] = str(model)
    for name in ("FORCE_COLOR", "NO_COLOR"):
        monkeypatch.setenv(name, "1")
    if narrow:
        monkeypatch.setenv("COLUMNS", "20")
        child = forked(command)
        code, stdout, stderr = child.code, child.stdout, child.stderr
    else:
        done = run(command, env={**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"})
        code, stdout, stderr = done.returncode, done.stdout, done.stderr
    assert code == 0, stderr
    shown = "".join(stdout.split())
    assert "matched" in shown
    assert ("λ-9" if narrow else r"\u03bb-9") in shown
    assert "\x1b[3" not in stdout  # no colour


@UNIX
@pytest.mark.parametrize("json_wanted", [True, False])
def test_a_reader_that_leaves_early(
    forked: Callable[..., Command], scene: Path, tmp_path: Path, json_wanted: bool
) -> None:
    read, write = os.pipe()
    os.close(read)
    output = tmp_path / "m.csv"
    found = forked(arguments(scene, "--output", output, *(["--json"] if json_wanted else [])), stdout=write)
    os.close(write)
    assert found.code == 141
    assert "Traceback" not in found.stderr
    assert "BrokenPipe" not in found.stderr
    assert len(output.read_text().splitlines()) == 7


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_standard_output_on_a_full_disk(forked: Callable[..., Command], scene: Path) -> None:
    with open("/dev/full", "w") as full:
        found = forked(arguments(scene), stdout=full.fileno())
    assert found.code == 2
    assert found.stderr == "rootmatch: standard output: No space left on device; free or choose another place\n"


@UNIX
def test_a_closed_standard_output(forked: Callable[..., Command], scene: Path) -> None:
    found = forked(arguments(scene), closed=(1,))
    assert (found.code, found.stderr) == (0, "")


@UNIX
@pytest.mark.parametrize("option", ["--output", "--plot"])
def test_a_file_on_a_full_disk(scene: Path, tmp_path: Path, option: str) -> None:
    kept = tmp_path / ("m.csv" if option == "--output" else "m.png")
    kept.write_text("as before")
    assert CliRunner().invoke(app, arguments(scene)).exit_code == 0  # whose compiled code needs room too
    room = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20, room[1]))
    try:
        found = CliRunner().invoke(app, arguments(scene, option, kept))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, room)
    assert found.exit_code == 2, found.stderr
    assert found.stderr == f"rootmatch: {kept}: cannot be written (File too large); choose another location\n"
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
        if frame.f_code.co_filename.endswith("outputs.py") and event == "line":
            steps += 1
            if steps == stop:
                raise KeyboardInterrupt
        return trace

    for stop in range(1 + times, 120, 6):
        steps = 0
        sys.settrace(trace)
        try:
            with write_atomically(path) as temporary:
                temporary.write_text("new")
            with write_folder_atomically(folder) as inside:
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


def in_child(user: int, work: Callable[[], None]) -> None:
    """Do something as a user, in a child process: only the administrator can become another one."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setgid(user)
            os.setuid(user)
            work()
            code = 0
        except BaseException as error:
            os.write(2, f"{error!r}\n".encode())
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user can get at and write in."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o777)
        yield Path(folder)


def put(path: Path, content: str = "new") -> None:
    with write_atomically(path) as temporary:
        temporary.write_text(content)


NOBODY, SOMEBODY = 65534, 12345
USERS = [0, NOBODY] if os.getuid() == 0 else [os.getuid()]


@pytest.mark.parametrize("user", USERS)
def test_a_file_is_replaced_through_links_and_keeps_its_mode(open_folder: Path, user: int) -> None:
    def work() -> None:
        file, link = open_folder / "real.csv", open_folder / "link.csv"
        link.symlink_to("other.csv")
        (open_folder / "other.csv").symlink_to(file)
        put(link)  # to a file that is not there yet
        assert file.read_text() == "new"
        file.chmod(0o640)
        with file.open() as before:
            put(link, "newer")
            assert before.read() == "new"  # who reads it keeps what was there
        assert (file.read_text(), stat.S_IMODE(file.stat().st_mode)) == ("newer", 0o640)
        assert link.is_symlink()
        assert {path.name for path in open_folder.iterdir()} == {"real.csv", "link.csv", "other.csv"}

    in_child(user, work)


@pytest.mark.skipif(os.getuid() != 0, reason="files of other users need the administrator")
@pytest.mark.parametrize("user", [0, NOBODY])
def test_a_file_of_another_user_stays_his(open_folder: Path, user: int) -> None:
    file = open_folder / "real.csv"
    file.write_text("as before")
    os.chown(file, SOMEBODY, SOMEBODY)
    file.chmod(0o666)
    in_child(user, lambda: put(file))
    found = file.stat()
    assert (found.st_uid, found.st_gid, stat.S_IMODE(found.st_mode)) == (SOMEBODY, SOMEBODY, 0o666)
    assert file.read_text() == "new"
    file.chmod(0o644)
    if user:
        with pytest.raises(AssertionError):
            in_child(user, lambda: put(file, "by nobody"))
        assert file.read_text() == "new"
    assert list(open_folder.iterdir()) == [file]


@pytest.mark.parametrize("user", USERS)
def test_devices_and_pipes_are_written_through(open_folder: Path, user: int) -> None:
    def work() -> None:
        before = os.stat("/dev/null")
        for name in ("/dev/null", str(open_folder / "null")):
            if not os.path.lexists(name):
                os.symlink("/dev/null", name)
            check_output(Path(name), "--output")
            put(Path(name))
        assert os.path.samestat(before, os.stat("/dev/null"))
        assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
        pipe = open_folder / "pipe"
        os.mkfifo(pipe)
        reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
        put(pipe)
        assert os.read(reader, 100) == b"new"
        assert stat.S_ISFIFO(pipe.stat().st_mode)
        with pytest.raises(UnicodeEncodeError):
            put(pipe, "half of it, \ud800")
        assert os.read(reader, 100) == b""  # nothing of a content that never became whole
        shared, other = os.pipe()
        put(Path(f"/dev/fd/{other}"))
        assert os.read(shared, 100) == b"new"
        assert {path.name for path in open_folder.iterdir()} == {"null", "pipe"}

    in_child(user, work)


@pytest.mark.parametrize("user", USERS)
@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("folder", "is a folder"),
        ("socket", "is a socket"),
        ("loop", "cannot be written (Too many levels"),
        ("long", "cannot be written (File name too long"),
        ("nowhere", "does not exist"),
        ("file", "does not exist"),
    ],
)
def test_what_takes_no_output_is_refused_before_the_work(open_folder: Path, user: int, kind: str, says: str) -> None:
    def work() -> None:
        path = open_folder / "place"
        if kind == "folder":
            path.mkdir()
        elif kind == "socket":
            socket.socket(socket.AF_UNIX).bind(str(path))
        elif kind == "loop":
            path.symlink_to(path)
        elif kind == "long":
            path = open_folder / ("x" * 5000)
        else:
            if kind == "file":
                path.write_text("")
            path /= "m.csv"
        there = sorted(open_folder.iterdir())
        with pytest.raises(InputError):
            put(path)
        with pytest.raises(InputError) as caught:
            check_output(path, "--output")
        assert str(caught.value).startswith("--output: ")
        assert says in str(caught.value)
        assert sorted(open_folder.iterdir()) == there

    in_child(user, work)


@UNIX
def test_one_file_in_two_roles_is_refused_whatever_its_name(tmp_path: Path) -> None:
    file = tmp_path / "camera.json"
    file.write_text("{}")
    (tmp_path / "link").symlink_to(file)
    os.link(file, tmp_path / "hard")
    for name in ("camera.json", "link", "hard", "../" + tmp_path.name + "/camera.json"):
        with pytest.raises(InputError, match="also an input or another output"):
            check_output(tmp_path / name, "--output", [file])
    for same in (Path("-"), Path("/dev/stdout")):
        with pytest.raises(InputError, match="also an input or another output"):
            check_output(same, "--poses", [Path("-")])
    check_output(Path("/dev/null"), "--poses", [Path("/dev/null")])


@UNIX
@pytest.mark.parametrize("place", ["-", "/dev/stdout", "out.csv"])
def test_standard_output_as_a_file(forked: Callable[..., Command], scene: Path, tmp_path: Path, place: str) -> None:
    with (tmp_path / "out.csv").open("w") as out:
        found = forked(arguments(scene, "--output", place), tmp_path, stdout=out.fileno())
    assert found.code == 0, found.stderr
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 7
    assert "6 of 6 matched" in found.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]
    refused = forked(arguments(scene, "--output", "-", "--json"))
    assert refused.code == 2
    assert refused.stderr == "rootmatch: --json: another output goes to standard output too; give that one a file\n"


@UNIX
@pytest.mark.parametrize("option", ["--output", "--poses"])
@pytest.mark.parametrize("name", ["camera.json", "camera2.json", "model.csv"])
def test_no_input_is_written_over(scene: Path, tmp_path: Path, option: str, name: str) -> None:
    (tmp_path / "model.csv").write_text("x,y\n0,0\n1,0\n0,1\n1,1\n")
    for camera in ("camera.json", "camera2.json"):
        (tmp_path / camera).write_text('{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240}')
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    command = [
        "match",
        "model.csv",
        "model.csv",
        "--problem",
        "3p1",
        "--camera",
        "camera.json",
        "--axis",
        "0,1,0",
        "--axis2",
        "0,1,0",
    ]
    command += ["--camera2", "camera2.json", option, name, "--pose-format", "csv"]
    with chdir(tmp_path):
        found = CliRunner().invoke(app, command)
    assert found.exit_code == 2
    assert "is also an input or another output" in found.stderr
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


@UNIX
def test_a_scene_is_not_written_over_its_own_camera(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text('{"fx": 900, "fy": 900, "cx": 320, "cy": 240}')
    command = ["simulate", "p3p", "--camera", str(tmp_path / "camera.json"), "--output", str(tmp_path), "--force"]
    found = CliRunner().invoke(app, command)
    assert found.exit_code == 2
    assert "camera.json is also an input" in found.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["camera.json"]


def test_an_overlong_word_is_shortened_in_an_error() -> None:
    found = CliRunner().invoke(app, ["match", "x" * 5000, "y", "--problem", "p3p", "--camera", "1000,1000,320,240"])
    assert found.exit_code == 2
    assert len(found.stderr) < 400
    assert found.stderr.startswith("rootmatch: xxx")


def test_nothing_is_written_but_through_one_function() -> None:
    """Every module that writes a file does so within `write_atomically`, or is of the caches and stores named here."""
    package = Path(rootmatch.__file__).parent
    others = {
        "research/real/leaderboard.py", "cli/surroundings.py", "derivation/shipped.py", "io/appended_table.py",
        "io/inputs.py", "jit/cache.py", "jit/locks.py", "jit/prebuilt.py", "problems/derived/store.py",
    }  # fmt: skip
    writes = re.compile(r"write_text\(|write_bytes\(|savefig\(|os\.replace\(|open\([^)]*[\"'][rwax]?[wax+]b?\+?[\"']")
    found = {str(path.relative_to(package)) for path in package.rglob("*.py") if writes.search(path.read_text("utf-8"))}
    found -= {name for name in found if "_atomically(" in (package / name).read_text("utf-8")}
    found -= {name for name in found if "BytesIO" in (package / name).read_text("utf-8")}
    assert found - others == set()


@UNIX
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_signals_during_the_work(tmp_path: Path, number: signal.Signals, code: int) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "m.csv").write_text("as before")
    rng = np.random.default_rng(0)
    for name, points in (("model.csv", rng.normal(size=(40, 3))), ("image.csv", rng.uniform(0, 480, (40, 2)))):
        header = "x,y,z" if points.shape[1] == 3 else "x,y"
        np.savetxt(tmp_path / name, points, delimiter=",", header=header, comments="")
    command = arguments(tmp_path, "--output", out / "m.csv", "--plot", out / "m.png")
    command += ["--sampler", "exhaustive", "--max-evaluations", str(10**15)]  # hours of work
    child = started([*command, "--progress"], tmp_path, tmp_path / "logs")
    try:
        ends = time.monotonic() + 120.0
        while child.stderr != "hyper-edges: 0 %\n" and time.monotonic() < ends:
            time.sleep(0.01)
        time.sleep(0.2)
        os.kill(child.pid, number)
        assert child.ended(60.0)
    finally:
        if child.code is None:
            child.kill()
    word = "terminated" if number is signal.SIGTERM else "interrupted"
    assert (child.code, child.stdout) == (code, "")
    assert child.stderr.endswith(f"rootmatch: {word}; no partial output is left\n")
    assert [path.name for path in out.iterdir()] == ["m.csv"]
    assert (out / "m.csv").read_text() == "as before"


def test_json_is_one_object_whatever_the_names(scene: Path) -> None:
    found = CliRunner().invoke(app, arguments(scene, "--json"))
    assert json.loads(found.stdout)["status"] == "matched"
