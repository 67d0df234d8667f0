"""The twins of assignments: those of the poses after which a body looks nearly the same, by its near symmetries.

A search may find one of two such poses and stop, as it explains what there is to explain. The other one is known from
the body alone, and is weighed beside it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.confidence import SHARED, of_one_pose
from rootmatch.explain.detection_odds import DEFAULT_OPTIONS, log_odds, visibility
from rootmatch.explain.near_symmetries import symmetries_of
from rootmatch.explain.task import MatchingTask

Integers = NDArray[np.int64]

POSES = 3
"""Most poses among some assignments whose twins are asked for. A round value."""
DETECTED = 0.9
"""Probability that a visible point is detected, where none is given, by which twins are completed; they are weighed
with that of the best assignment. A round value."""
ROUNDS = 2
"""Times that a twin is fitted and completed."""


def twins_of(task: MatchingTask, assignments: list[Integers]) -> list[Integers]:
    """The twins of the first few poses among some assignments, with the detections that only they explain.

    None where the points have no normals: which half of the body is hidden is not known then, and hardly any image
    shows what the halves have in common alone.
    """
    points = task.points
    if points.normals is None or points.source.shape[1] != 3:
        return []
    symmetries = symmetries_of(points.source, points.normals)
    if not symmetries:
        return []
    found = []
    for assignment in _of_different_poses(assignments):
        least = max(task.problem.minimal + 1, SHARED * int(np.count_nonzero(assignment >= 0)))
        for symmetry in symmetries:
            twin = np.where(symmetry.image >= 0, assignment[symmetry.image], -1)
            if np.count_nonzero(twin >= 0) < least:
                continue
            completed = _completed(task, twin, assignment)
            if completed is not None:
                found.append(completed)
    return found


def _of_different_poses(assignments: list[Integers]) -> list[Integers]:
    """The first assignment of each of the first few poses."""
    chosen: list[Integers] = []
    for assignment in assignments:
        if len(chosen) == POSES:
            break
        if not any(of_one_pose(other, assignment) for other in chosen):
            chosen.append(assignment)
    return chosen


def _completed(task: MatchingTask, twin: Integers, leader: Integers) -> Integers | None:
    """A twin without the matches that its pose refutes, and with those that it predicts; None where too few are left.

    ``leader``: the assignment whose twin it is; what that leaves is clutter.
    """
    odds = log_odds(task, leader)
    rate = DETECTED if task.options.detection_rate is None else min(task.options.detection_rate, DETECTED)
    for _ in range(ROUNDS):
        fit = task.problem.fitted(task.points, twin[None])
        if not np.isfinite(fit.chi2[0]):
            return None
        chance = rate * visibility(task, fit, 0, DEFAULT_OPTIONS)
        gains = fit.densities(0) + odds + np.log(chance / (1.0 - chance))[:, None]
        before, twin = twin, twin.copy()
        matched = np.flatnonzero(twin >= 0)
        twin[matched[~(gains[matched, twin[matched]] > 0.0)]] = -1
        free = np.ones(task.shape[1], np.bool_)
        free[twin[twin >= 0]] = False
        rows, columns = np.nonzero((gains > 0.0) & free & (twin < 0)[:, None])
        for place in np.argsort(-gains[rows, columns], kind="stable"):
            if twin[rows[place]] < 0 and free[columns[place]]:
                twin[rows[place]], free[columns[place]] = columns[place], False
        if np.count_nonzero(twin >= 0) <= task.problem.minimal:
            return None
        if np.array_equal(before, twin):
            break
    return twin
