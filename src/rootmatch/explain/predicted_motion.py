"""What is assigned about predicted motions between two point sets, and whether a search could find more."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.model.modes import used_mask
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.problems.pose_fit.point_set_fit import FEWEST


def is_search_needless(model: PointSetModel, judged: Judged) -> bool:
    """Whether the best of some labellings explains more than any motion elsewhere could.

    As of `image_hypotheses.is_search_needless`: a motion elsewhere has the targets that are left, as many as there are
    points. Each is worth as much as those found, or as one that fits; a minimal set determines the motion, and is one
    of many.
    """
    assert model.prior is not None
    clouds, best = model.clouds, int(judged.log_odds.argmax())
    assignment, mass = judged.fit.assignments[best], float(judged.log_odds[best])
    # what is not where it was predicted may be something else than what is
    if judged.held[best] < 0 or not model.prior.allows(clouds, assignment, int(judged.held[best])):
        return False
    if (assignment >= 0).all():
        return True
    (free,) = np.nonzero(~used_mask(assignment[None], len(clouds.target))[0])
    most = min(len(free), len(assignment)) - FEWEST
    elsewhere = 0.0
    if most > 0:
        size, scale = clouds.target.shape[1], float(judged.fit.scale[best])
        variance = clouds.target_variance[free] + scale**2 * float(clouds.source_variance.mean())
        worth = -model.clutter.log_density[free] - 0.5 * size * (np.log(2.0 * math.pi * variance) + 1.0)
        each = max(mass, 0.0) / np.count_nonzero(assignment >= 0)
        elsewhere = max(most * each, most * float(worth.mean()) - FEWEST * math.log(len(free)))
    return mass >= math.log(model.prior.doubt) + elsewhere


def predicted_labellings(model: PointSetModel, *, narrowed: bool = False) -> list[Integers]:
    """Labellings (n,) about predicted motions, those that determine one; see `MotionPrior.labellings`."""
    every = [] if model.prior is None else model.prior.labellings(model.clouds, narrowed=narrowed)
    if model.allowed is not None:
        rows = np.arange(len(model.allowed))
        every = [np.where(model.allowed[rows, one], one, -1) for one in every]
    return [one for one in every if np.count_nonzero(one >= 0) >= FEWEST]
