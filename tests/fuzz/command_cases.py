"""Whole command lines as anybody may type them: every command and option, and what must hold of each.

Each runs in a forked child, which has everything imported already, one in two hundred in a process of its own, in a
folder with good inputs. What takes long is interrupted, sooner or later, which a command line has to bear as well.
"""

from __future__ import annotations

import contextlib
import functools
import os
import random
import re
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from file_cases import FRAMES, OWN, POSE

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from commands import started

SECONDS, WAITING = 1.0, 15.0
"""Of the processor, and of the clock without any of that, after which a command is interrupted at the latest: it may
wait for what never comes."""
SOON = (0.15, 0.3, 0.6, 1.0)
"""Parts of those seconds after which it is."""
STARTING = 5.0
"""Seconds of the processor that a process of its own takes besides, with what it imports, at most."""
FRESH = 0.005
"""Share of the command lines that have a process of their own."""
DYING = 60.0
"""Seconds of the clock that it then has; other work may keep the processors."""
USUAL = (0, 1, 2, 130)
PROGRESS = r"(hyper-edges|kernels|scenes): |.*: \d+ rows to "
"""How lines of progress begin."""

_world = np.random.default_rng(0).uniform(-2.0, 2.0, (6, 3))
_image = 1000.0 * (_world[:, :2] / (_world[:, 2:] + 12.0)) + [320.0, 240.0]


def _table(header: str, rows: Any) -> bytes:
    return "\n".join([header, *(",".join(map(str, row)) for row in rows), ""]).encode()


