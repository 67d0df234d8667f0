"""Sums over all labellings about one motion, for sets of which many points are in doubt.

Of ten points that may each be unmatched as well, there are a thousand labellings, none of which is probable. Those
that are weighed one by one are few of them, and what all of these have in common looks certain. Given the motion, the
factor of σ, the detection rate δ and the density λ of clutter, the odds of a labelling are the product of those of its
matches,

    δ / ((1 − δ) λ) · N(x'_j; s R x_i + t, s² σ_i² + σ_j²) / f(x'_j),

whose sum over all labellings `rootmatch.model.matchings` has. These unknowns are integrated over by importance
sampling, about the motions of the labellings that were weighed; see `rootmatch.model.point_set_model` for their priors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rootmatch.algebra.rotation import angle_count, rotation_from_vector
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.matchings import sum_matchings_by_part
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.priors import NOISE_FREEDOM, log_chance
from rootmatch.model.shown_regions import log_region_factor
from rootmatch.problems.pose_fit.point_set_fit import PointSetFit
from rootmatch.problems.pose_fit.pose_prior import turn_vectors

SAMPLES = 128
"""Number of samples. A round value."""
WIDER = 1.5
"""Factor on the deviations of motions that samples have. A round value."""
RARE = 0.02
"""Part of the best labelling's probability up to which nothing is drawn about another one. A round value."""
PART = 0.6
"""Part of what labellings tell of rates and of σ by which these are drawn, wider than they are. A round value."""
MINIMUM = -9.0
"""Log-odds of a match below which it counts for nothing in any sample."""
MARGIN = 6.0
"""The same, less this, about the motion of the best labelling. A round value."""

SHARED = 0.5
"""Fraction of its matches that a hypothesis of the same motion has in common with another one. A round value."""


@dataclass(frozen=True, eq=False)
class LabellingSums:
    """Samples of all that is unknown but the labelling, and the sums over labellings for each.

    Attributes
    ----------
    about : (n,) int64 array
        The best labelling about the motion.
    weights : (S,) array
        Probability of each sample, whatever the labelling.
    pair : (n, n') int64 array
        Number of each match; P of those that do not count.
    log_odds : (S, P) array
        Of each match against being unmatched.
    log_total : (S,) array
        Logarithm of the sum of the products of the odds.
    marginals : (S, P + 1) array
        Probability of each match; 0 at last.
    """

    about: Integers
    weights: Floats
    pair: Integers
    log_odds: Floats
    log_total: Floats
    marginals: Floats

    @property
    def count(self) -> float:
        """Number of samples that count."""
        return 1.0 / float((self.weights**2).sum())

    @cached_property
    def unmatched(self) -> Floats:
        """Probability (S, n) in each sample that a point has no target."""
        return 1.0 - self.of_targets(np.arange(len(self.pair)), self.pair < self.marginals.shape[1] - 1)

    def of_points(self, assignment: Integers) -> Floats:
        """Probability (S, n) in each sample that a point has its target of an assignment (n,), or none."""
        own = self.marginals[:, self.pair[np.arange(len(assignment)), assignment]]
        return np.where(assignment >= 0, own, self.unmatched)

    def of_targets(self, points: Integers, targets: Bools) -> Floats:
        """Probability (S, m) in each sample that each of some points (m,) has any of some targets (m, n')."""
        own = np.zeros((len(self.weights), len(points)))
        rows, columns = np.nonzero(targets)
        np.add.at(own.T, rows, self.marginals[:, self.pair[points[rows], columns]].T)
        return own

    def shares(self, assignments: Integers) -> Floats:
        """Probability (K,) of each of some labellings (K, n) among all about the motion."""
        last = self.log_odds.shape[1]
        matched, points = np.nonzero(assignments >= 0)
        has = np.zeros((len(assignments), last + 1))
        has[matched, self.pair[points, assignments[matched, points]]] = 1.0
        each = has[:, :last] @ self.log_odds.T - self.log_total
        return np.asarray(np.where(has[:, last] > 0.0, 0.0, np.exp(np.minimum(each, 0.0)) @ self.weights))


def is_same_motion(assignments: Integers, first: Integers, twins: Bools | None = None) -> Bools:
    """Which assignments (K, n) have so many matches of a first one that they are about its motion.

    ``twins`` (n', n'): which targets may be measurements of one place, so that either tells the same motion.
    """
    same = assignments == first
    if twins is not None and not (same | (assignments < 0) | (first < 0)).all():
        same |= twins[assignments, first] & (assignments >= 0)
    common = (same & (first >= 0)).sum(axis=1)
    return np.asarray(common >= SHARED * max(int((first >= 0).sum()), 1))


