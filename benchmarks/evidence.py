"""What is trusted on scenes that no default was chosen for: few LEDs, mirror images, headsets, unrelated points.

    python benchmarks/evidence.py --seeds 60 --first-seed 20000

"Right": no match wrong and nine tenths of the visible points. "Trusted and wrong": the status is "matched" and any
match is wrong, of a body in view or of one that is not. "First": right, whatever the status.

``few-V-C`` is one frame of ``few_leds`` of ``xr.py`` with V LEDs of the right controller visible and C clutter points;
``-R``, ``-L`` and ``-LR`` say which controllers are looked for. The left one, its mirror image, is never there. The
others are families of benchmarks/constellations.py. Scenes are found as there. Defaults were chosen on seeds below
2000.

At the end: how often matches and assignments were right, by bins of their confidence and probability. An interval
counts scenes, not matches: the matches of one scene share its pose, and are right or wrong together.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
from constellations import arguments
from shared import Integers, head, judge, parser, row, scenes_of

import rootmatch as rm

FAMILIES = (
    "few-4-4-LR", "few-4-6-LR", "few-5-8-LR", "few-4-6-R", "few-5-8-R", "few-4-6-L", "few-5-8-L",
    "d6-0-0", "d6-5-0", "d6-15-0", "d10-5-0", "sim-5-0", "sim-15-20", "sim-5-0-near", "unrelated-p3p", "unrelated-up2p",
)  # fmt: skip


@dataclass
class Tally:
    """What came of one body in the scenes of a family."""

    scenes: int = 0
    right: int = 0
    wrong: int = 0
    ambiguous: int = 0
    first: int = 0
    wrong_seeds: list[int] = field(default_factory=list)


@dataclass
class Calibration:
    """What was told of matches, or of assignments, and whether it was so."""

    told: list[float] = field(default_factory=list)
    was: list[bool] = field(default_factory=list)
    scene: list[int] = field(default_factory=list)

    def add(self, told: list[float], was: list[bool]) -> None:
        """Add those of one scene."""
        self.scene += [self.scene[-1] + 1 if self.scene else 0] * len(told)
        self.told += told
        self.was += was

    def lines(self, bins: int = 10) -> Iterator[str]:
        """A row for each of some bins of equal width."""
        told, was, scene = np.array(self.told), np.array(self.was), np.array(self.scene)
        place = np.minimum((told * bins).astype(int), bins - 1)
        for k in range(bins):
            own = place == k
            if own.any():
                share = was[own].mean()
                off = np.bincount(scene[own], was[own] - share)
                scenes = len(np.unique(scene[own]))
                half = 1.96 * max(float(np.sqrt((off**2).sum())) / own.sum(), 0.5 / scenes)
                yield f"| {k / bins:.1f} | {own.sum()} | {scenes} | {told[own].mean():.3f} | {share:.3f} ± {half:.3f} |"


def few_leds(xr: ModuleType, family: str, seed: int, least: float | None) -> dict[Any, tuple[rm.Match, Integers]]:
    """The match of each controller that is looked for, and where its points are."""
    _, shown, clutter, given = family.split("-")
    frame = xr.few_leds(seed, int(shown), int(clutter))
    points, normals, labels = xr.bodies(given)
    match = rm.match(
        points, frame["target"], rm.P3P(rm.Camera.from_matrix(xr.ROOM_K)), noise=0.3, normals=normals, seed=seed,
        view_angle=np.radians(70.0), bodies=labels if len(given) > 1 else None, min_probability=least,
    )  # fmt: skip
    found = {}
    for label in given:
        truth = np.full(int((labels == label).sum()), -1)
        if label == "R":
            real = np.flatnonzero(frame["owner"][:, 0] >= 0)
            truth[frame["owner"][real, 1]] = real
        found[label] = (match if match.bodies is None else match.bodies[label], truth)
    return found


def count(tally: Tally, match: rm.Match, truth: Integers, seed: int) -> None:
    """Count one body of one scene."""
    _, wrong, full = judge(match.assignment, truth)
    full = bool(full and (truth >= 0).any())
    tally.scenes += 1
    tally.first += full
    tally.ambiguous += match.status is rm.Status.AMBIGUOUS
    if match:
        tally.right += full
        tally.wrong += wrong > 0
        if wrong:
            tally.wrong_seeds.append(seed)


def main() -> None:
    """Print one row for each family and body, and the calibration."""
    ask = parser(__doc__, seeds=20, first_seed=1000)
    ask.add_argument("--families", nargs="+", default=FAMILIES)
    ask.add_argument("--min-probability", type=float)
    ask.add_argument("--scenes", help="folder of the scenes")
    given = ask.parse_args()
    scenes, xr = (scenes_of(name, given.scenes) for name in ("constellations", "xr"))
    head(
        "family",
        "body",
        "scenes",
        "trusted and right",
        "trusted and wrong",
        "ambiguous",
        "first",
        "ms",
        "seeds of wrong",
    )
    of_matches, of_assignments = Calibration(), Calibration()
    for family in given.families:
        if xr is None and not family.startswith("unrelated"):
            continue
        tallies: dict[Any, Tally] = {}
        seconds = []
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            started = time.perf_counter()
            if family.startswith("few"):
                found = few_leds(xr, family, seed, given.min_probability)  # type: ignore[arg-type]
            else:
                told, truth = arguments(family, seed, scenes)
                found = {"": (rm.match(**told, seed=seed, min_probability=given.min_probability), truth)}
            seconds.append(time.perf_counter() - started)
            for label, (match, truth) in found.items():
                count(tallies.setdefault(label, Tally()), match, truth, seed)
                matched = match.assignment >= 0
                right = (match.assignment == truth)[matched]
                of_matches.add(match.confidence[matched].tolist(), right.tolist())
                if match.probability is not None and matched.any():
                    of_assignments.add([match.probability], [bool(right.all())])
        for label, one in tallies.items():
            figures = one.scenes, one.right, one.wrong, one.ambiguous, one.first, f"{1e3 * np.median(seconds):.0f}"
            row(family, label, *figures, one.wrong_seeds)
    for name, calibration in (("confidence", of_matches), ("probability", of_assignments)):
        print()
        head(f"{name} from", "number", "scenes", "mean", "right")
        print("\n".join(calibration.lines()), flush=True)


if __name__ == "__main__":
    main()
