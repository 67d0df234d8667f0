"""Accuracy under noise, clutter, occlusion, several motions and ambiguity, and on measured data, against a yardstick.

The yardstick is a folder with ``ransac.py`` (``ransac_match``, ``ransac_match_multi``), given by ``--peers`` or
ROOTMATCH_PEERS, and run on the same scenes in the same process; between two views it is the true geometry itself.
Rows are printed as Markdown as they come. Every scene counts.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, fields
from types import ModuleType
from typing import Any

import joblib
import numba
import numpy as np
from accuracy_scenes import Case, Instance, ambiguous, measured, simulated
from matches import TOLERANCE
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from shared import LISTED, Integers, head, parser, row, yardstick_of

import rootmatch as rm

RIGHT = 0.9
"""Fraction of the points with an image that a right assignment matches; it matches none wrongly."""
NOTHING = math.nan
NO_PEERS = "none"


@dataclass(frozen=True)
class Outcome:
    """Result on one scene; NaN where a figure has no meaning."""

    case: str
    seed: int
    accuracy: float
    """Fraction of the points with an image that are matched correctly."""
    precision: float
    """Fraction of the matches that are correct, 1 without any."""
    right: float
    """1 where no match is wrong and `RIGHT` of the points are matched."""
    shown: float
    """1 where the assignment or one of the first `shared.LISTED` alternatives is right."""
    rand: float
    """Adjusted Rand index of the motion labels."""
    own: float
    """Accuracy of the true geometry between two views."""
    status: str
    seconds: float
    peer_accuracy: float = NOTHING
    peer_precision: float = NOTHING
    peer_rand: float = NOTHING
    peer_seconds: float = NOTHING


def right(assignment: Integers, truth: Integers) -> bool:
    """Whether no match is wrong and nearly all points are matched."""
    matched = assignment >= 0
    return bool((assignment[matched] == truth[matched]).all() and matched.sum() >= RIGHT * (truth >= 0).sum())


def figures(assignment: Integers, truth: Integers) -> tuple[float, float]:
    """Accuracy and precision."""
    visible, matched, same = truth >= 0, assignment >= 0, assignment == truth
    return float(same[visible].mean()), float(same[matched].mean()) if matched.any() else 1.0


def adjusted_rand(first: Integers, second: Integers) -> float:
    """Adjusted Rand index of two partitions (Hubert & Arabie 1985)."""
    table = np.zeros((first.max() + 2, second.max() + 2))
    np.add.at(table, (first, second), 1)

    def pairs(counts: NDArray[np.float64]) -> float:
        return float((counts * (counts - 1) / 2).sum())

    together, rows, columns = pairs(table), pairs(table.sum(axis=1)), pairs(table.sum(axis=0))
    expected = rows * columns / math.comb(len(first), 2)
    maximum = 0.5 * (rows + columns)
    return 1.0 if maximum == expected else (together - expected) / (maximum - expected)


def own_accuracy(instance: Instance) -> float:
    """Accuracy of the Hungarian assignment of the pixel distances to the true epipolar lines."""
    problem: Any = instance.problem
    assert instance.pose is not None
    rotation, t = instance.pose
    first, second = problem.cameras
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    fundamental = np.linalg.inv(second.matrix).T @ cross @ rotation @ np.linalg.inv(first.matrix)
    lines = np.column_stack([instance.source, np.ones(len(instance.source))]) @ fundamental.T
    distance = np.abs(lines @ np.column_stack([instance.target, np.ones(len(instance.target))]).T)
    distance /= np.linalg.norm(lines[:, :2], axis=1)[:, None]
    _, assignment = linear_sum_assignment(distance)
    return figures(assignment, instance.truth)[0]


def theirs(case: Case, instance: Instance, seed: int, yardstick: ModuleType, patience: float) -> dict[str, float]:
    """The yardstick's figures; restores the number of threads that it changes."""
    allowed = numba.get_num_threads()
    problem: Any = instance.problem
    upright = problem.name == "up2p"
    verticals = {"up_world": problem.vertical_world, "up_cam": problem.vertical_camera} if upright else {}
    matrix, tolerance = problem.camera.matrix, TOLERANCE * float(np.mean(instance.noise))
    source, target = instance.source, instance.target
    labels = np.where(instance.truth < 0, -1, 0)
    started = time.perf_counter()
    if case.yardstick == "joint":
        assignment, _, labels = yardstick.ransac_match_multi(
            source, target, matrix, tolerance, max_seconds=patience, seed=seed, mode="joint", threads=allowed,
            **verticals,
        )  # fmt: skip
    else:
        options = {"seed": seed, "problem": problem.name, "threads": allowed, "max_seconds": patience, **verticals}
        assignment = yardstick.ransac_match(source, target, matrix, tolerance, **options)[0]
        if case.yardstick == "peel":
            labels = np.where(assignment >= 0, 0, -1)
            points, pixels = np.flatnonzero(assignment < 0), np.setdiff1d(np.arange(len(target)), assignment)
            if min(len(points), len(pixels)) >= 4:
                try:
                    rest = yardstick.ransac_match(source[points], target[pixels], matrix, tolerance, **options)[0]
                except np.linalg.LinAlgError:  # it fails on these points: no second motion
                    rest = np.full(len(points), -1)
                found = points[rest >= 0]
                assignment[found], labels[found] = pixels[rest[rest >= 0]], 1
    seconds = time.perf_counter() - started
    numba.set_num_threads(allowed)
    accuracy, precision = figures(assignment, instance.truth)
    rand = adjusted_rand(labels, instance.labels) if "motions" in instance.options else NOTHING
    return {
        "peer_accuracy": accuracy, "peer_precision": precision, "peer_rand": rand, "peer_seconds": seconds,
    }  # fmt: skip


