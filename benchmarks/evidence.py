"""What the model of a body's image believes of the hypotheses that a match finds, beside what the match says today.

    python benchmarks/evidence.py --seeds 60 --first-seed 1000

What is believed is what `rootmatch.explain.image_decision.believed` says with ``--min-probability``. "Right": no match wrong
and nine tenths of the visible points matched. "Wrong": any match wrong, of a body in view or of one that is not. The
model is given the assignment and the alternatives of the match of each body among all detections.

``few-V-C`` is one frame of ``few_leds`` of ``xr.py`` with V LEDs of the right controller visible and C clutter points;
``-R``, ``-L`` and ``-LR`` say which controllers are looked for. The left one, its mirror image, is never there. The
others are families of benchmarks/constellations.py. Scenes are found as there. Defaults were chosen on seeds below
2000.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from constellations import arguments, judge, load_scenes
from numpy.typing import NDArray

import rootmatch as rm
from rootmatch.explain.image_decision import MIN_PROBABILITY, believed, posteriors_of
from rootmatch.model.posterior import Posterior
from rootmatch.result import Match

Integers = NDArray[np.int64]

FAMILIES = (
    "few-4-4-LR", "few-4-6-LR", "few-5-8-LR", "few-4-6-R", "few-5-8-R", "few-4-6-L", "few-5-8-L",
    "d6-0-0", "d6-5-0", "d6-15-0", "d10-5-0", "sim-5-0", "sim-15-20", "sim-5-0-near", "unrelated-p3p", "unrelated-up2p",
)  # fmt: skip


@dataclass
class Tally:
    """What came of one body in the scenes of a family."""

    scenes: int = 0
    right_today: int = 0
    wrong_today: int = 0
    right: int = 0
    wrong: int = 0
    first: int = 0
    seconds: float = 0.0
    wrong_seeds: list[int] = field(default_factory=list)
    lost_seeds: list[int] = field(default_factory=list)


def posteriors(matches: dict[Any, Match]) -> dict[Any, Posterior]:
    """What the model makes of the hypotheses of each body's match."""
    found = [(one.task, [one.assignment, *(other for other, _ in one.alternatives)]) for one in matches.values()]
    return dict(zip(matches, posteriors_of(found), strict=True))


def few_leds(xr: ModuleType, family: str, seed: int) -> tuple[dict[Any, Match], dict[Any, Integers]]:
    """The match of each controller that is looked for, by itself, and where its points are."""
    _, shown, clutter, given = family.split("-")
    frame = xr.few_leds(seed, int(shown), int(clutter))
    points, normals, labels = xr.bodies(given)
    owner = frame["owner"]
    matches, truths = {}, {}
    for label in given:
        own = labels == label
        matches[label] = rm.match(
            points[own], frame["target"], rm.P3P(rm.Camera.from_matrix(xr.ROOM_K)), noise=0.3, normals=normals[own],
            view_angle=np.radians(70.0), seed=seed,
        )  # fmt: skip
        truth = np.full(int(own.sum()), -1)
        if label == "R":
            real = np.flatnonzero(owner[:, 0] >= 0)
            truth[owner[real, 1]] = real
        truths[label] = truth
    if len(given) == 1:
        return matches, truths
    together = rm.match(
        points, frame["target"], rm.P3P(rm.Camera.from_matrix(xr.ROOM_K)), noise=0.3, normals=normals,
        view_angle=np.radians(70.0), seed=seed, bodies=labels,
    )  # fmt: skip
    assert together.bodies is not None
    for label in given:
        vars(matches[label])["today"] = together.bodies[label]
    return matches, truths


def one_scene(
    xr: ModuleType, scenes: ModuleType | None, family: str, seed: int, tallies: dict[Any, Tally], least: float
) -> None:
    """Match one scene and count."""
    if family.startswith("few"):
        matches, truths = few_leds(xr, family, seed)
    else:
        told, truth = arguments(family, seed, scenes)
        matches, truths = {"": rm.match(**told, seed=seed)}, {"": truth}
    started = time.perf_counter()
    told_by_model = posteriors(matches)
    seconds = time.perf_counter() - started
    for label, found in told_by_model.items():
        tally, truth = tallies.setdefault(label, Tally()), truths[label]
        today = vars(matches[label]).get("today", matches[label])
        tally.scenes += 1
        tally.seconds += seconds / len(matches)
        _, wrong, full = judge(today.assignment, truth)
        was_right = today.status is rm.Status.MATCHED and full and (truth >= 0).any()
        tally.right_today += bool(was_right)
        tally.wrong_today += today.status is rm.Status.MATCHED and wrong > 0
        if not len(found.probabilities):
            continue
        first = found.modes.assignments[0]
        tally.first += bool(judge(first, truth)[2] and (truth >= 0).any())
        status, assignment = believed(found, least)
        right = False
        if status is rm.Status.MATCHED:
            _, wrong, full = judge(assignment, truth)
            right = bool(full and (truth >= 0).any())
            tally.right += right
            if wrong:
                tally.wrong += 1
                tally.wrong_seeds.append(seed)
        if was_right and not right:
            tally.lost_seeds.append(seed)


def load_xr(scenes: ModuleType | None) -> ModuleType | None:
    """The module of controllers beside that of constellations."""
    if scenes is None or scenes.__file__ is None:
        return None
    spec = importlib.util.spec_from_file_location("xr", Path(scenes.__file__).with_name("xr.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> int:
    """Print one row for each family and body."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--families", nargs="+", default=FAMILIES)
    parser.add_argument("--min-probability", type=float, default=MIN_PROBABILITY)
    parser.add_argument("--scenes", help="folder of the scenes")
    given = parser.parse_args()
    scenes = load_scenes(given.scenes)
    xr = load_xr(scenes)
    columns = ("family", "body", "scenes", "right today", "wrong today", "right", "wrong", "first is right", "ms")
    print(f"| {' | '.join(columns)} | wrong, lost seeds |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for family in given.families:
        if xr is None and not family.startswith("unrelated"):
            continue
        tallies: dict[Any, Tally] = {}
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            one_scene(xr, scenes, family, seed, tallies, given.min_probability)  # type: ignore[arg-type]
        for label, one in tallies.items():
            print(
                f"| {family} | {label} | {one.scenes} | {one.right_today} | {one.wrong_today} | {one.right} | "
                f"{one.wrong} | {one.first} | {1e3 * one.seconds / one.scenes:.0f} | {one.wrong_seeds} "
                f"{one.lost_seeds} |",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
