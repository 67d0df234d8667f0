"""Covariance of a fit whose χ² is no parabola: second moments of its likelihood, by adaptive importance sampling.

Two views that determine a rotation and a baseline badly have valleys of χ² that bend, and (Jᵀ J)⁻¹ at the bottom is
then far too small.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rootmatch.arrays import Floats

BENT = 0.15
"""Relative deviation of χ² from its parabola, at the 68 % contour along its axes, from which samples are drawn. A round
value: variances are then off by about as much (benchmarks/poses.py)."""
SAMPLES = 512
"""Samples a round. Not tuned: a variance is then known to about a tenth."""
ROUNDS = 5
"""Rounds, each with a proposal that fits the samples of those before. Not tuned."""
TAILS = 4.0
"""Degrees of freedom of the proposal, a t distribution, whose tails are wider than those of any likelihood here."""
TEMPERATURE = 2.0
"""Log likelihoods are divided by this where proposals are fitted: they then reach along valleys that bend. Of 1, 2, 3
the value with the most of 1,200 scenes with noisy directions inside the 95 % quantile, by 0.4 % (seeds from 1000)."""
ENOUGH = 30.0
"""Minimum effective number of samples. Not tuned."""


def second_moments(chi2: Callable[[Floats], Floats], covariance: Floats) -> Floats:
    """Second moments (p, p) about 0 of steps under exp(−χ² / 2).

    Parameters
    ----------
    chi2 : callable
        Excess of χ² (S,) over the bottom after steps (S, p) from there; infinite where impossible.
    covariance : (p, p) array
        (Jᵀ J)⁻¹ at the bottom, returned where χ² is a parabola that far, or where samples cannot say more: a direction
        that the points do not determine at all, or hardly any sample that is likely.
    """
    try:
        sampled = _sample_moments(chi2, covariance)
    except np.linalg.LinAlgError:  # a proposal without extent in some direction
        return covariance
    return covariance if sampled is None or not np.all(np.isfinite(sampled)) else sampled


def _sample_moments(chi2: Callable[[Floats], Floats], covariance: Floats) -> Floats | None:
    """See `moments`; nothing if the covariance given is as good."""
    values, vectors = np.linalg.eigh(covariance)
    axes = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    size = len(axes)
    contour = float(np.sqrt(size))
    ends = chi2(contour * np.concatenate([axes, -axes]))
    if not np.any(np.abs(ends / size - 1.0) > BENT):
        return None
    rng = np.random.default_rng(0)
    mean, root = np.zeros(size), axes.T
    steps: list[Floats] = []
    excess: list[Floats] = []
    proposals: list[tuple[Floats, Floats]] = []
    weight = np.zeros(0)
    for _ in range(ROUNDS):
        normal = rng.standard_normal((SAMPLES, size)) / np.sqrt(rng.chisquare(TAILS, (SAMPLES, 1)) / TAILS)
        steps.append(mean + normal @ root.T)
        excess.append(chi2(steps[-1]))
        proposals.append((mean, root))
        every = np.concatenate(steps)
        # all samples of all rounds, as of the mixture of their proposals
        density = np.mean([_t_density(every, *proposal) for proposal in proposals], axis=0)
        weight, tempered = (_weights(np.concatenate(excess) / heat, density) for heat in (1.0, TEMPERATURE))
        if not weight.any():
            return None
        mean = tempered @ every
        spread = (every - mean).T @ (tempered[:, None] * (every - mean)) + 1e-3 * covariance
        root = np.linalg.cholesky(spread)
    if 1.0 / float((weight**2).sum()) < ENOUGH:
        return None
    every = np.concatenate(steps)
    return np.asarray(every.T @ (weight[:, None] * every))


def _weights(chi2: Floats, density: Floats) -> Floats:
    """Weights (S,) of samples drawn with a density, of sum 1; all 0 where no sample is possible."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        weight = np.exp(-0.5 * chi2) / density
    weight = np.where(np.isfinite(weight), weight, 0.0)
    return weight / max(float(weight.sum()), 1e-300)


def _t_density(steps: Floats, mean: Floats, root: Floats) -> Floats:
    """Density (S,) of a t distribution, up to a factor that all share."""
    squared = (np.linalg.solve(root, (steps - mean).T) ** 2).sum(axis=0)
    size = len(mean)
    return np.asarray((1.0 + squared / TAILS) ** (-0.5 * (TAILS + size)) / abs(np.linalg.det(root)))
