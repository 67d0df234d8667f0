"""Samples of what is unknown of two views, for integrals over it: relative pose, s², detection rate and clutter.

Importance sampling from a mixture of Student's t distributions about the fits of proposed assignments. First samples
tell where the posterior is, which may be bent or have several places; the second ones are drawn about some of those.
The weights are by the density of the whole mixture, so that what a centre misses another one makes up for.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.model.two_view_fit import Fitted, fit_relative_poses
from rootmatch.model.two_view_model import Relative, TwoViewModel

POSES = 8
"""Most fits about which samples are drawn. A round value."""
FREEDOM = 5.0
"""Of the t distributions: their tails are wider than those of any posterior here. A round value."""
WIDER = 1.2
"""Factor on the σ of a fit, which is of first order. A round value."""
DISTINCT2 = 4.0
"""Squared distance, in σ, from which fits are distinct. A round value."""
EVEN = 0.05
"""Share that every fit has, over that of the best. A round value."""
HOPELESS = 36.0
"""Log evidence below the best, to first order, at which a fit is left out. A round value."""
KERNELS = 16
"""First samples about which second ones are drawn. A round value."""
NARROWER = 0.6
"""Their σ over that of the first ones, times `WIDER`: about Silverman's (1986) rule for so many in five dimensions."""
FAR = 10.0
"""Steps, in radians and in logarithms, that are no part of a neighbourhood. A round value."""
SHRUNK = 0.1
"""Of a fit's covariance, which is added so that few samples leave no direction out. A round value."""
FITS = 0.3
"""Share of the second samples that is still drawn about the fits. A round value."""
TEMPERED = 0.7
"""Part of its counts by which a fit tells rate and clutter, whose samples are spread wider. A round value."""


class Centres(NamedTuple):
    """C poses about which samples are drawn, their covariances (C, p, p), and shares (C,) of the samples."""

    fits: Fitted
    shares: Floats
    group: Integers
    """(C,) number of the fit that each is near."""

    def counts(self, count: int) -> Integers:
        """How many of some samples are about each."""
        edges = np.round(np.cumsum(self.shares) * count).astype(np.int64)
        return np.diff(np.concatenate([[0], edges]))


class Samples(NamedTuple):
    """K poses with factors s², detection rates δ and expected numbers of clutter points Λ; the centre of each."""

    poses: Relative
    variance: Floats
    rate: Floats
    clutter: Floats
    centre: Integers

    def take(self, rows: Integers) -> Samples:
        """Some of them."""
        others: list[Any] = [part[rows] for part in self[1:]]
        return Samples(self.poses.take(rows), *others)

    def log_odds(self, model: TwoViewModel, pairs: tuple[Integers, Integers]) -> Floats:
        """Log-odds (K, P) of pairs to be matches, against being unmatched."""
        term = np.log(self.rate) - np.log1p(-self.rate) - np.log(self.clutter)
        return model.log_odds(self.poses, self.variance, term, pairs)

    @classmethod
    def joined(cls, parts: list[Samples]) -> Samples:
        """All of several, one after the other."""
        others: list[Any] = [np.concatenate(values) for values in zip(*(part[1:] for part in parts), strict=True)]
        return cls(Relative.joined([part.poses for part in parts]), *others)


def choose_centres(model: TwoViewModel, fits: Fitted) -> Centres:
    """The likeliest distinct ones of K fits, of which there is one at least."""
    value = fit_log_evidence(model, fits)
    order = np.argsort(-value, kind="stable")
    fits, value = fits.take(order), value[order]
    apart = _distances2(model, fits, fits.poses) > DISTINCT2
    kept: list[int] = []
    for c in range(len(value)):
        if len(kept) < POSES and value[c] > value[0] - HOPELESS and apart[kept, c].all():
            kept.append(c)
    shares = np.exp(0.5 * (value[kept] - value[0])) + EVEN
    return Centres(fits.take(np.array(kept)), shares / shares.sum(), np.arange(len(kept)))


