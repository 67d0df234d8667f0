"""The evidence that two images show scenes that are alike, and not the same points.

Two houses have windows in rows, two car parks have bays. At some pose of the second camera all such detections are near
places where points of the first image may be seen: nearer than by chance, but far outside the noise. A few are within
it at some pose nearby. For clutter that is improbable, and more so along rows that are epipolar lines; for this it is
not: deviations are w times as large as the noise, for w anything beyond it, and each detection is clutter or, with a
share a, about the image of any point of the first one,

    A = ∫ p(T, μ, τ) p(w) p(a) Π_j [1 − a + a Σ_i w_ij p_ij(w) / (n f_j)].

The integral is by importance sampling about the poses of the same points, with w² times their covariances.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.model.priors import ALIKE
from rootmatch.model.two_view_model import Relative, TwoViewModel
from rootmatch.model.two_view_samples import (
    FITS,
    NARROWER,
    Centres,
    draw_relative_poses,
    log_pose_proposal_density,
    log_sum,
)
from rootmatch.problems.pose_fit.two_view_pose import OPEN

if TYPE_CHECKING:
    from rootmatch.model.two_view_posterior import TwoViewPosterior

REPEATED = 1.0
"""Odds that a scene is like itself elsewhere, over those that it is not. A round value."""
WIDTHS = np.array([4.0, 8.0, 16.0, 32.0, 64.0])
"""Deviations w over those of the noise, one as probable as the other: from what noise cannot be to a part of an image.
Round values."""
SAMPLES = 160
"""Samples of a round, at most. A round value."""
FEWEST_SAMPLES = 16
"""Samples of a round of images with so many points that there are less than so many. A round value."""
MAX_RATIOS = 1_000_000
"""Pairs of points times samples. A round value; it bounds time."""
IMPROBABLE = -4.0
"""Log evidence of the same points below which they are improbable, whatever else there is: .02. A round value."""
ROUNDS = 3
"""Rounds, each with samples about some of the one before. A round value."""
MARGIN = 9.0
"""By how much the logarithm that the first round finds may be below what matters and still be looked at: four change a
probability by a fiftieth, and five is what the samples may miss. A round value; it bounds time."""
KERNELS = 32
"""Samples of a round about which those of the next are drawn. A round value."""
NODES = 8
"""Of the integral over a. A round value."""

Pairs = tuple[Integers, Integers]


def likeness_log_odds(told: TwoViewPosterior, centres: Centres, pairs: Pairs, seed: int) -> tuple[float, float]:
    """Logarithms of prior times evidence that scenes are alike, against clutter, and of what a scene like itself adds.

    If the images show the same points, those without a match may be alike to others, elsewhere in one scene: with the
    odds A of matched and other detections over those of matched ones. A detection that is where a point without a
    match may be seen is none of these, as a place holds one point.

    ``told`` and ``centres`` are of the same points; what is alike matters only if it has about as much evidence.
    ``pairs``: points, in order, and detections (P,) that may be matches.

    Returns
    -------
    alike : float
        Over the prior of nothing in common.
    repeated : float
        0 if the scene does not look like itself.

    Both are those of nothing in common where the same points are `IMPROBABLE`.
    """
    model = told.model
    if told.log_evidence < IMPROBABLE:
        return -math.inf, 0.0
    rng = np.random.default_rng([seed, 18])
    counted, about = np.ones((1, model.shape[1])), _widen_centres(centres)
    (first, widths), count = about, max(min(SAMPLES, MAX_RATIOS // max(len(pairs[0]), 1)), FEWEST_SAMPLES)
    found = np.array([-math.inf])
    for k in range(ROUNDS):
        checkpoint()
        wider, widths = about
        poses, centre = draw_relative_poses(model, wider, count, rng)
        width = widths[centre]
        log, some = log_pose_proposal_density(model, wider, poses)
        log_drawn = log_sum(np.where(widths[some][:, None] == width, log, -np.inf))
        if k == 1:
            counted = np.concatenate([counted, _detection_counts(told, pairs)])
        value = model.log_prior(poses) - math.log(len(WIDTHS)) - log_drawn
        value = value + _integrate_share(_alike_density_ratios(model, poses, width, pairs), counted)
        maximum = value.max(axis=1, keepdims=True)
        if not np.isfinite(maximum).all():
            break
        weights = np.exp(value - maximum)
        found = maximum[:, 0] + np.log(weights.mean(axis=1))
        if found[0] + math.log(ALIKE) < max(told.log_evidence, 0.0) - MARGIN:
            break
        # the largest are cut, as few samples tell little of their weight
        weights = np.minimum(weights, math.sqrt(count) * weights.mean(axis=1, keepdims=True))
        edges = np.cumsum((weights / weights.sum(axis=1, keepdims=True)).mean(axis=0))
        chosen = np.searchsorted(edges, (np.arange(KERNELS) + 0.5) / KERNELS).clip(max=count - 1)
        kernels = wider.fits.take(centre[chosen])
        kernels = kernels._replace(poses=poses.take(chosen), covariance=NARROWER**2 * kernels.covariance)
        shares = np.concatenate([FITS * first.shares, np.full(KERNELS, (1.0 - FITS) / KERNELS)])
        group = np.concatenate([first.group, wider.group[centre[chosen]]])
        of_fits = widths[: len(first.shares)]
        about = Centres(first.fits.joined(kernels), shares, group), np.concatenate([of_fits, width[chosen]])
    repeated = float(found[2] - found[1]) if len(found) == 3 else -math.inf
    return math.log(ALIKE) + float(found[0]), float(np.logaddexp(0.0, math.log(REPEATED) + repeated))


def _widen_centres(centres: Centres) -> tuple[Centres, Floats]:
    """The centres for each of the widths, and the width of each."""
    rows = np.tile(np.arange(len(centres.shares)), len(WIDTHS))
    widths = np.repeat(WIDTHS, len(centres.shares))
    fits = centres.fits.take(rows)
    precision = np.linalg.inv(centres.fits.covariance)[rows] / widths[:, None, None] ** 2
    covariance = np.linalg.inv(precision + np.eye(precision.shape[1]) / OPEN**2)
    return Centres(fits._replace(covariance=covariance), centres.shares[rows] / len(WIDTHS), rows), widths


def _detection_counts(told: TwoViewPosterior, pairs: Pairs) -> Floats:
    """How much each detection (2, n') is matched, and matched or another one that is not where a lost point is."""
    model, parts = told.model, told.parts
    matched, found = (np.minimum(told.marginals.sum(axis=axis), 1.0) for axis in (0, 1))
    shares = np.array([weights.sum() for _, weights, _ in parts])
    best = np.argsort(-shares, kind="stable")[: max(MAX_RATIOS // (len(WIDTHS) * max(len(pairs[0]), 1)), 1)]
    poses = Relative.joined([parts[k][0].poses.take(parts[k][1].argmax()[None]) for k in best])
    widths, every = np.repeat(WIDTHS, len(best)), np.tile(np.arange(len(best)), len(WIDTHS))
    ratios = _alike_density_ratios(model, poses.take(every), widths, pairs, 1.0 - found).reshape(
        len(WIDTHS), len(best), -1
    )
    there = (shares[best] @ ratios / shares[best].sum()).max(axis=0)
    return np.stack([matched, matched + (1.0 - matched) / (1.0 + there)])


def _alike_density_ratios(
    model: TwoViewModel, poses: Relative, widths: Floats, pairs: Pairs, counted: Floats | None = None
) -> Floats:
    """Densities (K, n') of detections that are alike to points, over those of clutter; ``counted`` (n,): how much."""
    odds = np.exp(model.log_odds(poses, widths**2, np.zeros(len(widths)), pairs))
    if counted is not None:
        odds *= counted[pairs[0]]
    order = np.argsort(pairs[1], kind="stable")
    columns = pairs[1][order]
    first = np.flatnonzero(np.diff(columns, prepend=-1))
    ratios = np.zeros((len(widths), model.shape[1]))
    ratios[:, columns[first]] = np.add.reduceat(odds[:, order], first, axis=1) / model.shape[0]
    return ratios


def _integrate_share(ratios: Floats, counted: Floats) -> Floats:
    """Logarithms (C, K) of the odds of detections, by ratios (K, n'), for any share of those that are alike.

    ``counted`` (C, n'): how much each counts.
    """
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    log = np.stack([counted @ np.log(1.0 + a * (ratios.T - 1.0)) for a in 0.5 * (1.0 + nodes)])
    return log_sum(log + np.log(0.5 * weights)[:, None, None])
