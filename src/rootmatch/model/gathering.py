"""What poses of minimal sets predict: the detections that they gather in all images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.model.compiled.gathering import gather
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import MinimalSets
from rootmatch.problems.gate import GATE

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RATE = 0.7
"""Detection rate that their order supposes; the model of the image judges them later. A round value."""
HIDDEN = 0.1
"""Visibility below which a point is not looked for. A round value."""


def gathered(model: DetectionModel, sets: MinimalSets, least: int, most: int) -> list[Integers]:
    """Assignments that poses of minimal sets lead to, each once, the most likely first.

    Parameters
    ----------
    model : DetectionModel
    sets : MinimalSets
    least, most : int
        Minimum number of matches, and maximum number of assignments.
    """
    assignments, gains = gathered_by_each(model, sets)
    enough = np.flatnonzero(((assignments >= 0).sum(axis=1) >= least) & np.isfinite(gains))
    kept: dict[bytes, Integers] = {}
    for k in enough[np.argsort(-gains[enough], kind="stable")].tolist():
        kept.setdefault(assignments[k].tobytes(), assignments[k])
        if len(kept) == most:
            break
    return list(kept.values())


def gathered_by_each(model: DetectionModel, sets: MinimalSets) -> tuple[Integers, Floats]:
    """The assignment (M, n) that each pose leads to, and its log-odds (M,) against clutter, to first order.

    −∞ for a pose from which a point of its own set would not be seen.
    """
    poses, members = sets.proposals, sets.members
    alone = np.full_like(poses.assignments, -1)
    np.put_along_axis(alone, members, np.take_along_axis(poses.assignments, members, axis=1), axis=1)
    at = model.linearised(poses.rotation, poses.position)
    assignments, gains = np.empty_like(alone), np.empty(len(alone))
    target, sigma, log_weights, *_ = model.image_for_kernels
    gather(
        (at.pixels, at.jacobian, model.visibility(at, np.zeros(len(at.seen)))),
        alone,
        (target, sigma, np.array(model.clutter.log_density), log_weights, np.array(model.image_of)),
        (max(len(model.images), 1), GATE**2, RATE, HIDDEN),
        (assignments, gains),
    )
    return assignments, gains