def sum_labellings(model: PointSetModel, assignments: Integers, probabilities: Floats) -> LabellingSums | None:
    """The sums over all labellings about the motion that some labellings (K, n) share, the best one first.

    ``probabilities`` (K,): of these, up to a common factor. None if no sample has labellings that determine a motion.
    """
    n, n_target = len(model.clouds.source), len(model.clouds.target)
    rng = np.random.default_rng(0)
    fit = model.fit(assignments)
    kind = np.linalg.det(fit.rotation)
    about = np.flatnonzero((kind * kind[0] > 0.0) & (probabilities > RARE * probabilities[0]))
    fit, share = fit.take(about), probabilities[about] / probabilities[about].sum()
    motions, log_weight = _sample_motions(fit, share, rng)
    # the factor of the best labelling, and how a point's having a target changes that of regions
    best = np.tile(assignments[0], (SAMPLES, 1))
    changed = _region_log_changes(model, assignments[0])
    log_weight += np.logaddexp.reduce(model.log_factors(replace(motions, assignments=best)), axis=0)
    log_weight -= changed[assignments[0] >= 0].sum()
    # 1 / the factor of the variances, whose prior is a gamma distribution, as is what one labelling tells
    freedom, squares = NOISE_FREEDOM + float(share @ fit.dof), NOISE_FREEDOM + float(share @ fit.chi2)
    exact, log_exact = _sample_gamma(PART * 0.5 * freedom, PART * 0.5 * squares, rng)
    log_weight += (0.5 * NOISE_FREEDOM - 1.0) * np.log(exact) - 0.5 * NOISE_FREEDOM * exact - log_exact
    matched = float(share @ (fit.assignments >= 0).sum(axis=1))
    density, log_density = _sample_gamma(PART * (n_target - matched + 0.5), PART, rng)
    log_weight += (n_target - 0.5) * np.log(density) - density - log_density
    rate = np.full(SAMPLES, model.detection_rate)
    if model.detection_rate is None:
        a, b = PART * (matched + 1.0), PART * (n - matched + 1.0)
        rate = np.clip(rng.beta(a, b, SAMPLES), 1e-9, 1.0 - 1e-9)
        log_weight -= (a - 1.0) * np.log(rate) + (b - 1.0) * np.log1p(-rate)
    log_weight += n * np.log1p(-rate)
    rows, columns = np.nonzero(model.gains(fit, 0) > MINIMUM - MARGIN)
    near = model.clutter_about_points(motions, np.ones((SAMPLES, n), np.bool_))
    of_hidden = model.log_hidden_clutter(matched) - model.log_hidden_clutter(min(matched + 1.0, n, n_target))
    log_clutter = model.clutter.log_density_of_all
    more = near * np.exp(model.clutter.log_density - log_clutter)
    log_weight += np.log1p(more).sum(axis=1)
    log_odds = _pair_log_densities(model, motions, exact, (rows, columns)) - (log_clutter + np.log1p(more))[:, columns]
    log_odds += (np.log(rate) - np.log1p(-rate) - np.log(density) + of_hidden)[:, None] + changed[rows]
    sums = sum_matchings_by_part(log_odds, rows, columns, MINIMUM)
    log_weight += sums.log_total
    known = np.flatnonzero(np.isfinite(log_weight))
    if not len(known):
        return None
    sums, log_weight = sums.take(known), log_weight[known]
    weights = np.exp(log_weight - log_weight.max())
    pair = np.full((n, n_target), len(sums.rows))
    pair[sums.rows, sums.columns] = np.arange(len(sums.rows))
    return LabellingSums(
        about=assignments[0], weights=weights / weights.sum(), pair=pair, log_odds=sums.log_odds,
        log_total=sums.log_total, marginals=np.pad(sums.marginals, ((0, 0), (0, 1))),
    )  # fmt: skip


