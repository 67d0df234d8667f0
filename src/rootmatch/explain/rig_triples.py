"""Poses of a rig from three sightings in one camera, told apart by what they predict in the others.

A search in one camera needs four sightings there, since three always have a pose. A controller often shows three LEDs
to each of several cameras, and together they tell.
"""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.detection_model import MORE_SIGHTINGS, DetectionModel, count_triples
from rootmatch.model.gathering import gather_assignments
from rootmatch.model.proposals import solve_minimal_sets
from rootmatch.problems.p3p import P3P
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.visible_search import VisibleSearch, ranks_triples

TRIPLES, FEW_TRIPLES, KEPT = 4096, 128, 8
"""Triples whose poses are looked at, those that explain most of their own image; how many where a search is bounded, as
those of a tracker are; and the assignments that are kept. With three of eight LEDs detected in each camera, 2 of 20
scenes are right with 256, 4 with 1,024, 20 with 4,096 (tests/test_rig_triples.py). In flights, where most that face a
camera are detected, 128 find the same as 256, alone and among eight more clutter points in each image: 376 of 390
bodies, 495 of 503 (benchmarks/flights.py, rig, 3 flights from 1100; 1000, 1100 and 1101)."""

FEW, EVALUATIONS = 1024, 600
"""Triples without normals that any bounded search looks at, some ten milliseconds, and evaluations of its budget for
which it looks at one: they take about as long. Round values."""


def search_rig_triples(
    part: MatchingTask, model: DetectionModel, camera: int, own: Integers, options: GuidedOptions
) -> tuple[list[Integers], bool] | None:
    """Assignments of sightings that triples of one camera lead to in all cameras, the most likely first.

    With whether all triples were looked at. None if they cannot be searched: among too many detections, or, without
    normals, of too many points. ``part``: the task of that camera, whose detections (m,) are ``own`` of all; a measured
    vertical has its say in the ``model``.
    """
    if type(part.problem) is not P3P:
        part = copy_with(part, problem=P3P(part.problem.camera))  # type: ignore[attr-defined]
    found = _all_triples(part) if part.points.normals is None else _visible_triples(part, options)
    if found is None:
        return None
    points, images, whole = found
    n = model.shape[0] // len(model.images)
    rows = np.full((len(points), model.shape[0]), -1, np.int64)
    np.put_along_axis(rows, camera * n + points, own[images], axis=1)
    kept = gather_assignments(model, solve_minimal_sets(model, rows, 3).alone, minimum=3 + MORE_SIGHTINGS, maximum=KEPT)
    return list(kept.assignments), whole


def max_triples(task: MatchingTask) -> int:
    """How many triples of a camera are all looked at where no normals rank them; if there are more, none is."""
    return TRIPLES if task.budget is None else min(max(FEW, task.budget // EVALUATIONS), TRIPLES)


def is_met_by_search(
    task: MatchingTask, model: DetectionModel, assignment: Integers, points: int | None = None
) -> bool:
    """Whether a search meets poses with as many matches as an assignment; of a rig, if of so many ``points`` at least.

    See `DetectionModel.is_searchable`; one more than a minimal set of points by default.
    """
    minimum = task.minimal + 1 if points is None else points
    return model.is_searchable(assignment, task.minimal, minimum, triples=max_triples(task))


def _visible_triples(part: MatchingTask, options: GuidedOptions) -> tuple[Integers, Integers, bool] | None:
    """Triples of points (T, 3) that may be visible together, with images (T, 3), and whether these are all.

    None among too many detections.
    """
    task = part.sampling_task
    if not ranks_triples(task):
        return None
    search = VisibleSearch(task, options, part.deadline)
    points, images, whole = search.triples(TRIPLES if part.budget is None else FEW_TRIPLES)
    return part.permutation[points], images, whole


def _all_triples(part: MatchingTask) -> tuple[Integers, Integers, bool] | None:
    """All triples of points (T, 3) with all images (T, 3); None if they are too many."""
    n, n_target = part.shape
    if count_triples(n, n_target) > max_triples(part):
        return None
    points = np.array(list(combinations(range(n), 3)), np.int64).reshape(-1, 3)
    images = np.array(list(permutations(range(n_target), 3)), np.int64).reshape(-1, 3)
    points, images = np.repeat(points, len(images), axis=0), np.tile(images, (len(points), 1))
    if part.allowed is None:
        return points, images, True
    possible = part.allowed[points, images].all(axis=1)
    return points[possible], images[possible], True
