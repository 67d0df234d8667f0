"""Evidence of a hypothesis: log-odds of an assignment and its pose against clutter alone, the pose integrated out.

For K hypotheses, each an owner map a and a pose T near which the integral is taken,

    log B = Σ_owned [log w − log f(y_j) − log 2π√|S_ij|] + log Γ(n' − k + ½) − log Γ(n' + ½)
          + log ∫ Beta(δ) Π_owned δ v_i Π_rest (1 − δ v_i) dδ
          + L(Q, f) + 3 log 2π − ½ log |A| + log p(T)

with f the density of clutter, k matches, S_ij = S_j + J Σ_i Jᵀ, A = Σ JᵀS⁻¹J + P the precision of the pose, Q the least
squared deviation of detections and prior to first order, and L the logarithm of e^(−Q/2) with a factor on all variances
integrated out. Poses need not be fitted: the minimum of Q is found to first order, and `Evidence.step` leads to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import rotation_from_vector
from rootmatch.model.detection_model import DetectionModel, Linearised
from rootmatch.model.pose_prior import PoseDensity
from rootmatch.problems.pose_fit.shared_noise import by_points, of_sightings, shared_spread

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LOG_2PI = math.log(2.0 * math.pi)
STEEP = 0.5
"""Longest step of a settled pose, in radians and relative to the distance of the body. A round value."""
NO_CHANGE = 1e-2
"""Decrease of Q above which a step is worth another evaluation: below it, the evidence is known up to second order, and
the step itself is taken in the end. A round value."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of K hypotheses.

    Attributes
    ----------
    log_odds : (K,) float64
        log B, natural logarithm; −∞ for a match of a point that the camera cannot see, or that is not allowed.
    step : (K, 6) float64
        (ω, τ) from each pose to the best one, to first order; zero for a fitted pose.
    covariance : (K, 6, 6) float64
        Of the pose, prior included: rad, and the caller's unit of length.
    squared : (K,) float64
        Q, at the pose after the step.
    freedom : (K,) float64
        Degrees of freedom of that: two for each match, less the parameters that the detections determine.
    visible : (K, n) float64
        Visibility of each point, 0 to 1.
    decrement : (K,) float64
        Decrease of Q by the step.
    """

    log_odds: Floats
    step: Floats
    covariance: Floats
    squared: Floats
    freedom: Floats
    visible: Floats
    decrement: Floats

    def take(self, which: Integers | NDArray[np.bool_]) -> Evidence:
        """Select some of the hypotheses."""
        return Evidence(*(getattr(self, field.name)[which] for field in fields(self)))


def evidence(
    model: DetectionModel, assignments: Integers, at: Linearised, prior: PoseDensity | None = None
) -> Evidence:
    """Evidence of assignments (K, n), −1 for none, about poses of `DetectionModel.linearised`.

    ``prior``: of the pose, in the place of the model's own.
    """
    used = assignments >= 0
    image = np.maximum(assignments, 0)
    offset = np.where(used[..., None], model.target[image] - at.pixels, 0.0)
    rows, residual, log_spread = _whitened(model, at, used, image, offset)
    flat = rows.reshape(len(assignments), -1, 6)
    measured = flat.swapaxes(1, 2) @ flat
    terms = (prior or model.prior).terms(at.rotation, at.position)
    slope = (residual.reshape(len(assignments), 1, -1) @ flat)[:, 0] + terms.slope
    covariance, log_precision = _inverse(measured + terms.precision)
    step = (covariance @ slope[..., None])[..., 0]
    decrement = (slope * step).sum(axis=1)
    squared = (residual**2).sum(axis=(1, 2)) + terms.squared - decrement
    squared = np.maximum(squared, 0.0)
    matches = used.sum(axis=1)
    freedom = np.maximum(2.0 * matches - (covariance * measured).sum(axis=(1, 2)), 0.0)
    tilt = np.sqrt(0.5 * np.trace(covariance[:, :3, :3], axis1=1, axis2=2))
    visible = model.visibility(at, np.minimum(tilt, 1.0))
    log_clutter = model.clutter.log_density[image]
    log_odds = (
        np.where(used, _log_weights(model, assignments) - log_clutter - LOG_2PI - log_spread, 0.0).sum(axis=1)
        + model.clutter.log_first(_taken(assignments, model.shape[1]))
        + model.log_counts(assignments)
        + log_detected(model, used, visible)
        + log_scaled(squared, freedom, model.options.noise_freedom)
        + 3.0 * LOG_2PI
        - 0.5 * log_precision
        + terms.log_density
    )
    possible = (at.seen | ~used).all(axis=1) & np.isfinite(log_odds)
    log_odds = np.where(possible, log_odds, -np.inf)
    return Evidence(log_odds, step, covariance, squared=squared, freedom=freedom, visible=visible, decrement=decrement)


def about(
    model: DetectionModel, assignments: Integers, rotation: Floats, position: Floats, prior: PoseDensity | None = None
) -> tuple[Evidence, Linearised]:
    """Evidence of assignments (K, n) about poses (K, 3, 3) and (K, 3) of the body's centre, as they are."""
    at = model.linearised(rotation, position)
    return evidence(model, assignments, at, prior), at


