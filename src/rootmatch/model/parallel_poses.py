"""Poses of a mode and of another one between which the body looks the same.

Poses that have looked the same for some frames, a period of a lattice apart or half a turn, do so in the next one: the
motion from one to the other takes points of the body to points, and the detections of the one to those of the other.
"""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.modes import Modes

NEAR = 0.25
"""Distance of a point's place from that of another, over that of the nearest points, up to which they are the same. A
round value: the predictions need not be as good as the poses."""


def motion_between_modes(model: DetectionModel, modes: Modes, first: int, second: int) -> tuple[Floats, Floats] | None:
    """The motion (R, t), x' = R x + t, from one mode to another, if the body looks the same after it.

    None if the other mode has not all detections of the first one as those of the points that come to their places, or
    if these are the same points.
    """
    here, there = modes.assignments[first], modes.assignments[second]
    if (here == there).all() or (here >= 0).sum() != (there >= 0).sum():
        return None
    turn = modes.rotation[first].T @ modes.rotation[second]
    shift = modes.rotation[first].T @ (modes.position[second] - modes.position[first])
    if (_move_assignment(model, (turn, shift), here) != there).any():
        return None
    return turn, model.centre + shift - turn @ model.centre


def _move_assignment(model: DetectionModel, motion: tuple[Floats, Floats], assignment: Integers) -> Integers:
    """An assignment (n,) as one of the points that are at their places after a motion x' = R x + t about the centre."""
    images = max(len(model.images), 1)
    points = (model.points - model.centre)[: len(assignment) // images]
    rows = assignment.reshape(images, -1)
    (matched,) = np.nonzero((rows >= 0).any(axis=0))
    apart = ((points[matched, None] - points) ** 2).sum(axis=2)
    apart[np.arange(len(matched)), matched] = np.inf
    far = ((points[matched, None] - (points @ motion[0].T + motion[1])) ** 2).sum(axis=2)
    nearest = far.argmin(axis=1)
    same = far[np.arange(len(matched)), nearest] <= NEAR**2 * apart.min(axis=1)
    out = np.full(rows.shape, -1)
    out[:, nearest[same]] = rows[:, matched[same]]
    return out.reshape(-1)
