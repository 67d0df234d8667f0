"""Whole matches against a hypothesise-and-verify matcher, on the same scenes in the same process.

The yardstick is a folder with ``ransac.py`` (function ``ransac_match``), given by ``--peers`` or ROOTMATCH_PEERS;
without it only this library is timed. Every scene counts; those less than half right are listed as failures.
"""

from __future__ import annotations

import json
import statistics
from dataclasses import asdict, dataclass
from types import ModuleType
from typing import Any

import numba
import numpy as np
from shared import parser, timed, yardstick_of

import rootmatch as rm
from rootmatch.simulation import SCENES, Scene

FIRST_SEED = 1000
"""Lower seeds were used to tune the defaults."""
TOLERANCE = 3.5
"""The yardstick's distance within which a point is matched, in σ, as in its own benchmark."""
PATIENCE = 60.0
"""Seconds after which the yardstick gives up."""


FRAMES = 9
"""Frames of a tracked scene, after a warm-up frame."""


@dataclass(frozen=True)
class Case:
    """A kind of scene and the goals for it."""

    problem: str
    points: int
    outliers: int
    hidden: int = 0
    sigma: float = 1.0
    ratio: float = 1.0
    """Most time that the median may take, in multiples of the yardstick's median."""
    seconds: float | None = None
    """Most seconds that the median may take."""
    motions: int = 1
    """Rigid motions, with the points split evenly among them; the yardstick uses its joint mode."""
    tracked: bool = False
    """Frame after frame of one `Matcher`; the median of FRAMES."""

    @property
    def name(self) -> str:
        hidden = f" ({self.hidden} unseen)" if self.hidden else ""
        motions = f", {self.motions} motions" if self.motions > 1 else ""
        return f"{self.problem} {self.points} + {self.outliers}{hidden}{motions}{', tracked' if self.tracked else ''}"


CASES = [
    Case("p3p", 5, 3, sigma=0.5, seconds=0.002, tracked=True),
    Case("p3p", 10, 10),
    Case("p3p", 20, 20),
    Case("p3p", 50, 50, seconds=5.0),
    Case("p3p", 100, 100, seconds=20.0),
    Case("p3p", 10, 10, hidden=10, sigma=0.5),
    Case("up2p", 10, 10),
    Case("up2p", 20, 20),
    Case("up2p", 50, 50),
    Case("up2p", 100, 100, seconds=1.0),
    Case("up2p", 10, 10, hidden=10, sigma=0.5),
    Case("up2p", 40, 0, motions=8, ratio=0.2),
]


@dataclass(frozen=True)
class Row:
    """Result of a case; times in processor seconds, of all threads together."""

    case: str
    runs: int
    median: float
    worst: float
    accuracy: float
    failures: list[int]
    evaluations: float
    peer_median: float | None
    peer_accuracy: float | None
    peer_failures: list[int] | None
    reached: bool | None


def ours(case: Case, scene: Scene, seed: int) -> tuple[rm.Match, float]:
    """Our match and its seconds."""
    if not case.tracked:
        options = {"noise": case.sigma, "seed": seed, "motions": case.motions}
        return timed(lambda: rm.match(scene.source, scene.target, scene.problem, **options))
    matcher = rm.Matcher(scene.source, scene.problem, noise=case.sigma, seed=seed)
    match = matcher.match(scene.target)
    return match, statistics.median(timed(lambda: matcher.match(scene.target))[1] for _ in range(FRAMES))


def theirs(case: Case, scene: Scene, seed: int, yardstick: ModuleType) -> tuple[Any, float]:
    """The yardstick's assignment and its seconds; restores the number of threads that it changes."""
    allowed = numba.get_num_threads()
    given = scene.source, scene.target, scene.cameras[0].matrix, TOLERANCE * case.sigma
    if case.motions > 1:
        answer, seconds = timed(lambda: yardstick.ransac_match_multi(*given, max_seconds=PATIENCE, seed=seed))
    else:
        answer, seconds = timed(
            lambda: yardstick.ransac_match(*given, max_seconds=PATIENCE, seed=seed, problem=case.problem)
        )
    numba.set_num_threads(allowed)
    return answer[0], seconds


def run(case: Case, seeds: list[int], yardstick: ModuleType | None) -> Row:
    """All seeds of a case, both matchers alternating."""
    make = SCENES[case.problem]
    mine: list[tuple[float, float, float]] = []
    other: list[tuple[float, float]] = []
    for turn, seed in enumerate([seeds[0], *seeds]):
        scene = make(case.points, case.outliers, noise=case.sigma, seed=seed, hidden=case.hidden, motions=case.motions)
        match, seconds = ours(case, scene, seed)
        if turn:  # the first time compiles
            mine.append((seconds, scene.accuracy(match.assignment), float(match.evaluated)))
        if yardstick is not None:
            assignment, seconds = theirs(case, scene, seed, yardstick)
            if turn:
                other.append((seconds, scene.accuracy(assignment)))
    times, accuracies, evaluations = (np.array(column) for column in zip(*mine, strict=True))
    median, accuracy = float(np.median(times)), float(accuracies.mean())
    peer_median = peer_accuracy = peer_failures = None
    reached: bool | None = None if case.seconds is None else median <= case.seconds
    if other:
        peer_times, peer_accuracies = (np.array(column) for column in zip(*other, strict=True))
        peer_median, peer_accuracy = float(np.median(peer_times)), float(peer_accuracies.mean())
        peer_failures = [seed for seed, value in zip(seeds, peer_accuracies, strict=True) if value < 0.5]
        reached = accuracy >= peer_accuracy - 0.01 and reached is not False and median <= case.ratio * peer_median
    return Row(
        case.name, len(seeds), median, float(times.max()), accuracy,
        [seed for seed, value in zip(seeds, accuracies, strict=True) if value < 0.5],
        float(statistics.median(evaluations)), peer_median, peer_accuracy, peer_failures, reached,
    )  # fmt: skip


def line(row: Row) -> str:
    """One row of the table."""
    text = (
        f"{row.case:30s} {1e3 * row.median:9.2f} {1e3 * row.worst:9.1f}   {row.accuracy:.4f} {len(row.failures):3d}"
        f"   {row.evaluations:9.3g}"
    )
    if row.peer_median is not None and row.peer_accuracy is not None and row.peer_failures is not None:
        text += f"   {1e3 * row.peer_median:9.2f}   {row.peer_accuracy:.4f} {len(row.peer_failures):3d}"
        text += f"   {row.median / row.peer_median:6.2f}"
    return text + {None: "", True: "   reached", False: "   MISSED"}[row.reached]


def main() -> None:
    ask = parser(__doc__, seeds=20)
    ask.add_argument("--peers", help="folder of the yardstick; default: ROOTMATCH_PEERS")
    ask.add_argument("--only", nargs="+", default=[], help="cases whose name contains one of these texts")
    ask.add_argument("--json", action="store_true", help="print one JSON object")
    options = ask.parse_args()
    yardstick = yardstick_of(options.peers)
    seeds = list(range(FIRST_SEED, FIRST_SEED + options.seeds))
    rows = []
    if not options.json:
        print(f"seeds {seeds[0]} … {seeds[-1]}; milliseconds: median and worst; accuracy and failures; evaluations")
    for case in CASES:
        if options.replace_points and not any(text in case.name for text in options.replace_points):
            continue
        rows.append(run(case, seeds, yardstick))
        if not options.json:
            print(line(rows[-1]), flush=True)
    if options.json:
        print(json.dumps({"seeds": seeds, "rows": [asdict(row) for row in rows]}))


if __name__ == "__main__":
    main()