def settled(
    model: DetectionModel,
    assignments: Integers,
    found: Evidence,
    at: Linearised,
    prior: PoseDensity | None = None,
    steps: int = 2,
) -> tuple[Evidence, Linearised]:
    """Evidence after a few Gauss–Newton steps to the best poses, starting from that about the given poses.

    The steps end when none of them changes a fit.
    """
    for _ in range(steps):
        if float(found.decrement.max(initial=0.0)) < NO_CHANGE:
            break
        at = model.linearised(*stepped(found, at))
        found = evidence(model, assignments, at, prior)
    return found, at


def stepped(found: Evidence, at: Linearised) -> tuple[Floats, Floats]:
    """Rotations (K, 3, 3) and positions (K, 3) after each step, which is shortened to where first order may hold."""
    length = np.maximum(
        np.linalg.norm(found.step[:, :3], axis=1),
        np.linalg.norm(found.step[:, 3:], axis=1) / np.maximum(np.linalg.norm(at.position, axis=1), 1e-300),
    )
    step = found.step * np.minimum(1.0, STEEP / np.maximum(length, 1e-300))[:, None]
    return rotation_from_vector(step[:, :3]) @ at.rotation, at.position + step[:, 3:]


def log_detected(model: DetectionModel, used: NDArray[np.bool_], visible: Floats) -> Floats:
    """Logarithm (K,) of the probability that exactly these points (K, n) are detected, the rate integrated out."""
    rates, log_weights = model.rates
    with np.errstate(divide="ignore"):
        owned = np.where(used, np.log(visible), 0.0).sum(axis=1)
    missing = np.where(used, 0.0, visible)
    # a product of factors in (0, 1]: no logarithm for each of them
    chance = (1.0 - rates[:, None] * missing[:, None]).prod(axis=2)
    with np.errstate(divide="ignore"):
        each = np.log(chance) + used.sum(axis=1)[:, None] * np.log(rates) + log_weights
    highest = each.max(axis=1)
    return np.asarray(owned + highest + np.log(np.exp(each - highest[:, None]).sum(axis=1)))


def log_scaled(squared: Floats, freedom: Floats, given: float) -> Floats:
    """Logarithm of ∫ IG(s²; ν/2, ν/2) s^(−f) e^(−Q/2s²) ds²: likelihood of a squared deviation of uncertain unit.

    ``squared`` Q and ``freedom`` f are (K,); ``given`` ν is the number of residuals that the stated σ is worth. The
    result is −Q/2 if ν is infinite.
    """
    if math.isinf(given):
        return -0.5 * squared
    half = 0.5 * given
    change = _log_gamma_ratio(half, 0.5 * freedom) - 0.5 * freedom * math.log(half)
    return np.asarray(change - (half + 0.5 * freedom) * np.log1p(squared / given))


