"""What stands in the place of a body among points, if that is alike: each of its points is near the body's own.

The same hypothesis as in an image (`rootmatch.model.image_alike`): the body with points that are each off by N(0, τ² I)
about the motion of a labelling. A target near the place of a point that has no match is then expected, where for the
body it is clutter by chance; and a match that is exact costs log τ² / σ² for each of its residuals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.image_alike import ERRORS, REACH
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.samplers.point_sets.congruent import grow_labellings

ROUNDS = 3
"""Rounds in which a labelling is fitted and takes what is near its motion. A round value."""


def log_odds_of_errors(
    model: PointSetModel, assignment: Integers, log_mass: float, taken: Bools | None = None
) -> Floats | None:
    """Log-odds (W,) that all points of a body are off by each of `ERRORS`, about the motion of a labelling.

    ``log_mass``: logarithm of the weight of all labellings about its motion, against clutter alone; ``taken`` (n',):
    targets of other bodies.

    Returns
    -------
    (W,) float64 or None
        Over the body as given; None where nothing is near the place of a point that has no match.
    """
    clouds, left = model.clouds, np.ones(len(model.clouds.target), np.bool_) if taken is None else ~taken
    allowed = model.allowed
    if not left.all():
        allowed = np.tile(left, (len(assignment), 1)) if allowed is None else allowed & left
    fit, errors = model.judge_one(assignment).fit, ERRORS * body_radius(clouds.source)
    left[assignment[assignment >= 0]] = False
    squared, variance = (part[0][assignment < 0][:, left] for part in fit.squares())
    if not (squared < REACH**2 * (variance + (float(fit.scale[0]) * errors[-1]) ** 2)).any():
        return None
    out = np.empty(len(errors))
    for k, error in enumerate(errors):
        wide = replace(model, repeated=model.clutter, clouds=clouds.off_by(np.full(len(assignment), error)))
        labels, before = assignment[None], 0
        for _ in range(ROUNDS):
            if len(labels) == before:  # nothing new was near
                break
            before, labels = len(labels), grow_labellings(wide.clouds, labels, model.mirror, allowed)
        out[k] = wide.judged(labels).log_odds.max()
    return out - log_mass