def fit_log_evidence(model: TwoViewModel, fits: Fitted) -> Floats:
    """Logarithms (K,) of the evidence of fits to first order, up to a constant."""
    n, n_target = model.shape
    used, k = fits.assignments >= 0, np.maximum(fits.assignments, 0)
    matched = used.sum(axis=1)
    log = model.seen(fits.poses, np.arange(n), k).log_density - model.log_clutter[k]
    value = np.where(used, np.maximum(log, -HOPELESS), 0.0).sum(axis=1)
    rate, clutter = (matched + 0.5) / (n + 1.0), n_target - matched + 0.5
    value += matched * (np.log(rate) - np.log1p(-rate) - np.log(clutter)) + n * np.log1p(-rate)
    value += 0.5 * np.linalg.slogdet(fits.covariance)[1]
    return np.asarray(value)


def fit_likeliest(model: TwoViewModel, assignments: Integers) -> Fitted:
    """The fit of each of some assignments (K, n) that has the most evidence.

    Epipolar planes alone do not tell a pose from one that has the points behind a camera.
    """
    fits, count = fit_relative_poses(model, assignments), len(assignments)
    every = fit_log_evidence(model, fits).reshape(count, -1)
    return fits.take(every.argmax(axis=1) + every.shape[1] * np.arange(count))


def _distances2(model: TwoViewModel, fits: Fitted, poses: Relative) -> Floats:
    """Squared distances (C, K) of poses from C fits, in σ of those."""
    steps, _ = model.steps_to(fits.poses, poses)
    return np.asarray((steps * (steps @ np.linalg.inv(fits.covariance))).sum(axis=-1))


def recentre_on_samples(model: TwoViewModel, centres: Centres, drawn: Samples, weights: Floats) -> Centres:
    """The centres, and some of K samples with weights (K,), the covariances of those near each centre about them."""
    fits, count = centres.fits, len(weights)
    # the largest are cut, as few samples tell little of their weight
    weights = np.minimum(weights, weights.mean() * math.sqrt(count))
    weights = weights / weights.sum()
    chosen = np.searchsorted(np.cumsum(weights), (np.arange(KERNELS) + 0.5) / KERNELS).clip(max=count - 1)
    group = _distances2(model, fits, drawn.poses).argmin(axis=0)
    steps = model.steps_to(fits.poses, drawn.poses)[0][group, np.arange(count)]
    near = np.abs(steps).max(axis=1) < FAR
    covariance = SHRUNK * fits.covariance
    for c in np.unique(group[near]):
        some = near & (group == c)
        own = weights[some] / max(float(weights[some].sum()), 1e-300)
        apart = steps[some] - own @ steps[some]
        covariance[c] += (own[:, None] * apart).T @ apart
    group = group[chosen]
    more = fits.take(group)._replace(poses=drawn.poses.take(chosen), covariance=NARROWER**2 * covariance[group])
    shares = np.concatenate([FITS * centres.shares, np.full(KERNELS, (1.0 - FITS) / KERNELS)])
    return Centres(fits.joined(more), shares, np.concatenate([centres.group, group]))


def draw_samples(model: TwoViewModel, centres: Centres, count: int, rng: np.random.Generator) -> Samples:
    """Samples about the centres, as many as their shares."""
    fits = centres.fits
    poses, centre = draw_relative_poses(model, centres, count, rng)
    of_rate, of_clutter, (shape, scale) = _nuisance_parameters(model, fits)
    variance = scale[centre] / rng.gamma(shape[centre])
    rate = np.full(count, model.detection_rate)
    if model.detection_rate is None:
        rate = rng.beta(of_rate[0][centre], of_rate[1][centre])
    return Samples(poses, variance, rate, rng.gamma(of_clutter[centre]), centre)


def draw_relative_poses(
    model: TwoViewModel, centres: Centres, count: int, rng: np.random.Generator
) -> tuple[Relative, Integers]:
    """Poses about the centres, as many as their shares, and the centre (count,) of each."""
    fits, centre = centres.fits, np.repeat(np.arange(len(centres.shares)), centres.counts(count))
    roots = WIDER * np.linalg.cholesky(fits.covariance)
    normal = rng.standard_normal((count, model.size)) / np.sqrt(rng.chisquare(FREEDOM, count) / FREEDOM)[:, None]
    return model.moved(fits.poses.take(centre), (roots[centre] @ normal[..., None])[..., 0]), centre