def _log_gamma_ratio(a: float, b: Floats) -> Floats:
    """Log Γ(a + b) − log Γ(a), by Stirling's series: to 1e-6 from a = 2 on."""

    def series(x: Floats) -> Floats:
        return np.asarray((x - 0.5) * np.log(x) - x + 1.0 / (12.0 * x) - 1.0 / (360.0 * x**3))

    return series(a + b) - series(np.asarray(a, dtype=float))


def squared_deviations(model: DetectionModel, assignments: Integers, at: Linearised) -> Floats:
    """Squared deviations (K,) of the detections of assignments (K, n) from poses, in units of their noise."""
    used, image = assignments >= 0, np.maximum(assignments, 0)
    offset = np.where(used[..., None], model.target[image] - at.pixels, 0.0)
    return np.asarray((_whitened(model, at, used, image, offset)[1] ** 2).sum(axis=(1, 2)))


def _whitened(
    model: DetectionModel, at: Linearised, used: NDArray[np.bool_], image: Integers, offset: Floats
) -> tuple[Floats, Floats, Floats]:
    """Jacobians (K, n, 2, 6) and residuals (K, n, 2) in units of the noise, and ½ log |S| (K, n); zero if unmatched."""
    sigma = model.noise_of(at, image)
    if model.source_covariance is None:
        weight = np.where(used, 1.0 / sigma, 0.0)
        return at.jacobian * weight[..., None, None], offset * weight[..., None], 2.0 * np.log(sigma)
    images = max(len(model.images), 1)
    by_point = np.where(used[..., None, None], at.by_position @ at.rotation[:, None], 0.0)
    spread = shared_spread(by_point, model.source_covariance, np.where(used, sigma**2, 1.0), images)
    root = np.linalg.cholesky(spread)
    rows = of_sightings(np.linalg.solve(root, by_points(at.jacobian * used[..., None, None], images)), images)
    residual = of_sightings(np.linalg.solve(root, by_points(offset[..., None], images)), images)[..., 0]
    logarithm = np.log(np.diagonal(root, axis1=-1, axis2=-2))[..., None]
    return rows, residual, of_sightings(logarithm, images)[..., 0].sum(axis=-1)


def _inverse(precision: Floats) -> tuple[Floats, Floats]:
    """Inverses and log-determinants of matrices (K, 6, 6), scaled to a unit diagonal, as units differ."""
    scale = np.sqrt(np.diagonal(precision, axis1=1, axis2=2))
    unit = precision / (scale[:, :, None] * scale[:, None])
    unit = unit + 1e-13 * np.eye(6)
    logarithm = np.linalg.slogdet(unit)[1] + 2.0 * np.log(scale).sum(axis=1)
    return np.linalg.inv(unit) / (scale[:, :, None] * scale[:, None]), logarithm


def _taken(assignments: Integers, count: int) -> NDArray[np.bool_]:
    """Mask (K, n') of the detections that each assignment (K, n) uses."""
    taken = np.zeros((len(assignments), count + 1), np.bool_)
    taken[np.arange(len(assignments))[:, None], assignments] = True  # −1 is the last place
    return taken[:, :count]


def _log_weights(model: DetectionModel, assignments: Integers) -> Floats | float:
    """Logarithm (K, n) of the prior weight of each match."""
    if model.log_weights is None and model.allowed is None:
        return 0.0
    rows, image = np.arange(assignments.shape[1]), np.maximum(assignments, 0)
    weights = np.zeros(assignments.shape) if model.log_weights is None else model.log_weights[rows, image]
    return weights if model.allowed is None else np.where(model.allowed[rows, image], weights, -np.inf)
