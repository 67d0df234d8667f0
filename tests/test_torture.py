"""What takes long to break: `make torture` kills a sweep a hundred times and matches ten thousand frames.

The test suite does a little of each.
"""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

import rootmatch as rm
from rootmatch.experiments.store import Store
from rootmatch.simulation import p3p_scene
from tiny_sweep import UNITS, sweep

LONG = bool(os.environ.get("ROOTMATCH_TORTURE"))
KILLS = 100 if LONG else 10
FRAMES = 10_000 if LONG else 300


@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed otherwise there")
def test_a_sweep_killed_at_random_gives_the_rows_of_an_unbroken_one(tmp_path: Path) -> None:
    """The store is begun anew, and kept aside, each time that the sweep gets to its end."""
    expected = sweep(tmp_path / "unbroken.sqlite")
    rng = random.Random(18)
    script = str(Path(__file__).with_name("tiny_sweep.py"))
    finished = kills = 0
    path = tmp_path / "0.sqlite"
    while kills < KILLS:
        command = [sys.executable, script, str(path), "1", "0.05"]
        process = subprocess.Popen(command, start_new_session=True)
        # from before the store is there to beyond its last row
        begun, least = units_done(path), rng.choice((0, 0, 1, 2, 4))
        deadline = time.monotonic() + 120
        while process.poll() is None and units_done(path) < min(begun + least, UNITS):
            assert time.monotonic() < deadline, "the sweep does not get on"
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.3))
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            kills += 1
        code = process.wait()
        assert code in (0, -signal.SIGKILL)
        if code == 0:
            with Store(path) as store:
                assert store.rows() == expected
            finished += 1
            path = tmp_path / f"{finished}.sqlite"
    assert subprocess.run([sys.executable, script, str(path), "1", "0"], check=False).returncode == 0
    with Store(path) as store:
        assert store.rows() == expected


def units_done(path: Path) -> int:
    """How many units a store holds, seen from another process."""
    if not path.exists():
        return 0
    connection = sqlite3.connect(path)
    try:
        return int(connection.execute("SELECT COUNT(*) FROM work").fetchone()[0])
    except sqlite3.OperationalError:  # not laid out yet
        return 0
    finally:
        connection.close()


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
