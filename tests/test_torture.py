"""What takes long to break: `make torture` kills sweeps and runs of frames hundreds of times, and matches ten thousand.

The test suite does a little of each.
"""

from __future__ import annotations

import os
import random
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import rootmatch as rm
from commands import forked, started
from rootmatch.research.store import Store
from rootmatch.research.sweep import units
from rootmatch.simulation import p3p_scene
from test_tracker import BODY, frame
from tiny_sweep import PLAN, SEEDS, UNITS, sweep, units_done

LONG = bool(os.environ.get("ROOTMATCH_TORTURE"))
KILLS = int(os.environ.get("ROOTMATCH_KILLS", "100")) if LONG else 6
FRAMES = 10_000 if LONG else 200


@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed otherwise there")
def test_a_sweep_killed_at_random_gives_the_rows_of_an_unbroken_one(tmp_path: Path) -> None:
    """The store is begun anew, and kept aside, each time that the sweep gets to its end."""
    expected = sweep(tmp_path / "unbroken.sqlite")
    rng = random.Random(18)
    finished = kills = 0
    path = tmp_path / "0.sqlite"
    while kills < KILLS:
        child = forked(partial(swept, path, 0.05), tmp_path / "logs")
        # from before the store is there to beyond its last row
        begun, minimum = units_done(path), rng.choice((0, 0, 1, 2, 4))
        deadline = time.monotonic() + 120
        while not child.ended(0.0) and units_done(path) < min(begun + minimum, UNITS):
            assert time.monotonic() < deadline, "the sweep does not get on"
            time.sleep(0.01)
        if child.ended(rng.uniform(0.0, 0.3)):
            assert child.code == 0
            with Store(path) as store:
                assert store.rows() == expected
            finished += 1
            path = tmp_path / f"{finished}.sqlite"
        else:
            reached = units_done(path)
            child.kill()
            kills += 1
            assert units_done(path) >= reached
            if reached:
                with Store(path) as store:  # nothing is worked out twice
                    assert len(units(PLAN, SEEDS, store)) == UNITS - units_done(path)
    assert swept(path, 0.0) == 0
    with Store(path) as store:
        assert store.rows() == expected


def swept(path: Path, pause: float) -> int:
    """Go on with a sweep to its end."""
    sweep(path, pause=pause)
    return 0


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """A folder of inputs: a model, and forty frames, some of which show little of it."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    np.savetxt(folder / "model.csv", BODY, delimiter=",", header="x,y,z", comments="")
    rows = [f"{k},{x},{y}" for k in range(40) for x, y in frame(k % 20, hidden=k % 7 == 5)[0].tolist()[: 2 + k % 9]]
    (folder / "frames.csv").write_text("\n".join(["frame,x,y", *rows]) + "\n")
    return folder


def unbroken(words: list[str], folder: Path, logs: Path) -> dict[str, bytes]:
    """The files that a command makes in an empty folder when nobody kills it."""
    folder.mkdir()
    command = started(words, folder, logs)
    assert command.ended(600.0)
    assert command.code in (0, 1), command.stderr
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed otherwise there")
@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.skipif(not LONG, reason="workers start"))])
def test_frames_killed_at_random_give_the_files_of_an_unbroken_run(frames: Path, tmp_path: Path, jobs: str) -> None:
    inputs = [str(frames / "model.csv"), str(frames / "frames.csv")]
    words = ["match", *inputs, "--problem", "p3p", "--camera", "800,780,320,240", "--noise", "0.2", "--resume"]
    words += ["--output", "matches.csv", "--poses", "poses.csv"]
    began = time.monotonic()
    unbroken(words, tmp_path / "first", tmp_path / "logs")  # compiles
    began = time.monotonic()
    expected = unbroken([*words, "--jobs", jobs], tmp_path / "unbroken", tmp_path / "logs")
    longest = 1.2 * (time.monotonic() - began)
    assert set(expected) == {"matches.csv", "poses.csv", "matches.csv.settings.json", "poses.csv.settings.json"}
    rng = random.Random(28)
    kills, folder = 0, tmp_path / "killed"
    folder.mkdir()
    while kills < KILLS:
        command = started([*words, "--jobs", jobs], folder, tmp_path / "logs")
        if command.ended(rng.choice((0.2, 1.0)) * rng.uniform(0.0, longest)):
            assert command.code in (0, 1), command.stderr
            assert {path.name: path.read_bytes() for path in folder.iterdir()} == expected
            for path in folder.iterdir():
                path.unlink()
        else:
            command.kill()
            kills += 1
            assert {path.name for path in folder.iterdir()} <= set(expected)
        assert command.alone(30.0), "a worker is left"
    command = started([*words, "--jobs", jobs], folder, tmp_path / "logs")
    assert command.ended(600.0)
    assert command.code in (0, 1), command.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == expected


@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed otherwise there")
def test_a_tracked_sequence_killed_at_random_leaves_the_beginning_of_its_files(frames: Path, tmp_path: Path) -> None:
    inputs = [str(frames / "model.csv"), str(frames / "frames.csv")]
    words = ["track", *inputs, "--problem", "p3p", "--camera", "800,780,320,240", "--noise", "0.2"]
    words += ["--output", "matches.csv", "--poses", "poses.csv"]
    unbroken(words, tmp_path / "first", tmp_path / "logs")
    began = time.monotonic()
    expected = unbroken(words, tmp_path / "unbroken", tmp_path / "logs")
    longest = 1.2 * (time.monotonic() - began)
    rng = random.Random(28)
    for kill in range(KILLS):
        folder = tmp_path / str(kill)
        folder.mkdir()
        command = started(words, folder, tmp_path / "logs")
        if not command.ended(rng.uniform(0.0, longest)):
            command.kill()
        assert command.alone(30.0)
        for path in folder.iterdir():
            assert expected[path.name].startswith(path.read_bytes())


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_memory_does_not_grow_from_match_to_match() -> None:
    scene = p3p_scene(5, 2, noise=0.5, seed=3)
    matcher = rm.Matcher(scene.source, scene.problem, noise=0.5)

    def resident() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

    for _ in range(100):
        matcher.match(scene.target)
        rm.match(scene.source, scene.target, scene.problem, noise=0.5)
    before = resident()
    for _ in range(FRAMES // 2):
        matcher.match(scene.target)
        rm.match(scene.source, scene.target, scene.problem, noise=0.5)
    # a kilobyte each would be 5 MB in the long run
    assert resident() - before < 4.0
