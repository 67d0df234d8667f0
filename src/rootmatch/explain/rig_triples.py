"""Poses of a rig from three sightings in one camera, told apart by what they predict in the others.

A search in one camera needs four sightings there, since three always have a pose. A controller often shows three LEDs
to each of several cameras, and together they tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import MORE_SIGHTINGS, DetectionModel
from rootmatch.model.gathering import gathered
from rootmatch.model.proposals import poses_of_sets
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.visible_search import VisibleSearch, search_of

Integers = NDArray[np.int64]

TRIPLES, FEW_TRIPLES, KEPT = 4096, 128, 8
"""Triples whose poses are looked at, those that explain most of their own image; how many where a search is bounded, as
those of a tracker are; and the assignments that are kept. With three of eight LEDs detected in each camera, 2 of 20
scenes are right with 256, 4 with 1,024, 20 with 4,096 (tests/test_rig_triples.py). In flights, where most that face a
camera are detected, 128 find the same as 256, alone and among eight more clutter points in each image: 376 of 390
bodies, 495 of 503 (benchmarks/flights.py, rig, 3 flights from 1100; 1000, 1100 and 1101)."""


def assignments_of_triples(
    part: MatchingTask, model: DetectionModel, camera: int, own: Integers, options: GuidedOptions
) -> list[Integers] | None:
    """Assignments of sightings that triples of one camera lead to in all cameras, the most likely first.

    Parameters
    ----------
    part : MatchingTask
        Of that camera and its detections.
    model : DetectionModel
        Of the sightings and all detections.
    camera : int
    own : (m,) int64 array
        The detections of that camera among all.
    options : GuidedOptions

    Returns
    -------
    list of (n,) int64 arrays, or None
        None if triples cannot be searched: without normals, or among too many detections.
    """
    search = search_of(part.sampling_task, options, part.deadline)
    if not isinstance(search, VisibleSearch):
        return None  # no normals say what is visible together
    points, images = search.triples(TRIPLES if part.budget is None else FEW_TRIPLES)
    n = model.shape[0] // len(model.images)
    rows = np.full((len(points), model.shape[0]), -1, np.int64)
    np.put_along_axis(rows, camera * n + part.permutation[points], own[images], axis=1)
    found = gathered(model, poses_of_sets(model, rows, 3).alone, least=3 + MORE_SIGHTINGS, most=KEPT)
    return list(found.assignments)