def outcome(case: Case, seed: int, yardstick: ModuleType | None, patience: float) -> Outcome:
    """Both matchers on one scene."""
    instance = case.make(seed)
    truth = instance.truth
    match = rm.match(
        instance.source, instance.target, instance.problem, noise=instance.noise, seed=seed, **instance.options
    )
    accuracy, precision = figures(match.assignment, truth)
    listed = [match.assignment, *(other for other, _ in match.alternatives[:LISTED])]
    return Outcome(
        case.name, seed, accuracy, precision,
        float(right(match.assignment, truth)), float(any(right(one, truth) for one in listed)),
        adjusted_rand(match.motion_labels, instance.labels) if "motions" in instance.options else NOTHING,
        NOTHING if instance.pose is None else own_accuracy(instance),
        match.status.name.lower(), match.seconds,
        **({} if yardstick is None or case.yardstick == "none" else theirs(case, instance, seed, yardstick, patience)),
    )  # fmt: skip


def batch(case: Case, seeds: list[int], peers: str | None, patience: float) -> list[Outcome]:
    """Some scenes of a case; the first is matched twice, as the first call compiles."""
    yardstick = None if case.yardstick == "none" or peers == NO_PEERS else yardstick_of(peers)
    outcome(case, seeds[0], yardstick, patience=0.1)
    return [outcome(case, seed, yardstick, patience) for seed in seeds]


HEAD = (
    "scenes", "count", "accuracy", "precision", "labels", "matched: right", "ambiguous: shown", "untrusted", "failed",
    "s", "worst", "yardstick", "its s", "goal", "",
)  # fmt: skip


def print_row(case: Case, outcomes: list[Outcome]) -> None:
    """Print one row of the table: means over all scenes, the median and the worst time."""
    mean = {
        item.name: float(np.mean([getattr(one, item.name) for one in outcomes]))
        for item in fields(Outcome)
        if item.name not in ("case", "status")
    }
    by_status = {
        name: [one for one in outcomes if one.status == name] for name in ("matched", "ambiguous", "untrusted")
    }
    times = np.array([one.seconds for one in outcomes])
    goals, missed = [], False
    for name, minimum in case.reach.items():
        value, minimum = (mean["accuracy"], mean["own"] - minimum) if name == "own" else (mean[name], minimum)
        goals.append(f"{'accuracy' if name == 'own' else name} {minimum:.3f}")
        missed |= value < minimum - 1e-9

    def number(value: float, digits: int) -> str:
        return "–" if math.isnan(value) else f"{value:.{digits}f}"

    def share(which: list[Outcome], figure: str) -> str:
        return f"{sum(getattr(one, figure) for one in which):.0f} of {len(which)}" if which else "–"

    peer = mean["own"] if math.isnan(mean["peer_accuracy"]) else mean["peer_accuracy"]
    row(
        case.name, len(outcomes), number(mean["accuracy"], 4), number(mean["precision"], 4),
        number(mean["rand"], 3), share(by_status["matched"], "right"), share(by_status["ambiguous"], "shown"),
        len(by_status["untrusted"]), sum(one.accuracy < 0.5 for one in outcomes),
        f"{np.median(times):.3f}", f"{times.max():.2f}", number(peer, 4),
        number(float(np.median([one.peer_seconds for one in outcomes])), 3), ", ".join(goals),
        "" if not goals else "MISSED" if missed else "reached",
    )  # fmt: skip


def main() -> None:
    ask = parser(__doc__, seeds=10, first_seed=1000, jobs=1)
    ask.add_argument("--scenes", nargs="+", default=[], help="kinds whose table or name contains one of these texts")
    ask.add_argument("--peers", help="folder of the yardstick; default: ROOTMATCH_PEERS")
    ask.add_argument("--no-yardstick", action="store_true")
    ask.add_argument("--patience", type=float, default=20.0, help="seconds after which the yardstick gives up")
    options = ask.parse_args()
    cases = [
        case
        for case in [*simulated(), *ambiguous(), *measured()]
        if not options.scenes or any(text in f"{case.table}: {case.name}" for text in options.scenes)
    ]
    peers = NO_PEERS if options.no_yardstick else options.peers
    table = ""
    for case in cases:
        if case.table != table:
            table = case.table
            print(f"\n**{table}**, seeds from {options.first_seed}\n")
            head(*HEAD)
        seeds = list(range(options.first_seed, options.first_seed + min(options.seeds, case.scenes)))
        parts = [seeds[k :: options.jobs] for k in range(min(options.jobs, len(seeds)))]
        done = joblib.Parallel(n_jobs=options.jobs)(
            joblib.delayed(batch)(case, part, peers, options.patience) for part in parts
        )
        print_row(case, sorted((one for part in done for one in part), key=lambda one: one.seed))


if __name__ == "__main__":
    main()
