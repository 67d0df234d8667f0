"""Poses proposed where the position is known: two matches tell the rotation, and most pairs of them contradict it.

With t known, a line of sight meets the sphere about t on which its point lies, at v = s d + o − t with ‖v‖ = ‖X‖ in one
place or two. The angle between two such v is that between their points, or the pair is wrong; otherwise it tells the
rotation. That is of use where t is precise against the distances of the points from the origin, as of a camera whose
place in a room is known. Where v is much the same whichever point it is, as of stars about the camera itself, a table
of angles has the pairs that agree (`angle_table`). Otherwise all pairs are looked at, or some where there are many.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.angle_table import Agreeing, Directions, search_angle_table, select_agreeing
from rootmatch.explain.known_rotation import (
    PairPoses,
    assign_about_poses,
    draw_match_pairs,
    draw_poses,
    lines_of_sight,
    pack_pairs,
)
from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import Proposals
from rootmatch.problems.noise import mean_deviation
from rootmatch.problems.pose_fit.pose_prior import PosePrior

PRECISE = 0.05
"""Standard deviation of the direction from the origin to a point, in radians, up to which pairs are drawn. A round
value."""
PREDICTED, FEWEST = 100_000, 100
"""Points that are predicted for all pairs of a table together, and fewest pairs of it. Round values."""


class Pairs(NamedTuple):
    """Pairs of matches that agree with a known position."""

    matches: Integers
    """(K, 2, 2): rows of an assignment, then detections."""
    rotation: Floats
    """(K, 3, 3) that each tells."""


def propose_by_position(
    task: MatchingTask, known: PosePrior, model: DetectionModel, pairs: Pairs | None
) -> Proposals | None:
    """What is assigned about the best poses with a known position; None if it is vague, or no pair agrees with it.

    ``pairs``: those of `find_pairs_by_angle`.
    """
    if known.place is None or known.turn is not None:
        return None
    drawn = [(pairs, 1.0)] if pairs is not None else _find_all_pairs(task, known.place)
    t, centre = known.place[0], model.centre
    return assign_about_poses(
        model, known, (PairPoses(*some, t + some.rotation @ centre, share) for some, share in drawn)
    )


def find_pairs_by_angle(task: MatchingTask, known: PosePrior) -> Pairs | None:
    """The pairs that a table of angles has; None where `search_angle_table` tells too little, or no place is known."""
    if known.place is None or known.turn is not None:
        return None
    given, rng = _directions(task, *known.place), np.random.default_rng(task.options.seed)
    maximum = max(PREDICTED // task.shape[0], FEWEST)
    found = search_angle_table(given, rng, maximum=maximum)
    return None if found is None else _pairs(task, given, found)


def _find_all_pairs(task: MatchingTask, place: tuple[Floats, Floats]) -> Iterator[tuple[Pairs, float]]:
    """The pairs that agree, block by block, with the share of all pairs of matches; some where there are many."""
    given, rng = _directions(task, *place), np.random.default_rng(task.options.seed)
    for one, other, share in draw_match_pairs(_rows(task, given), given.j, rng):
        first, second = select_agreeing(given, one, other)
        some, share = draw_poses(np.arange(len(first)), share, rng)
        yield _pairs(task, given, Agreeing.of(given, first[some], second[some])), share


def _pairs(task: MatchingTask, given: Directions, found: Agreeing) -> Pairs:
    return Pairs(pack_pairs(_rows(task, given), given.j, found.first, found.second), found.rotation)


def _rows(task: MatchingTask, given: Directions) -> Integers:
    """Rows (M,) of an assignment that matches have."""
    return np.asarray(task.camera_of[given.j] * task.shape[0] + given.i)


def _directions(task: MatchingTask, t: Floats, covariance: Floats) -> Directions:
    """Directions from the origin to the point of each possible match; a line of sight may meet its sphere twice."""
    points, (origins, rays, angles) = task.points, lines_of_sight(task)
    length = np.linalg.norm(points.source, axis=1)[:, None]
    own = 0.0 if points.source_covariance is None else mean_deviation(points.source_covariance)[:, None] ** 2
    off = origins - t
    along = -(rays * off).sum(axis=1)
    square = along**2 - (off**2).sum(axis=1) + length**2
    root = np.sqrt(np.maximum(square, 0.0))
    depth = along + np.array([1.0, -1.0])[:, None, None] * root
    spread = float(np.linalg.eigvalsh(covariance)[-1]) + (depth * angles) ** 2 + own
    allowed = np.ones(task.shape, np.bool_) if task.allowed is None else task.allowed
    _, i, j = np.nonzero(found := allowed & (depth > 0.0) & (spread < (PRECISE * root) ** 2))
    towards = (depth[found][:, None] * rays[j] + off[j]) / length[i]
    of_points = points.source / np.maximum(length, 1e-300)
    return Directions(i, j, towards, spread[found] / root[i, j] ** 2, of_points)
