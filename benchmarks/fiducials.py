"""Two point sets in space: how often labels are right, trusted, and trusted and wrong, beside distances alone.

    python benchmarks/fiducials.py --seeds 30 --first-seed 20000

Fiducials in CT and before a tracker, millimetres, from ``fiducials.py`` of the shared scenes: strays, missing and moved
points, symmetric and mirrored layouts, mirrored and unrelated sets, tools of motion capture in one cloud. σ is given as
one number for each set, though that of CT is three times larger along z.

"right": every label is the true one; a moved point may have its own or none. "trusted": the status is "matched";
"and wrong": with a label that is not the true one.
"listed": right, or not trusted with the true labels among the assignment and the first five alternatives.
"distances": all injective maps whose pairwise distances agree, most points first, then the least RMS (`brute` of the
scenes), and how many of those it calls unique are wrong. Of tools a whole frame counts, of mirrored and unrelated sets
nothing is right.
Times are medians, with all kernels compiled. Defaults are chosen on seeds from 1000; reports: from 20000.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from shared import LISTED, head, parser, row, scenes_of

import rootmatch as rm

ROWS: dict[str, dict[str, Any]] = {
    "8 of 8": {"kind": "random"},
    "6 of 8 + 3": {"kind": "random", "missing": 2, "stray": 3},
    "5 of 6 + 2, one moved 8 mm": {"kind": "random", "n": 6, "missing": 1, "stray": 2, "moved": 8.0},
    "4 of 6 + 3": {"kind": "random", "n": 6, "missing": 2, "stray": 3},
    "mirror-symmetric, heights of 10 mm": {"kind": "mirror-10"},
    "half turn but for 5 mm": {"kind": "rectangle-5"},
    "half turn but for 0.2 mm": {"kind": "rectangle-0.2"},
    "half turn": {"kind": "rectangle"},
    "flat, half turn": {"kind": "flat"},
}
"""The nine rows; the last three are symmetric within the noise."""
OTHERS: dict[str, dict[str, Any]] = {
    "12 of 15 + 5": {"kind": "random", "n": 15, "missing": 3, "stray": 5},
    "half turn but for 2 mm": {"kind": "rectangle-2"},
    "mirrored, 8 of 8": {"kind": "random", "mirrored": True},
    "unrelated, 8 and 9": {"unrelated": (8, 9)},
    "unrelated, 6 and 12": {"unrelated": (6, 12)},
    "tools of 4, 4, 5 + 7": {"tools": 7},
}


@dataclass(frozen=True)
class Outcome:
    """One scene."""

    right: bool
    trusted: bool
    wrong: bool
    listed: bool
    seconds: float
    peer_right: bool
    peer_trusted: bool
    peer_seconds: float


def agrees(assignment: NDArray[np.int64], truth: NDArray[np.int64], moved: int) -> bool:
    """Whether labels are the true ones, but for a moved point, which may have none."""
    same = assignment == truth
    if moved >= 0 and assignment[moved] < 0:
        same[moved] = True
    return bool(same.all())


def outcome(scenes: ModuleType, arguments: dict[str, Any], seed: int) -> Outcome:
    """One scene matched, and by distances alone."""
    if "tools" in arguments:
        return frame_of_tools(scenes, seed, arguments["tools"])
    if "unrelated" in arguments:
        rng = np.random.default_rng([seed, 62])
        n, n_target = arguments["unrelated"]
        source, target = (rng.uniform(-70, 70, (count, 3)) * (1, 1, 0.6) for count in (n, n_target))
        truth, moved, noise = None, -1, (0.38, 0.25)
    else:
        s = scenes.scene(seed=seed, **arguments)
        source, target, truth, moved, noise = s["source"], s["target"], s["truth"], s["moved"], s["noise"]
        truth = None if arguments.get("mirrored") else truth
    begun = time.perf_counter()
    match = rm.match(source, target, rm.Rigid(), noise=noise)
    seconds = time.perf_counter() - begun
    begun = time.perf_counter()
    peer, _, tie = scenes.brute(source, target, float(np.hypot(*noise)))
    peer_seconds = time.perf_counter() - begun
    trusted, peer_trusted = match.status is rm.Status.MATCHED, bool((peer >= 0).any() and not tie)
    if truth is None:
        return Outcome(False, trusted, trusted, not trusted, seconds, False, peer_trusted, peer_seconds)
    right = agrees(match.assignment, truth, moved)
    others = [] if trusted else [other for other, _ in match.alternatives[:LISTED]]
    listed = right or any(agrees(other, truth, moved) for other in others)
    wrong = trusted and bool(((match.assignment >= 0) & (match.assignment != truth)).any())
    return Outcome(right, trusted, wrong, listed, seconds, agrees(peer, truth, moved), peer_trusted, peer_seconds)


def frame_of_tools(scenes: ModuleType, seed: int, stray: int) -> Outcome:
    """A frame of three tools: right and trusted where all of them are, wrong where any is trusted and wrong."""
    source, labels, target, truth = scenes.tools(seed, stray=stray)
    begun = time.perf_counter()
    match = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.2), bodies=labels)
    seconds = time.perf_counter() - begun
    assert match.bodies is not None
    wrong = False
    for label, body in match.bodies.items():
        off = (body.assignment >= 0) & (body.assignment != truth[labels == label])
        wrong |= body.status is rm.Status.MATCHED and bool(off.any())
    begun = time.perf_counter()
    peer, free = np.full(len(source), -1), np.arange(len(target))
    for label in range(3):
        found, _, _ = scenes.brute(source[labels == label], target[free], 0.2)
        peer[labels == label] = np.where(found >= 0, free[found], -1)
        free = np.setdiff1d(free, peer)
    peer_seconds = time.perf_counter() - begun
    every = np.array_equal(match.assignment, truth)
    return Outcome(
        every, match.status is rm.Status.MATCHED, wrong, every, seconds,
        bool(np.array_equal(peer, truth)), True, peer_seconds,
    )  # fmt: skip


def print_row(name: str, outcomes: list[Outcome]) -> None:
    """Print a line of the table."""
    row(
        f"{name} ({len(outcomes)})",
        sum(one.right for one in outcomes),
        sum(one.trusted for one in outcomes),
        sum(one.trusted and one.right for one in outcomes),
        sum(one.wrong for one in outcomes),
        sum(one.listed for one in outcomes),
        f"{1e3 * np.median([one.seconds for one in outcomes]):.1f}",
        sum(one.peer_right for one in outcomes),
        sum(one.peer_trusted and not one.peer_right for one in outcomes),
        f"{1e3 * np.median([one.peer_seconds for one in outcomes]):.1f}",
    )


def main() -> None:
    """The table."""
    ask = parser(__doc__, seeds=30, first_seed=1000)
    ask.add_argument("--rows", nargs="+", help="those whose names begin so; all by default")
    ask.add_argument("--scenes", help="folder of the scenes' module")
    ask.add_argument("--verbose", action="store_true", help="the seeds that are trusted and wrong, or not right")
    given = ask.parse_args()
    numba.set_num_threads(1)
    scenes = scenes_of("fiducials", given.scenes)
    if scenes is None:
        sys.exit(1)
    print(f"seeds from {given.first_seed}\n")
    head(
        "scenes", "right", "trusted", "trusted and right", "trusted and wrong", "listed", "ms", "distances right",
        "unique and wrong", "ms",
    )  # fmt: skip
    for name, arguments in {**ROWS, **OTHERS}.items():
        if given.rows and not any(name.startswith(wanted) for wanted in given.rows):
            continue
        for seed in range(2):
            outcome(scenes, arguments, seed)
        seeds = range(given.first_seed, given.first_seed + given.seeds)
        outcomes = [outcome(scenes, arguments, seed) for seed in seeds]
        print_row(name, outcomes)
        if given.verbose:
            wrong = [seed for seed, one in zip(seeds, outcomes, strict=True) if one.wrong]
            doubtful = [seed for seed, one in zip(seeds, outcomes, strict=True) if not one.right or not one.trusted]
            print(f"  trusted and wrong {wrong}; not right or not trusted {doubtful}", flush=True)


if __name__ == "__main__":
    main()
