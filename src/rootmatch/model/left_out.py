"""What a body's pose explains without one of its matches: another pose, which that match alone kept away.

One wrong match that fits can hold a pose many standard deviations off, where right ones are excluded. No single change
of the assignment gains then: without the match the pose is only less certain, and its best change is to take it back.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.model.compiled.left_out import leave_out
from rootmatch.model.compiled.steps import take_steps
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import STEEP
from rootmatch.model.mode_search import NEGLIGIBLE
from rootmatch.model.modes import Modes
from rootmatch.model.proposals import Proposals
from rootmatch.problems.limits import GATE

LEVERAGE = 0.5
"""Largest eigenvalue of a match's leverage H = J C Jᵀ N⁻¹ from which it is left out: without it the pose is twice as
uncertain in some direction. The traces of all matches add up to six, so these are at most twelve. A round value."""
MOST = 12
EXACT = np.empty((0, 0, 2, 2))
"""Covariances of pixels by points that are exact."""


def without_each(model: DetectionModel, modes: Modes) -> Proposals:
    """Poses that modes lead to without one of their matches and with what they gather then, to first order.

    Only those that may be no more than `NEGLIGIBLE` behind, and that are no single change of an assignment.
    """
    at = model.linearised(modes.rotation, modes.position)
    of_points = model.of_points(at)
    room = MOST * len(modes.log_odds)
    changed, steps, of = np.empty((room, model.shape[0]), np.int64), np.empty((room, 6)), np.empty(room, np.int64)
    _, _, log_weights, _, log_counts, image_of = model.image_for_kernels
    count = leave_out(
        np.array(modes.assignments, np.int64),
        (at.pixels, at.jacobian, EXACT if of_points is None else of_points, np.array(modes.visible), at.seen),
        np.array(modes.covariance),
        (*model.detections_for_gates, model.clutter.log_density, log_weights, log_counts, image_of),
        (math.nan if model.rate is None else model.rate, -NEGLIGIBLE, model.prior.least, LEVERAGE, GATE**2),
        (changed, steps, of),
    )
    of = of[:count]
    poses = np.empty((count, 3, 3)), np.empty((count, 3))
    take_steps(steps[:count].copy(), at.rotation[of], at.position[of], STEEP, poses)
    return Proposals(changed[:count].copy(), *poses)
