"""Poses proposed where the position is known: two matches tell the rotation, and most pairs of them contradict it.

With t known, a line of sight meets the sphere about t on which its point lies, at v = s d + o − t with ‖v‖ = ‖X‖ in one
place or two. The angle between two such v is that between their points, or the pair is wrong; otherwise it tells the
rotation. That is of use where t is precise against the distances of the points from the origin, as of a camera whose
place in a room is known.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.known_rotation import (
    GATE,
    MOST_POSES,
    assigned_about,
    drawn,
    lines_of_sight,
    packed,
    pairs_of,
)
from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import Proposals
from rootmatch.problems.noise import mean_deviation
from rootmatch.problems.pose_fit.pose_prior import PosePrior

PRECISE = 0.05
"""Standard deviation of the direction from the origin to a point, in radians, up to which pairs are drawn. A round
value."""


def poses_by_position(task: MatchingTask, known: PosePrior, model: DetectionModel) -> Proposals | None:
    """What is assigned about the best poses with a known position; None if it is vague, or no pair agrees with it.

    Parameters
    ----------
    task : MatchingTask
        Of one body.
    known : PosePrior
    model : DetectionModel
        Of the task.
    """
    if known.place is None or known.turn is not None:
        return None
    pairs, rotation = _agreeing(task, known.place, np.random.default_rng(task.options.seed))
    if not len(rotation):
        return None
    return assigned_about(model, known, pairs, (rotation, known.place[0] + rotation @ model.centre))


def _agreeing(task: MatchingTask, place: tuple[Floats, Floats], rng: np.random.Generator) -> tuple[Integers, Floats]:
    """Pairs of matches (K, 2, 2) that agree with the position, and the rotation (K, 3, 3) by each.

    Rows of an assignment come before detections.
    """
    i, j, towards, variance = _directions(task, *place)
    row = task.camera_of[j] * task.shape[0] + i
    first, second = pairs_of(row, j, rng)
    of_points = task.points.source / np.maximum(np.linalg.norm(task.points.source, axis=1), 1e-300)[:, None]
    seen, there = _between(towards[first], towards[second]), _between(of_points[i[first]], of_points[i[second]])
    gate = GATE * np.sqrt(variance[first] + variance[second])
    agrees = np.flatnonzero((np.abs(seen - there) <= gate) & (there > gate) & (there < math.pi - gate))
    agrees = agrees[drawn(len(agrees), MOST_POSES, rng)]
    first, second = first[agrees], second[agrees]
    own, others = _frames(of_points[i[first]], of_points[i[second]]), _frames(towards[first], towards[second])
    return packed(row, j, first, second), others @ own.swapaxes(1, 2)


def _directions(task: MatchingTask, t: Floats, covariance: Floats) -> tuple[Integers, Integers, Floats, Floats]:
    """Matches (M,), (M,), the direction (M, 3) from the origin to the point in the camera frame, and its variance."""
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
    return i, j, towards, spread[found] / root[i, j] ** 2


def _between(one: Floats, other: Floats) -> Floats:
    """Angles (K,) between unit directions (K, 3)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1)))


def _frames(one: Floats, other: Floats) -> Floats:
    """Rotations (K, 3, 3) whose columns are the bisectors of two unit directions, and across both."""
    frame = np.stack([one + other, one - other, np.cross(other, one)], axis=2)
    return np.asarray(frame / np.linalg.norm(frame, axis=1, keepdims=True))
