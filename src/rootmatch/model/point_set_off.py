"""What stands in the place of a body among points, if that is alike: each of its points is near the body's own.

The same hypothesis as in an image (`rootmatch.model.image_alike`): the body with points that are each off by N(0, τ² I)
about the motion of a labelling. A target near the place of a point that has no match is then expected, where for the
body it is clutter by chance; and a match that is exact costs log τ² / σ² for each of its residuals. Or it is the body's
mirror image: that has three of its points, or all that lie in a plane, where the body has them, and others elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.image_alike import ERRORS, LOG_PRIOR, MINIMUM, REACH, SEEN, residual_log_gains
from rootmatch.model.point_set_alike import grow_about
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.model.weighed_labellings import MIRRORED, reflected_log_odds
from rootmatch.problems.pose_fit.point_set_fit import PointSetFit
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.samplers.point_sets.congruent import reflected_labellings

MORE = 5.0
"""Log-odds by which fits may gain more than is foreseen: of 106 labellings 4.3 at most (benchmarks/flights.py, vehicle,
and the point sets of benchmarks/together.py, seeds from 1000). A round value; it bounds time."""


def log_odds_of_errors(
    model: PointSetModel, assignment: Integers, log_mass: float, taken: Bools | None = None
) -> Floats | None:
    """Log-odds (W,) that all points of a body are off by each of `ERRORS`, about the motion of a labelling.

    ``log_mass``: logarithm of the weight of all labellings about its motion, against clutter alone; ``taken`` (n',):
    targets of other bodies.

    Returns
    -------
    (W,) float64 or None
        Over the body as given; −∞ where they cannot matter. None where none can, as nothing is near the place of a
        point that has no match.
    """
    clouds, left = model.clouds, np.ones(len(model.clouds.target), np.bool_) if taken is None else ~taken
    allowed = _without_taken(model, taken)
    judged, errors = model.judge_one(assignment), ERRORS * body_radius(clouds.source)
    left[assignment[assignment >= 0]] = False
    maximum = _most_gained(model, judged.fit, errors, left)
    if maximum is None:
        return None
    out = np.full(len(errors), -np.inf)
    for k in np.flatnonzero(float(judged.log_odds[0]) - log_mass + maximum + MORE + LOG_PRIOR >= MINIMUM).tolist():
        wide = replace(model, repeated=model.clutter, clouds=clouds.off_by(np.full(len(assignment), errors[k])))
        out[k] = wide.judge(grow_about(wide, assignment[None], allowed)).log_odds.max() - log_mass
    return out if np.isfinite(out).any() else None


def log_odds_of_reflection(
    model: PointSetModel, assignment: Integers, log_mass: float, taken: Bools | None = None
) -> float:
    """Log-odds of the body's mirror image where a labelling has it; −∞ if that explains no more.

    ``log_mass``: as of `log_odds_of_errors`, without what is known of the motion: where the body is expected, its
    mirror image is found as well, if that is what was followed.
    """
    allowed = _without_taken(model, taken)
    labellings = reflected_labellings(model.clouds, assignment, allowed)
    if not len(labellings):
        return -math.inf
    found = reflected_log_odds(replace(model, prior=None, allowed=allowed), labellings)
    return float(found.max()) + math.log(MIRRORED) - log_mass


def _without_taken(model: PointSetModel, taken: Bools | None) -> Bools | None:
    """What is allowed (n, n') without the targets of other bodies."""
    if taken is None or not taken.any():
        return model.allowed
    return np.tile(~taken, (len(model.clouds.source), 1)) if model.allowed is None else model.allowed & ~taken


def _most_gained(model: PointSetModel, fit: PointSetFit, errors: Floats, left: Bools) -> Floats | None:
    """About the most (W,) that a fitted labelling gains if all points are off by errors (W,).

    By its residuals, and by targets ``left`` (n',) that are near the places of points without a match; None if none is.
    """
    assignment, size = fit.assignments[0], model.clouds.target.shape[1]
    own, scale = assignment >= 0, float(fit.scale[0])
    squared, variance = (part[0] for part in fit.squares())
    moved = float((scale**2 / variance[own, assignment[own]]).mean())
    squared, variance = squared[~own][:, left], variance[~own][:, left] + (scale * errors[:, None, None]) ** 2
    near = squared < REACH**2 * variance
    if not near.any():
        return None
    gains = -0.5 * squared / variance - 0.5 * size * np.log(2.0 * np.pi * variance) - model.clutter.log_density[left]
    gains = np.sort(np.where(near, gains + SEEN, 0.0).max(axis=2, initial=0.0), axis=1)[:, ::-1]
    matched = int(own.sum())
    counts = model.log_counts[matched:] - model.log_counts[matched]
    gains = np.cumsum(gains, axis=1)[:, : len(counts) - 1] + counts[1 : 1 + gains.shape[1]]
    residuals = residual_log_gains(NOISE_FREEDOM, (float(fit.chi2[0]), moved), float(fit.dof[0]), errors)
    return np.asarray(residuals + gains.max(axis=1, initial=0.0))