INPUTS: dict[str, bytes] = {
    "model.csv": _table("x,y,z", _world.tolist()),
    "bodies.csv": _table("body,x,y,z", [["ab"[k // 4], *_world[k % 6]] for k in range(8)]),
    "image.csv": _table("x,y", _image.tolist()),
    "frames.csv": _table("frame,x,y", [[k // 6, *_image[k % 6]] for k in range(18)]),
    "other.csv": FRAMES,
    "camera.json": b'{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240}\n',
    "two.json": OWN,
    "truth.csv": _table("source,target", [[k, k] for k in range(6)]),
    "pairs.csv": _table("source,target,weight", [[i, j, 1] for i in range(6) for j in range(6)]),
    "prior.json": POSE,
    "empty.csv": b"",
    "blank.csv": b"\n\n",
    "bytes.csv": bytes(range(256)),
}
"""What lies in the folder; besides them are a folder, a link, a dangling one, a socket and the devices."""
SPECIAL = ("folder", "link.csv", "dangling.csv", "loop.csv", "socket", "/dev/null", "/dev/full", "/dev/zero", "-", "")
OUTPUTS = ("out.csv", "out.json", "out.png", "out.html", "out.tum", "out", "folder/out.csv", "no/out.csv")
WORDS = (
    "", "-", "--", "---", "-1", "0", "1", "2", "3", "0.5", "-0.0", "nan", "inf", "-inf", "1e308", "1e-308", "1e400",
    "99999999999999999999", "-99999999999999999999", "0x10", "1_0", "\u0661", "abc", "a" * 5000, "\udcff", "\u03bb",
    "\x1b[31mred", "a\nb", "auto", "1,2", "1,2,3", "1000,1000,320,240", "0,0,0", "nan,nan,nan,nan", "1e300,1e300,0,0",
    "tls://127.0.0.1:1", "ftp://x", "csv", "tum", "paper", "guided", "random", "exhaustive", "magic", "p3p", "rigid",
    "--help", "-h", "--version", "--nonsense", "%s%n", "{}", "$(id)", "*", "/", ".", "..", "~", "model.csv#cam0",
)  # fmt: skip
BASES: tuple[tuple[str, ...], ...] = (
    ("match", "model.csv", "image.csv", "--problem", "p3p", "--camera", "camera.json"),
    (
        "match",
        "model.csv",
        "image.csv",
        "--problem",
        "up2p",
        "--camera",
        "camera.json",
        "--vertical-camera",
        "0,1,0",
        "--vertical-world",
        "0,1,0",
    ),
    ("match", "model.csv", "frames.csv", "--problem", "p3p", "--camera", "camera.json", "--output", "out.csv"),
    ("match", "bodies.csv", "image.csv", "--problem", "p3p", "--camera", "camera.json"),
    ("match", "image.csv", "image.csv", "--problem", "planar", "--camera", "camera.json", "--axis", "0,1,0"),
    ("match", "image.csv", "image.csv", "--problem", "similarity"),
    ("track", "model.csv", "frames.csv", "--problem", "p3p", "--camera", "camera.json"),
    ("track", "model.csv", "-", "--problem", "p3p", "--camera", "camera.json", "--poses", "poses.csv"),
    ("simulate", "p3p", "--output", "scene"),
    ("simulate", "3p1", "--output", "folder", "--force"),
    ("reproduce", "p3p", "--output", "results", "--instances", "1", "--jobs", "1", "--quiet"),
    ("benchmark", "real", "--data", ".", "--output", "board"),
    ("benchmark", "speed", "--tiny"),
    ("warmup",),
    (),
)
COMMANDS = ("match", "track", "simulate", "reproduce", "benchmark", "warmup")
WEIGHTS = (10, 4, 8, 3, 2, 2, 8, 4, 4, 2, 2, 3, 1, 1, 1)


@functools.cache
def options_of(command: str) -> tuple[tuple[str, bool], ...]:
    """The options of a command, and whether each is a flag."""
    from typer.main import get_command

    from rootmatch.cli import app

    known: Any = get_command(app)
    parameters = known.commands[command].params if command in known.commands else known.params
    return tuple(
        (name, parameter.is_flag)
        for parameter in parameters
        if parameter.param_type_name == "option"
        for name in (*parameter.opts, *parameter.secondary_opts)
    )


def recipe(rng: random.Random) -> dict[str, Any]:
    """A recipe of a command line: one that is good, options added, and what is done to its words and streams."""
    words = list(rng.choices(BASES, WEIGHTS)[0])
    known = options_of(words[0] if words else "")
    values = (*INPUTS, *SPECIAL, *OUTPUTS, *WORDS)
    for _ in range(rng.choice((0, 1, 1, 2, 2, 3, 5))):
        name, flag = rng.choice(known)
        words += [name] if flag and rng.random() < 0.9 else [name, fitting(rng, name, values)]
    for _ in range(rng.choice((0, 0, 0, 1, 1, 2))):
        at = rng.randrange(len(words) + 1)
        deed = rng.choice(("drop", "replace", "put", "twice", "swap"))
        if deed == "put" or not words:
            words.insert(at, rng.choice(values))
        elif deed == "drop":
            del words[at - 1]
        elif deed == "replace":
            words[at - 1] = rng.choice(values)
        elif deed == "twice":
            words[at:at] = words[max(at - 2, 0) : at]
        else:
            other = rng.randrange(len(words))
            words[at - 1], words[other] = words[other], words[at - 1]
    closed = sorted(rng.sample(range(3), rng.randint(1, 3))) if rng.random() < 0.1 else []
    stdin = rng.choice(("frames.csv", "frames.csv", "empty.csv", "bytes.csv", "/dev/null"))
    fresh = rng.random() < FRESH
    return {"words": words, "closed": closed, "stdin": stdin, "fresh": fresh, "soon": rng.choice(SOON)}


def fitting(rng: random.Random, name: str, values: tuple[str, ...]) -> str:
    """A value of an option: most of them such as it may take."""
    fits: dict[str, tuple[str, ...]] = {
        "--output": (*OUTPUTS, *SPECIAL, *INPUTS),
        "--poses": (*OUTPUTS, *SPECIAL, *INPUTS),
        "--plot": ("out.png", "out.svg", "-", "/dev/null", "model.csv"),
        "--report": ("out.html", "-", "/dev/null", "image.csv"),
        "--camera": ("camera.json", "two.json", "1000,1000,320,240"),
        "--camera2": ("camera.json", "two.json", "1000,1000,320,240"),
        "--truth": ("truth.csv",),
        "--candidates": ("pairs.csv",),
        "--prior": ("prior.json",),
        "--problem": ("p3p", "up2p", "3p1", "planar", "up2pf", "similarity", "rigid"),
        "--jobs": ("1", "1", "0", "-5", "100000"),
        "--noise": ("0.5", "auto", "0.5,0.5"),
    }
    return rng.choice(fits.get(name, ("1", "2", "0.5")) if rng.random() < 0.7 else values)


def simpler(recipe: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Recipes with a word less each, then with whole streams."""
    words = recipe["words"]
    for length in (2, 1):
        for at in range(len(words) - length, -1, -1):
            yield {**recipe, "words": words[:at] + words[at + length :]}
    if recipe["closed"]:
        yield {**recipe, "closed": []}
    if recipe.get("fresh"):
        yield {**recipe, "fresh": False}


@functools.cache
def warm() -> None:
    """Load in this process what its children would each load again: imports, compiled code, and how words are read."""
    from typer import main
    from typer.testing import CliRunner

    import rootmatch as rm
    from rootmatch.cli import app
    from rootmatch.tracking import tracker  # noqa: F401

    main.get_command = functools.cache(main.get_command)
    camera = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
    for problem in (rm.P3P(camera), rm.UP2P(camera, (0, 1, 0), (0, 1, 0))):
        rm.match(_world, _image, problem, noise=0.5)
    for problem in (rm.PlanarMotion(camera, axis=(0, 1, 0)), rm.Similarity(2), rm.Rigid(2)):
        _ = rm.match(_image, _image, problem, noise=0.5).score  # which is computed when it is read
    outputs = [
        "--output",
        "one.csv",
        "--poses",
        "poses.json",
        "--plot",
        "out.png",
        "--report",
        "out.html",
        "--truth",
        "truth.csv",
    ]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        prepared(Path(folder))
        for words in ([*BASES[0], *outputs], BASES[2], BASES[6], *((name, "--help") for name in COMMANDS), ("--help",)):
            assert CliRunner().invoke(app, words).exit_code == 0, words


def prepared(folder: Path) -> None:
    """Fill a folder with inputs, and with what is no file."""
    for name, content in INPUTS.items():
        (folder / name).write_bytes(content)
    (folder / "folder").mkdir()
    (folder / "link.csv").symlink_to("target.csv")
    (folder / "dangling.csv").symlink_to("no/where.csv")
    (folder / "loop.csv").symlink_to("loop.csv")
    with socket.socket(socket.AF_UNIX) as there:
        where = os.getcwd()
        os.chdir(folder)  # names of sockets are short
        try:
            there.bind("socket")
        finally:
            os.chdir(where)


def attempt(recipe: dict[str, Any]) -> int:
    """Run the command and check what it leaves; its exit code."""
    words, closed, fresh = recipe["words"], tuple(recipe["closed"]), recipe.get("fresh", False)
    warm()
    parent = Path(tempfile.mkdtemp())
    try:
        folder = parent / "folder"
        folder.mkdir()
        prepared(folder)
        stdin = recipe["stdin"] if recipe["stdin"].startswith("/") else folder / recipe["stdin"]
        command = started(words, folder, parent, stdin, closed, fresh=fresh)
        worked, at, maximum = 0.0, time.monotonic(), SECONDS * recipe.get("soon", 1.0) + STARTING * fresh
        while not command.ended(0.2) and worked < maximum and time.monotonic() < at + WAITING:
            if command.worked() > worked:
                worked, at = command.worked(), time.monotonic()
        if command.code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(command.pid, signal.SIGINT)
            if not command.ended(DYING):
                os.killpg(command.pid, signal.SIGKILL)
                command.ended(DYING)
                raise AssertionError("hangs")
        assert command.alone(DYING), "a process is left"
        check(words, closed, folder, command.code, command.stdout, command.stderr)
        return command.code or 0
    finally:
        shutil.rmtree(parent, ignore_errors=True)


def check(words: list[str], closed: tuple[int, ...], folder: Path, code: int | None, stdout: str, stderr: str) -> None:
    """What must hold of every command line."""
    assert "Traceback" not in stderr, stderr.strip().splitlines()[-1][:120]
    assert "Exception ignored" not in stderr, "an exception that is ignored"
    assert code in USUAL, f"code {code}"
    assert "\x1b[31mred" not in stderr, "an escape sequence is obeyed"
    helped = "Usage:" in stdout + stderr or (not words and 1 in closed)  # help that nobody can see
    if code == 2 and 2 not in closed and not helped:
        lines = [line for line in stderr.splitlines() if not re.match(PROGRESS, line)]
        assert len(lines) == 1, f"{len(lines)} lines for an error"
        assert lines[0].startswith("rootmatch: "), "no line of ours"
        assert len(lines[0]) < 1500, "an overlong line"
    hidden = [path for path in folder.rglob(".*") if path.name not in (".", "..")]
    assert not hidden, "a temporary file is left"
    for name in inputs_of(words):
        assert (folder / name).read_bytes() == INPUTS[name], f"the input {name} is written over"
    for name in ("/dev/null", "/dev/full", "/dev/zero"):
        assert not Path(name).is_file(), f"{name} is a file now"


def inputs_of(words: list[str]) -> set[str]:
    """The inputs that a command reads for certain: its first words, and options of files that are given once."""
    used = {word for word in words[1:3] if words[0] in ("match", "track")} if words else set()
    for option in ("--camera", "--camera2", "--truth", "--candidates", "--prior"):
        if words.count(option) == 1 and words.index(option) + 1 < len(words):
            used.add(words[words.index(option) + 1])
    return used & set(INPUTS)
