"""Matches beside one another: threads, forked and spawned processes, and processes that share a cache of kernels."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from permissions import CAN_BE_BOUND, bound_by_permissions
from rootmatch.simulation import p3p_scene, up2p_scene

SCENES = [p3p_scene(6, 2, noise=0.5, seed=seed) for seed in range(4)]
LARGE = p3p_scene(10, 10, noise=0.5, seed=1)  # by the guided search
SEVERAL = up2p_scene(10, 2, noise=0.5, seed=1, motions=2)


def content(match: rm.Match) -> tuple[Any, ...]:
    """What a match says, to the bit."""
    return (
        match.assignment.tobytes(),
        match.score.hex(),
        match.margin.hex(),
        match.soft_assignment.tobytes(),
        match.tensor.indices.tobytes(),
        match.tensor.weights.tobytes(),
        [(other.tobytes(), float(score).hex()) for other, score in match.alternatives],
        match.status.name,
        match.motion_labels.tobytes(),
        None if match.probability is None else float(match.probability).hex(),
    )


def matched(number: int) -> tuple[Any, ...]:
    """The content of one of a few matches."""
    if number == len(SCENES):
        return content(rm.match(LARGE.source, LARGE.target, LARGE.problem, noise=0.5))
    if number > len(SCENES):
        return content(rm.match(SEVERAL.source, SEVERAL.target, SEVERAL.problem, noise=0.5, motions="auto"))
    scene = SCENES[number]
    return content(rm.match(scene.source, scene.target, scene.problem, noise=0.5))


NUMBERS = list(range(len(SCENES) + 2))


@pytest.fixture(scope="module")
def alone() -> list[tuple[Any, ...]]:
    """The matches one after the other in this thread."""
    return [matched(number) for number in NUMBERS]


def test_eight_threads_match_as_one(alone: list[tuple[Any, ...]]) -> None:
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(matched, NUMBERS * 3))
    assert found == alone * 3


def test_eight_threads_share_a_matcher() -> None:
    scene = SCENES[0]
    frames = [scene.target[: 8 - k % 3] for k in range(6)]
    matcher = rm.Matcher(scene.source, scene.problem, noise=0.5)
    expected = [content(rm.match(scene.source, frame, scene.problem, noise=0.5)) for frame in frames]
    together = threading.Barrier(8)

    def work(first: int) -> list[tuple[Any, ...]]:
        together.wait()
        return [content(matcher.match(frames[(first + k) % 6])) for k in range(6)]

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(work, range(8)))
    for first, contents in enumerate(found):
        assert contents == [expected[(first + k) % 6] for k in range(6)]


@pytest.mark.parametrize(
    "method", [name for name in ("fork", "spawn") if name in multiprocessing.get_all_start_methods()]
)
def test_other_processes_match_as_this_one(alone: list[tuple[Any, ...]], method: str) -> None:
    few = NUMBERS[::2]
    # what is spawned imports everything anew
    with multiprocessing.get_context(method).Pool(1 if method == "spawn" else 2) as pool:
        found = pool.map_async(matched, few, chunksize=1).get(timeout=300)
    assert found == [alone[number] for number in few]


THREADS = """
import hashlib, sys
sys.path.insert(0, sys.argv[1])
import numba
from test_concurrency import NUMBERS, matched
for threads in (4, 1):
    numba.set_num_threads(threads)
    print(hashlib.sha256(repr([matched(number) for number in NUMBERS]).encode()).hexdigest())
"""


def test_the_number_of_threads_changes_no_bit(alone: list[tuple[Any, ...]]) -> None:
    here = hashlib.sha256(repr(alone).encode()).hexdigest()  # with as many threads as there are processors
    command = [sys.executable, "-c", THREADS, str(Path(__file__).parent)]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "4"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [here, here]


CACHED = """
import numpy as np
from rootmatch.hypergraph.contraction import find_inside
print(find_inside(np.array([[3, 1, 2], [0, 4, 5]], np.int32), np.arange(6) < 4).tolist())
"""


def both(cache: Path, state: str = "", count: int = 2) -> None:
    """Processes beside one another, two of them if nothing else is said, which need the same compiled code."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n" if state == "full disk" else ""
    running = [
        subprocess.Popen(
            [sys.executable, "-c", limit + CACHED],
            env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=bound_by_permissions if state == "read-only" else None,
        )
        for _ in range(count)
    ]
    for process in running:
        stdout, stderr = process.communicate(timeout=300)
        assert process.returncode == 0, stderr
        assert stdout == "[0]\n"


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of compiled code that two processes leave which began with an empty one."""
    cache = tmp_path_factory.mktemp("filled") / "cache"
    both(cache)
    return cache


@pytest.mark.parametrize("state", ["empty", "cut short", "garbage", "in the way", "full disk", "read-only"])
def test_two_processes_share_a_cache(tmp_path: Path, filled: Path, state: str) -> None:
    """Whatever lies in the folder of compiled code, or does not fit into it: compiled anew, and the same result.

    One process shows it where nothing can be kept, as there is nothing to share, and of what cannot be read at all.
    """
    cache = tmp_path / "cache"
    files = [path for path in filled.rglob("*") if path.is_file() and path.stat().st_size]
    assert files
    if state == "empty":
        return
    if state in ("cut short", "garbage"):
        shutil.copytree(filled, cache)
        for path in (cache / path.relative_to(filled) for path in files):
            data = path.read_bytes()
            path.write_bytes(data[: len(data) // 2] if state == "cut short" else b"\x80\x05garbage" * 30)
    elif state == "in the way":
        cache.write_text("a file")
    elif state == "read-only":
        if not CAN_BE_BOUND:
            pytest.skip("nothing is read-only here")
        cache.mkdir(mode=0o500)
    both(cache, state, 2 if state == "cut short" else 1)


def test_the_global_random_state_is_left_alone() -> None:
    before = np.random.get_state()[1].tobytes()  # noqa: NPY002
    rm.match(SCENES[0].source, SCENES[0].target, SCENES[0].problem, noise=0.5)
    assert np.random.get_state()[1].tobytes() == before  # noqa: NPY002
