"""The evidence that two images show scenes that are alike, and not the same points.

Two houses have windows in rows, two car parks have bays. At some pose of the second camera all such detections are near
places where points of the first image may be seen, nearer than by chance, but far outside the noise; a few are within
it, in some pose nearby. To clutter alone that is improbable, and more so along rows that are epipolar lines.
So the images may be clutter, the same points, or this: deviations are w times as large as the noise, for w anything
beyond it, and each detection is clutter or, with a share a, anywhere about the image of any point of the first one:

    A = ∫ p(T, μ, τ) p(w) p(a) Π_j [1 − a + a Σ_i w_ij p_ij(w) / (n f_j)]

an integral by importance sampling about the same poses as that of the same points, whose covariances are w² as large.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.model.two_view_model import Relative, TwoViewModel
from rootmatch.model.two_view_samples import Centres, drawn_poses, log_drawn_poses, log_sum
from rootmatch.problems.pose_fit.two_view_pose import OPEN

WIDTHS = np.array([4.0, 8.0, 16.0, 32.0, 64.0])
"""Deviations w over the noise, each as probable. From what the noise cannot be to a good part of an image; round."""
SAMPLES = 256
"""Samples of a round, and in the first one the most. A round value."""
FEWEST = 16
"""The least, of images with so many points that there are less than so many. A round value."""
MOST_RATIOS = 1_000_000
"""Pairs of points times samples. A round value; it bounds time."""
ROUNDS = 3
"""Most rounds, each about the samples before, where the evidence matters. A round value."""
MARGIN = 10.0
"""By how much, as a logarithm, the first round may have missed the evidence: below that it does not matter."""
KERNELS = 32
"""Samples of a round about which those of the next are drawn. A round value."""
NARROWER = 0.6
"""Their σ over that of the first ones. As of the samples of the same points."""
FITS = 0.3
"""Share of the samples that is still drawn about the fits. As there."""
NODES = 8
"""Of the integral over a. A round value."""


def log_evidence_of_alike(
    model: TwoViewModel, centres: Centres, pairs: tuple[Integers, Integers], others: Floats, matters: float, seed: int
) -> tuple[float, float]:
    """Logarithms of the odds A, against clutter alone, of images of scenes that are alike, by all and by some detections.

    Parameters
    ----------
    model : TwoViewModel
    centres : Centres
        Poses of the same points.
    pairs : two (P,) arrays
        Points, in order, and detections that may be matches.
    others : (n',) array
        Probability that each detection is one of those others.
    matters : float
        Logarithm from which the odds matter: below, they are told roughly.
    """
    rng = np.random.default_rng([seed, 18])
    counted = np.stack([np.ones_like(others), others])
    first, widths = _wider(centres)
    about, count = first, max(min(SAMPLES, MOST_RATIOS // max(len(pairs[0]), 1)), FEWEST)
    for k in range(ROUNDS):
        poses, centre = drawn_poses(model, about, count, rng)
        width = widths[centre]
        log, some = log_drawn_poses(model, about, poses)
        log_drawn = log_sum(np.where(widths[some][:, None] == width, log, -np.inf))
        base = model.log_prior(poses) - math.log(len(WIDTHS)) - log_drawn
        value = base + _log_odds(model, poses, width, pairs, counted)
        most = value.max(axis=1, keepdims=True)
        if not np.isfinite(most).all():
            return -math.inf, -math.inf
        weights = np.exp(value - most)
        found = most[:, 0] + np.log(weights.mean(axis=1))
        if k == ROUNDS - 1 or found[0] < matters - MARGIN:
            break
        # the largest are cut, as few samples tell little of their weight
        weights = np.minimum(weights, math.sqrt(count) * weights.mean(axis=1, keepdims=True))
        edges = np.cumsum((weights / weights.sum(axis=1, keepdims=True)).mean(axis=0))
        chosen = np.searchsorted(edges, (np.arange(KERNELS) + 0.5) / KERNELS).clip(max=count - 1)
        fits = about.fits.take(centre[chosen])
        fits = fits._replace(poses=poses.take(chosen), covariance=NARROWER**2 * fits.covariance)
        shares = np.concatenate([FITS * first.shares, np.full(KERNELS, (1.0 - FITS) / KERNELS)])
        about = Centres(first.fits.joined(fits), shares, np.zeros(len(shares), np.int64))
        widths = np.concatenate([widths[: len(first.shares)], width[chosen]])
    return float(found[0]), float(found[1])


def _wider(centres: Centres) -> tuple[Centres, Floats]:
    """The centres for each of the widths, and the width of each."""
    rows = np.tile(np.arange(len(centres.shares)), len(WIDTHS))
    widths = np.repeat(WIDTHS, len(centres.shares))
    fits = centres.fits.take(rows)
    precision = np.linalg.inv(centres.fits.covariance)[rows] / widths[:, None, None] ** 2
    covariance = np.linalg.inv(precision + np.eye(precision.shape[1]) / OPEN**2)
    return Centres(fits._replace(covariance=covariance), centres.shares[rows] / len(WIDTHS), rows), widths


def _log_odds(
    model: TwoViewModel, poses: Relative, widths: Floats, pairs: tuple[Integers, Integers], counted: Floats
) -> Floats:
    """Logarithms (C, K) of the odds of detections against clutter, for any share of those that are alike.

    ``counted`` (C, n'): how much each counts.
    """
    odds = np.exp(model.log_odds(poses, widths**2, np.zeros(len(widths)), pairs))
    order = np.argsort(pairs[1], kind="stable")
    columns = pairs[1][order]
    first = np.flatnonzero(np.diff(columns, prepend=-1))
    ratio = np.zeros((len(widths), model.shape[1]))
    ratio[:, columns[first]] = np.add.reduceat(odds[:, order], first, axis=1) / model.shape[0]
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    share = 0.5 * (1.0 + nodes)
    log = np.stack([counted @ np.log(1.0 + a * (ratio.T - 1.0)) for a in share])
    return log_sum(log + np.log(0.5 * weights)[:, None, None])