def _sample_gamma(shape: float, rate: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Samples of a gamma distribution, and the logarithm of their density, up to a constant."""
    drawn = np.maximum(rng.gamma(shape, 1.0 / rate, SAMPLES), 1e-300)
    return drawn, (shape - 1.0) * np.log(drawn) - rate * drawn


def _region_log_changes(model: PointSetModel, assignment: Integers) -> Floats:
    """Logarithm (n,) by which a target of each point, given those of the others, changes `log_region_factor`."""
    n, matched = len(assignment), assignment >= 0
    changed = np.tile(matched, (n + 1, 1))
    changed[np.arange(n), np.arange(n)] = ~matched
    *others, own = log_region_factor(model.clouds.source, changed, model.detection_rate)
    return np.asarray(np.where(matched, -1.0, 1.0) * (np.array(others) - own))


def _pair_log_densities(
    model: PointSetModel, motions: PointSetFit, exact: Floats, pairs: tuple[Integers, Integers]
) -> Floats:
    """Logarithm (S, P) of the density of each pair."""
    rows, columns = pairs
    clouds, size = model.clouds, model.clouds.source.shape[1]
    moved = motions.scale[:, None, None] * clouds.source @ motions.rotation.swapaxes(1, 2) + motions.shift[:, None]
    off = moved[:, rows] - clouds.target[columns]
    if clouds.has_covariances:
        first, second = clouds.covariances(motions.scale[:, None, None] * motions.rotation)
        white = np.linalg.inv(np.linalg.cholesky(first[:, rows] + second[columns]))
        squared = ((white @ off[..., None]) ** 2).sum(axis=(2, 3))
        log_volume = -2.0 * np.log(np.diagonal(white, axis1=2, axis2=3)).sum(axis=2)
    else:
        variance = (motions.scale**2)[:, None] * clouds.source_variance[rows] + clouds.target_variance[columns]
        squared, log_volume = (off**2).sum(axis=2) / variance, size * np.log(variance)
    odds = -0.5 * (squared * exact[:, None] + log_volume + size * np.log(2.0 * np.pi / exact)[:, None])
    if model.log_weights is not None:
        odds += model.log_weights[rows, columns]
    return np.asarray(odds)


def _sample_motions(fit: PointSetFit, share: Floats, rng: np.random.Generator) -> tuple[PointSetFit, Floats]:
    """Motions (S,) about those of labellings, without any uncertainty of their own, and −log of their density."""
    which = rng.choice(len(share), SAMPLES, p=share)
    size = fit.shift.shape[1]
    near, angles = fit.take(which), angle_count(size)
    root = WIDER * np.linalg.cholesky(fit.covariance)
    step = (root[which] @ rng.normal(size=(SAMPLES, root.shape[1], 1)))[..., 0]
    turn, off = step[:, :angles], step[:, angles : angles + size]
    if size == 3:
        turned = rotation_from_vector(turn)
    else:
        c, s = np.cos(turn[:, 0]), np.sin(turn[:, 0])
        turned = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    scale = near.scale * np.exp(step[:, -1]) if fit.clouds.scaled else near.scale
    rotation = turned @ near.rotation
    shift = _transform_points(near, near.centre) + off - scale[:, None] * (rotation @ near.centre[:, :, None])[:, :, 0]
    motions = replace(
        near, rotation=rotation, shift=shift, scale=scale, full=np.zeros_like(near.full),
        spread=np.zeros_like(near.spread), total=np.full(SAMPLES, np.inf),
    )  # fmt: skip
    turns = rotation @ fit.rotation[:, None].swapaxes(2, 3)
    steps = [turn_vectors(turns.reshape(-1, size, size)).reshape(len(share), SAMPLES, angles)]
    moved = scale[:, None] * (fit.centre @ rotation.swapaxes(1, 2)).swapaxes(0, 1) + shift
    steps.append(moved - _transform_points(fit, fit.centre)[:, None])
    if fit.clouds.scaled:
        steps.append(np.log(scale / fit.scale[:, None])[..., None])
    white = np.linalg.inv(root)
    squared = ((np.concatenate(steps, axis=2) @ white.swapaxes(1, 2)) ** 2).sum(axis=2)
    log_density = np.log(np.diagonal(white, axis1=1, axis2=2)).sum(axis=1)[:, None] - 0.5 * squared
    return motions, -np.logaddexp.reduce(log_density + log_chance(share)[:, None], axis=0)


def _transform_points(motions: PointSetFit, points: Floats) -> Floats:
    """Images (S, k) of a point each, (S, k)."""
    turned = (motions.rotation @ points[:, :, None])[:, :, 0]
    return np.asarray(motions.scale[:, None] * turned + motions.shift)