def log_proposal_density(model: TwoViewModel, centres: Centres, drawn: Samples) -> Floats:
    """Logarithm (K,) of the density of samples, by the whole mixture."""
    from scipy.special import betaln, gammaln  # slow to import

    log, some = log_pose_proposal_density(model, centres, drawn.poses)
    # s², δ and Λ are drawn alike about all centres of one fit, and their densities are exponential families
    (a, b), k, (shape, scale) = _nuisance_parameters(model, centres.fits)
    factors = np.stack([-(shape + 1.0), -scale, k - 1.0])
    of_drawn = np.stack([np.log(drawn.variance), 1.0 / drawn.variance, np.log(drawn.clutter)])
    norm = shape * np.log(scale) - gammaln(shape) - gammaln(k)
    if model.detection_rate is None:
        factors = np.concatenate([factors, [a - 1.0, b - 1.0]])
        of_drawn = np.concatenate([of_drawn, [np.log(drawn.rate), np.log1p(-drawn.rate)]])
        norm -= betaln(a, b)
    log += (factors.T @ of_drawn + norm[:, None])[centres.group[some]]
    return np.asarray(log_sum(log) - drawn.clutter)


def log_pose_proposal_density(model: TwoViewModel, centres: Centres, poses: Relative) -> tuple[Floats, Integers]:
    """Logarithm (C, K) of the density of poses about each centre that has any, its share included; those centres."""
    counts = centres.counts(len(poses.turn))
    some = np.flatnonzero(counts)
    fits, size = centres.fits.take(some), model.size
    steps, log_area = model.steps_to(fits.poses, poses)
    roots = WIDER * np.linalg.cholesky(fits.covariance)
    white = np.linalg.inv(roots) @ steps.swapaxes(-1, -2)
    power = 0.5 * (FREEDOM + size)
    constant = math.lgamma(power) - math.lgamma(0.5 * FREEDOM) - 0.5 * size * math.log(FREEDOM * math.pi)
    log = log_area - power * np.log1p((white * white).sum(axis=1) / FREEDOM)
    share = np.log(counts[some] / counts.sum()) - np.log(np.einsum("caa->ca", roots)).sum(axis=1) + constant
    return log + share[:, None], some


def log_sum(log: Floats) -> Floats:
    """Logarithm (…,) of the sum of values with logarithms (C, …)."""
    maximum = log.max(axis=0)
    return np.asarray(maximum + np.log(np.exp(log - maximum).sum(axis=0)))


def log_sample_prior(model: TwoViewModel, drawn: Samples) -> Floats:
    """Logarithm (K,) of the prior density of samples, that of Λ being Jeffreys', which is Λ^(−½)."""
    half, variance = 0.5 * NOISE_FREEDOM, drawn.variance
    of_variance = half * math.log(half) - math.lgamma(half) - (half + 1.0) * np.log(variance) - half / variance
    return np.asarray(model.log_prior(drawn.poses) + of_variance - 0.5 * np.log(drawn.clutter))


def _nuisance_parameters(
    model: TwoViewModel, fits: Fitted
) -> tuple[tuple[Floats, Floats], Floats, tuple[Floats, Floats]]:
    """Parameters, (C,) each, of the beta, gamma and inverse gamma distributions of δ, Λ and s² about each centre."""
    n, n_target = model.shape
    matched = (fits.assignments >= 0).sum(axis=1)
    freedom = np.maximum(matched - (2 if model.planar else 3), 0)
    of_rate = 1.0 + TEMPERED * matched, 1.0 + TEMPERED * (n - matched)
    of_variance = 0.5 * (NOISE_FREEDOM + freedom), 0.5 * (NOISE_FREEDOM + fits.chi2)
    return of_rate, n_target - matched + 1.0, of_variance
