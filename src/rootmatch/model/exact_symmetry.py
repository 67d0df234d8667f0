"""Self-motions: whether a source is exactly symmetric under the exchange of two labellings, or only nearly so.

Objects are made symmetric on purpose. If an exactly symmetric object is measured with noise, χ² of the labellings that
the symmetry exchanges follows one law, whichever is right, and the smaller value is no evidence. So the prior of the
geometry is a mixture: exactly symmetric under the self-motion, or displaced from it by a distance of unknown size.
Copies that are measured one by one are the same: exactly alike, or not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.arrays import Floats, Integers
from rootmatch.model.point_set_model import log_student_factor
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.samplers.point_sets.motions import fit_motions

EXACT = 0.5
"""Prior probability that a self-motion is an exact symmetry. A round value."""
FAR = 10.0
"""Root mean square deviation, in σ, beyond which a self-motion is no symmetry. A round value."""
SIZES = 24
"""Steps of the prior of a displacement's size, flat in its logarithm from the noise to the object's own. Not tuned."""
DEPENDENT = 1e-2
"""Variance of a combination of deviations, over the largest, below which it follows from the others. A round value: two
turns by half leave a point where it is, up to the square of noise over size."""

ODD = 0.2
"""Prior odds of a shape that is exact but for one point, as a landmark, over one that is exact; their square for two,
and so on: a few of many points are nearly symmetric by chance. A round value."""
LIKELY, COUNTS = 4, 5.0
"""Points that are displaced alone or in pairs, those that deviate most, and log-odds behind the best shape up to which
another one counts. Round values."""


class ExactShape(NamedTuple):
    """Points that some motions take exactly onto each other, given their measured positions.

    Attributes
    ----------
    moved : (n, k) float64
        From the measured to the most probable positions, up to a motion of all.
    covariance : (n k, n k) float64
        Of these.
    log_odds : float
        That the motions are exact.
    squared : float
        χ² of the measured positions against exact motions.
    freedom : float
        Its degrees of freedom.
    excess : (SIZES,) float64
        Variances of the deviations, over those of the noise, for displacements of each size.
    of_sizes : (SIZES,) float64
        Logarithm of the probability of each size, if the motions are not exact.
    """

    moved: Floats
    covariance: Floats
    log_odds: float
    squared: float
    freedom: float
    excess: Floats
    of_sizes: Floats


def fit_exact_shape(
    points: Floats, covariance: Floats, motions: Sequence[tuple[Integers, Integers]], mirror: bool = False
) -> ExactShape | None:
    """Measured points under motions that take some of them exactly onto others; None where they hardly do.

    The deviations of the points from their places after the motions are linear in the errors, apart from a small change
    of each motion.

    ``points`` (n, k) have the ``covariance`` (n, k, k); ``motions`` name points (m,), and those whose places they take;
    ``mirror``: whether they may be reflections.
    """
    n, size = points.shape
    variance = np.trace(covariance, axis1=1, axis2=2) / size
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0.0))[:, None]  # of what may be known exactly along some axes
    gram, slope, spread = np.zeros((n * size, n * size)), np.zeros(n * size), 0.0
    for first, second in motions:
        if _is_identity_forced(points[first[first == second]], float(variance.max()), size - 1 + mirror):
            return None  # two points would be in one place
        motion = fit_motions(points[None, first], points[None, second], scaled=False, mirror=mirror)
        turn = motion.linear[0]
        moved = points[first] @ turn.T + motion.shift[0]
        deviation = (points[second] - moved).ravel()
        maximum = float((variance[first] + variance[second]).max())
        if float(deviation @ deviation) > FAR**2 * len(deviation) * maximum:
            return None
        # what the deviations are of the points' noise, and of a small change of the motion
        m, rows = len(first), np.arange(len(first))
        linear = np.zeros((m, size, n, size))
        linear[rows, :, second, :] += root[second]
        linear[rows, :, first, :] -= turn @ root[first]
        off = moved - moved.mean(axis=0)
        if size == 3:
            turned = cross_matrix(off)
        else:
            turned = np.stack([-off[:, 1], off[:, 0]], axis=1)[:, :, None]
        change = np.concatenate([turned, np.broadcast_to(np.eye(size), (m, size, size))], axis=2).reshape(m * size, -1)
        basis, values, _ = np.linalg.svd(change, full_matrices=False)
        basis = basis[:, values > 1e-9 * values[0]]
        each = linear.reshape(m * size, -1)
        each = each - basis @ (basis.T @ each)
        gram += each.T @ each
        slope += each.T @ deviation
        spread += float((off**2).sum(axis=1).mean()) / len(motions)
    scales, axes = np.linalg.eigh(gram)
    free = scales > DEPENDENT * scales[-1]
    scales, axes = scales[free], axes[:, free]
    rank = float(len(scales)) if gram.any() else 0.0
    along = axes.T @ slope
    chi2 = float(((along / scales) ** 2).sum()) if rank else 0.0
    odds, excess, displaced = 0.0, np.ones(SIZES), np.zeros(SIZES)
    if rank:
        largest = max(math.sqrt(spread * len(motions) / float(scales[-1])), math.e)
        excess = 1.0 + np.exp(np.linspace(0.0, 2.0 * math.log(largest), SIZES))
        displaced = log_student_factor(chi2 / excess, np.full(SIZES, rank), NOISE_FREEDOM) - 0.5 * rank * np.log(excess)
        exact = float(log_student_factor(np.array([chi2]), np.array([rank]), NOISE_FREEDOM)[0])
        odds = exact - (float(np.logaddexp.reduce(displaced)) - math.log(SIZES))
    by_noise = np.einsum("iab,ibf->iaf", root, axes.reshape(n, size, -1)).reshape(n * size, -1)
    whole = np.zeros((n, size, n, size))
    whole[np.arange(n), :, np.arange(n)] = covariance
    return ExactShape(
        moved=-(by_noise @ (along / scales)).reshape(n, size),
        covariance=whole.reshape(n * size, -1) - by_noise @ by_noise.T,
        log_odds=odds + math.log(EXACT / (1.0 - EXACT)),
        squared=chi2,
        freedom=rank,
        excess=excess,
        of_sizes=displaced - np.logaddexp.reduce(displaced),
    )


def log_prior_of_outliers(count: int, n: int) -> float:
    """Prior log-odds of a shape of n points that is exact but for so many of them, over one that is exact."""
    return count * math.log(ODD) - math.lgamma(n + 1) + math.lgamma(count + 1) + math.lgamma(n - count + 1)


def leave_points_out(
    points: Floats, covariance: Floats, motions: Sequence[tuple[Integers, Integers]], whole: ExactShape
) -> list[ExactShape]:
    """An exact shape, and those with one or two points displaced from it by a distance of unknown size, if these count.

    ``whole``: the first, of all points and motions, see `fit_exact_shape`.
    """
    n, size = points.shape
    # by how much χ² decreases, to first order, without each of the points
    weight, off = np.linalg.pinv(covariance), whole.moved
    pull = np.einsum("iab,ib->ia", weight, off)
    lost = covariance - whole.covariance.reshape(n, size, n, size)[np.arange(n), :, np.arange(n)]
    gains = np.einsum("ia,iab,ib->i", pull, np.linalg.pinv(weight @ lost @ weight, rcond=1e-6), pull)
    likely = np.argsort(-gains, kind="stable")[:LIKELY].tolist()
    found = [whole]
    for count in (1, 2):
        for some in combinations(likely, count):
            kept = [~(np.isin(first, some) | np.isin(second, some)) for first, second in motions]
            pairs = zip(motions, kept, strict=True)
            left = [(first[which], second[which]) for (first, second), which in pairs if which.sum() > size]
            one = fit_exact_shape(points, covariance, left) if left else None
            if one is None:
                continue
            less, fewer = whole.squared - one.squared, whole.freedom - one.freedom
            squared = np.append(one.squared + less / whole.excess, whole.squared)
            *of_sizes, exact = log_student_factor(squared, np.full(SIZES + 1, whole.freedom), NOISE_FREEDOM)
            odds = np.logaddexp.reduce(of_sizes - 0.5 * fewer * np.log(whole.excess)) - math.log(SIZES) - exact
            found.append(one._replace(log_odds=whole.log_odds + float(odds) + log_prior_of_outliers(count, n)))
    best = max(one.log_odds for one in found)
    return [one for one in found if one.log_odds > best - COUNTS]


def _is_identity_forced(points: Floats, variance: float, rank: int) -> bool:
    """Whether a motion that leaves these points (m, k) where they are leaves all: they span so many dimensions."""
    if len(points) <= rank:
        return False
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(values[rank - 1] > FAR * math.sqrt(variance))
