"""Everything together: what is trusted over all kinds of scenes, how much of it is wrong, and how calibrated it is.

    python benchmarks/together.py --seeds 20 --flights 2 --first-seed 102000 --jobs 2

One scene of each kind of the other benchmarks for each seed, and flights of each family: images, two views, point sets.
A body counts as shown if a scene shows five of its points or more, four of a set in space. "Right": trusted, no match
wrong and nine tenths of the shown points matched. "Wrong": trusted, with a match that is not true; "expected": as many
as the told probabilities say. Of a flight each frame counts, and "run" is the longest one of wrong frames. "ms" is the
median processor time of a scene. Scenes of ``few_leds`` and the fiducials, headsets and drones come from modules that
are no part of this repository, see `shared.scenes_of`; without them their rows are left out.

Then by tenths of what was told, for each geometry: the probability of trusted matches is right where no match is wrong,
that of others where the assignment is the truth; the confidence of a match, and of a point without one, where that is
true. A bin holds if the share that is right is within .03 of the mean told, or the mean within the interval. An
interval counts scenes, as the points of one are right or wrong together. So no two rows may show the same: families of
constellations have the same poses of a seed, motions the same scene with their number given or not, and each draws with
seeds of its own. Scenes without one true answer, such as two of the same object of which one is asked for, count in the
first table only.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from types import ModuleType
from typing import Any

import accuracy_scenes
import adversary
import adversary_rigs
import constellations
import drawn_scenes
import fiducials
import flights
import joblib
import numba
import numpy as np
import parts_in_space
import regular_models
import strange_scenes
import unrelated
from shared import Calibration, Integers, head, parser, row, scenes_of, timed

import rootmatch as rm

IMAGE, VIEWS, SPACE, FLIGHT, MODEL = "one image", "two views", "point sets", "flights", "drawn by the model"
MINIMUM = {IMAGE: 5, VIEWS: 8, SPACE: 4, MODEL: 5}
"""Shown points from which a right answer is asked for."""
FEW_LEDS = "4-4-LR", "4-6-LR", "5-8-LR", "4-6-R", "5-8-R", "4-6-L", "5-8-L"
"""LEDs of the right controller in view, clutter points, and the controllers that are looked for: the left one is its
mirror image, and never there."""
NO_ANSWER = ("tools", "unnamed-copy", "reflection", "near-board", "hidden-wand")
"""Kinds of strange scenes of which no labelling is the true one, or one of several is."""


@dataclass(frozen=True)
class Told:
    """What was told of one body, and what is true."""

    asked: bool
    """Whether it shows enough for a right answer."""
    trusted: bool
    right: bool
    wrong: bool
    probability: float | None
    as_told: bool
    matches: list[tuple[float, bool]]
    """Confidence of each matched point, and whether its match is true; none where no search was worth while."""
    unmatched: list[tuple[float, bool]]
    """Likewise of the others."""
    matched: bool = True
    counts: bool = True
    """Whether it counts in calibration."""
    run: int = 0
    """Of a flight: how many frames in a row are wrong, this one included."""


Scenes = Callable[[int], list[Told]]
"""The bodies of one seed."""


def of_sets(match: rm.Match, own: list[set[int]], minimum: int) -> Told:
    """A body whose points, or sightings, have any of their own detections."""
    assignment = (match.assignment if match.sightings is None else match.sightings.assignment).ravel()
    held = {int(j) for j, may in zip(assignment, own, strict=True) if j in may}  # several may have one that is merged
    true = [int(j) in may if j >= 0 else may <= held for j, may in zip(assignment, own, strict=True)]
    wrong = any(j >= 0 and not good for j, good in zip(assignment, true, strict=True))
    shown, matched = len(set().union(*own)), int((assignment >= 0).sum())
    confidence = match.confidence.ravel()
    told = len(confidence) == len(true) and not np.isnan(confidence).any()
    points = list(zip(assignment, zip(confidence.tolist(), true, strict=True), strict=True)) if told else []
    trusted = bool(match)
    return Told(
        shown >= minimum, trusted, trusted and not wrong and matched >= 0.9 * shown - 1e-9, trusted and wrong,
        match.probability, not wrong if trusted else all(true),
        [point for j, point in points if j >= 0], [point for j, point in points if j < 0], matched > 0,
    )  # fmt: skip


def of_one(match: rm.Match, truth: Integers, geometry: str) -> Told:
    """A body whose points have one detection each, −1 for none."""
    return of_sets(match, [{int(j)} if j >= 0 else set() for j in truth], MINIMUM[geometry])


def of_bodies(arguments: dict[str, Any], truths: list[list[set[int]]], geometry: str) -> list[Told]:
    """Bodies whose points, or sightings, have any of their own detections."""
    try:
        match = rm.match(**arguments, max_seconds=5.0)
    except rm.InputError:  # too few detections for one hyper-edge
        return []
    bodies = [match] if match.bodies is None else list(match.bodies.values())
    return [of_sets(body, truth, MINIMUM[geometry]) for body, truth in zip(bodies, truths, strict=True)]


def of_constellation(scenes: ModuleType, family: str, seed: int) -> list[Told]:
    told, truth = constellations.arguments(family, seed, scenes)
    return [of_one(rm.match(**told, seed=seed), truth, IMAGE)]


def of_few(xr: ModuleType, family: str, seed: int) -> list[Told]:
    shown, clutter, asked = family.split("-")
    frame = xr.few_leds(seed, int(shown), int(clutter))
    points, normals, labels = xr.bodies(asked)
    match = rm.match(
        points, frame["target"], rm.P3P(rm.Camera.from_matrix(xr.ROOM_K)), noise=0.3, normals=normals, seed=seed,
        view_angle=np.radians(70.0), bodies=labels if len(asked) > 1 else None,
    )  # fmt: skip
    truth = np.full(len(points), -1)
    (real,), right = np.nonzero(frame["owner"][:, 0] >= 0), np.flatnonzero(labels == "R")
    if len(right):
        truth[right[frame["owner"][real, 1]]] = real
    bodies = {asked: match} if match.bodies is None else match.bodies
    return [of_one(one, truth[labels == label], IMAGE) for label, one in bodies.items()]


def of_strange(kind: str, seed: int) -> list[Told]:
    scene = strange_scenes.KINDS[kind](np.random.default_rng([seed, list(strange_scenes.KINDS).index(kind)]))
    try:
        match = rm.match(**scene.told, noise=strange_scenes.NOISE, seed=seed)
    except rm.InputError:  # too few detections for one hyper-edge
        return []
    if match.sightings is not None:
        return [of_one(match, np.concatenate(scene.truth), IMAGE)]
    bodies, truths = [match], [scene.truth]
    if match.bodies is not None:
        labels, bodies = np.asarray(scene.told["bodies"]), list(match.bodies.values())
        each = [scene.truth[0][labels == label] for label in match.bodies]
        truths = [each] * len(each) if kind == "tools" else [[truth] for truth in each]
    found = []
    for body, may in zip(bodies, truths, strict=True):
        told = (of_one(body, truth, IMAGE) for truth in may)
        found.append(min(told, key=lambda one: (one.wrong, not one.right, not one.as_told)))
    if kind in NO_ANSWER:
        return [replace(one, asked=False, probability=None, counts=False) for one in found]
    return found


def of_adversary(rigs: bool, seed: int) -> list[Told]:
    scene = adversary_rigs.drawn(seed) if rigs else adversary.drawn(seed)
    return of_bodies(scene.arguments, scene.truths, IMAGE)


def of_model(kind: str, seed: int) -> list[Told]:
    made = drawn_scenes.drawn(seed, kind)
    return [] if made is None else of_bodies(*made, MODEL)


def of_case(case: accuracy_scenes.Case, geometry: str, seed: int) -> list[Told]:
    made = case.make(seed)
    match = rm.match(made.source, made.target, made.problem, noise=made.noise, seed=seed, **made.options)
    return [of_one(match, made.truth, geometry)]


def of_regular(kind: str, problem: str, seed: int) -> list[Told]:
    scene = regular_models.KINDS[kind](np.random.default_rng([seed, *kind.encode()]))
    if len(scene.target) < 6:
        return []
    given = regular_models.problem_of(problem, scene, seed)
    match = rm.match(scene.lamps, scene.target, given, noise=regular_models.NOISE, seed=seed)
    return [of_one(match, scene.truth, IMAGE)]


def of_fiducials(scenes: ModuleType, arguments: dict[str, Any], seed: int) -> list[Told]:
    if "tools" in arguments:
        source, labels, target, truth = scenes.tools(seed, stray=arguments["tools"])
        match = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.2), bodies=labels)
        assert match.bodies is not None
        return [of_one(one, truth[labels == label], SPACE) for label, one in match.bodies.items()]
    made = scenes.scene(seed=seed, **arguments)
    truth = np.full(len(made["truth"]), -1) if arguments.get("mirrored") else made["truth"]
    match = rm.match(made["source"], made["target"], rm.Rigid(), noise=made["noise"])
    own: list[set[int]] = [{int(j)} if j >= 0 else set() for j in truth]
    if made["moved"] >= 0 and match.assignment[made["moved"]] < 0:
        own[made["moved"]] = set()
    return [of_sets(match, own, MINIMUM[SPACE])]


def of_part(kind: str, seed: int) -> list[Told]:
    made = parts_in_space.KINDS[kind](np.random.default_rng([seed, list(parts_in_space.KINDS).index(kind)]))
    return [of_one(rm.match(made.source, made.target, seed=seed, **made.told), made.truth, SPACE)]


def of_unrelated(name: str, geometry: str, seed: int) -> list[Told]:
    source, target, told = unrelated.PROBLEMS[name](np.random.default_rng([seed, len(name)]))
    return [of_one(rm.match(source, target, **told, seed=seed), np.full(len(source), -1), geometry)]


def of_flight(xr: ModuleType, family: str, seed: int) -> list[Told]:
    tracker, bodies = flights.tracker_of(xr, family, None)
    out: list[Told] = []
    runs = [0] * len(bodies)
    rig = family in flights.RIGS
    for frame in flights.frames_of(xr, family, seed):
        frame = flights.merged(frame, 0.0)
        target: Any = (frame["target"], frame["camera"]) if rig else frame["target"]
        match = tracker.update(target, time=float(frame["time"]), prior=frame.get("prior"))
        for place, (label, number) in enumerate(bodies):
            one = match if label is None else match.bodies[label]  # type: ignore[index]
            full, bad, shown = flights.judged(frame, number, one, rig=rig)
            trusted = bool(one)
            runs[place] = runs[place] + 1 if trusted and bad else 0
            out.append(
                Told(
                    shown, trusted, trusted and full, trusted and bad, one.probability, not bad, [], [],
                    counts=trusted, run=runs[place],
                )
            )  # fmt: skip
    return out


def kinds_of(folder: str | None) -> Iterator[tuple[str, str, Scenes]]:
    """Name, geometry and scenes of each row; those whose module of scenes is absent are left out."""

    def bound(make: Callable[..., list[Told]], *given: Any, number: int = 0, of: int = 1) -> Scenes:
        """The scenes of one of so many rows that would show the same of a seed: each has seeds of its own."""
        return lambda seed: make(*given, of * seed + number)

    scenes, xr, space = (scenes_of(name, folder) for name in ("constellations", "xr", "fiducials"))
    if scenes is not None:
        families = [one for one in constellations.FAMILIES if one != "real" and not one.startswith("unrelated")]
        for k, family in enumerate(families):
            make = bound(of_constellation, scenes, family, number=k, of=len(families))
            yield f"constellations, {family}", IMAGE, make
    if xr is not None:
        for k, family in enumerate(FEW_LEDS):
            yield f"few LEDs, {family}", IMAGE, bound(of_few, xr, family, number=k, of=len(FEW_LEDS))
    for kind in strange_scenes.KINDS:
        yield f"strange scenes, {kind}", IMAGE, bound(of_strange, kind)
    for kind in regular_models.KINDS:
        if not kind.startswith("runway"):
            yield f"regular models, {kind}", IMAGE, bound(of_regular, kind, "up2p 1°")
    for k in range(10):
        yield "scenes drawn to break it", IMAGE, bound(of_adversary, False, number=k, of=10)
    for k in range(3):
        yield "the same with rigs", IMAGE, bound(of_adversary, True, number=k, of=10)
    for kind in drawn_scenes.KINDS:
        yield f"{MODEL}, {kind}", MODEL, bound(of_model, kind)
    cases = [*accuracy_scenes.simulated(), *accuracy_scenes.ambiguous()]
    for k, case in enumerate(cases):
        if "b 5" in case.name and "prior" in case.name:
            continue  # it says what is not true
        geometry = VIEWS if case.table == "two views" else IMAGE
        yield f"{case.table}, {case.name}", geometry, bound(of_case, case, geometry, number=k, of=len(cases))
    if space is not None:
        for name, arguments in (fiducials.ROWS | fiducials.OTHERS).items():
            if "unrelated" not in arguments:
                yield f"fiducials, {name}", SPACE, bound(of_fiducials, space, arguments)
    for kind in parts_in_space.KINDS:
        yield f"parts in space, {kind}", SPACE, bound(of_part, kind)
    for name in unrelated.PROBLEMS:
        geometry = SPACE if "," in name and "p3p" not in name else VIEWS if name in ("3p1", "planar") else IMAGE
        yield f"unrelated, {name}", geometry, bound(of_unrelated, name, geometry)
    if xr is not None:
        for family in flights.FRAMES:
            yield f"flights, {family}", FLIGHT, bound(of_flight, xr, family)


@dataclass(frozen=True)
class Judged:
    """A scene of a row."""

    seed: int
    bodies: list[Told]
    seconds: float
    """Of the processor."""


def results(place: int, seeds: list[int], folder: str | None) -> list[Judged]:
    """The scenes of one row."""
    numba.set_num_threads(1)
    make = next(itertools.islice(kinds_of(folder), place, None))[2]
    return [Judged(seed, *timed(partial(make, seed))) for seed in seeds]


COLUMNS = (
    "scenes", "bodies", "shown", "right of these", "trusted", "wrong", "expected", "run", "ms", "seeds of wrong",
)  # fmt: skip


def print_row(name: str, scenes: list[Judged]) -> None:
    """One row of the first table."""
    every = [one for scene in scenes for one in scene.bodies]
    asked, trusted = [one for one in every if one.asked], [one for one in every if one.trusted]
    expected = sum(1.0 - one.probability for one in trusted if one.probability is not None)
    row(
        name, len(every), len(asked), sum(one.right for one in asked), len(trusted), sum(one.wrong for one in every),
        f"{expected:.1f}", max((one.run for one in every), default=0) or "",
        f"{1e3 * np.median([scene.seconds for scene in scenes]):.0f}",
        " ".join(str(scene.seed) for scene in scenes if any(one.wrong for one in scene.bodies)),
    )  # fmt: skip


def print_calibration(geometry: str, scenes: list[Judged]) -> None:
    """How often what was told of a geometry was right."""
    counted = [[one for one in scene.bodies if one.counts] for scene in scenes]
    of_bodies, of_matches, of_unmatched = Calibration(), Calibration(), Calibration()
    for bodies in counted:
        of_bodies.add((one.probability, one.as_told) for one in bodies if one.matched and one.probability is not None)
        of_matches.add(point for one in bodies for point in one.matches)
        of_unmatched.add(point for one in bodies for point in one.unmatched)
    of_bodies.print(f"{geometry}: probability")
    of_matches.print(f"{geometry}: confidence of matches")
    of_unmatched.print(f"{geometry}: confidence of points without one")


def main() -> None:
    ask = parser(__doc__, seeds=5, flights=1, first_seed=1000, jobs=1)
    ask.add_argument("--rows", nargs="+", default=[], help="those whose name contains one of these texts")
    ask.add_argument("--scenes", help="folder of the scenes")
    given = ask.parse_args()
    rows = [
        (place, name, geometry)
        for place, (name, geometry, _) in enumerate(kinds_of(given.scenes))
        if not given.rows or any(text in name for text in given.rows)
    ]
    work = [
        (
            place,
            list(range(given.first_seed, given.first_seed + (given.flights if geometry == FLIGHT else given.seeds))),
        )
        for place, _, geometry in rows
    ]
    found = joblib.Parallel(n_jobs=given.jobs, return_as="generator")(
        joblib.delayed(results)(place, seeds, given.scenes) for place, seeds in work
    )
    by_row, by_kind, by_geometry = (defaultdict[str, list[Judged]](list) for _ in range(3))
    for (_, name, geometry), scenes in zip(rows, found, strict=True):
        by_row[name] += scenes
        by_kind[name if name.startswith("flights") else name.split(",")[0]] += scenes
        by_geometry[geometry] += scenes
    head(*COLUMNS)
    for name, scenes in by_row.items():
        print_row(name, scenes)
    print()
    head(*COLUMNS)
    for name, scenes in by_kind.items():
        print_row(name, scenes)
    for geometry, scenes in by_geometry.items():
        print_row(f"**{geometry}**", scenes)
    print_row("**all**", list(itertools.chain.from_iterable(by_row.values())))
    for geometry, scenes in by_geometry.items():
        print_calibration(geometry, scenes)


if __name__ == "__main__":
    main()
