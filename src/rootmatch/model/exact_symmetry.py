"""Self-motions: whether a source is exactly symmetric under the exchange of two labellings, or only nearly so.

Objects are made symmetric on purpose. If an exactly symmetric object is measured with noise, χ² of the labellings that
the symmetry exchanges follows one law, whichever is right, and the smaller value is no evidence. So the prior of the
geometry is a mixture: exactly symmetric under the self-motion, or displaced from it by a distance of unknown size.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.arrays import Floats, Integers
from rootmatch.model.point_set_model import student
from rootmatch.model.priors import NOISE_FREEDOM, probability
from rootmatch.problems.points import PointClouds
from rootmatch.samplers.point_sets.motions import fitted_motions

EXACT = 0.5
"""Prior probability that a self-motion is an exact symmetry. A round value."""
FAR = 10.0
"""Root mean square deviation, in σ, beyond which a self-motion is no symmetry. A round value."""
SIZES = 24
"""Steps of the prior of a displacement's size, flat in its logarithm from the noise to the object's own. Not tuned."""
DEPENDENT = 1e-2
"""Variance of a combination of deviations, over the largest, below which it follows from the others. A round value: two
turns by half leave a point where it is, up to the square of noise over size."""


def exactly_symmetric(clouds: PointClouds, first: Integers, second: Integers, mirror: bool = False) -> float:
    """Probability that a motion takes some points of the source exactly onto others, given their measured positions.

    Parameters
    ----------
    clouds : PointClouds
    first, second : (m,) int64 arrays
        The points, and the points whose places they take after the motion.
    mirror : bool
        Whether the motion may be a reflection.
    """
    points, variance = clouds.source, clouds.source_variance
    size = points.shape[1]
    if _fixes_all(points[first[first == second]], float(variance.max()), size - 1 + mirror):
        return 0.0  # two points would be in one place
    motion = fitted_motions(points[None, first], points[None, second], scaled=False, mirror=mirror)
    turn = motion.linear[0]
    moved = points[first] @ turn.T + motion.shift[0]
    deviation = (points[second] - moved).ravel()
    if float(deviation @ deviation) > FAR**2 * len(deviation) * float((variance[first] + variance[second]).max()):
        return 0.0
    # what the deviations are of the points' noise, and of a small change of the motion
    every, place = np.unique(np.concatenate([first, second]), return_inverse=True)
    m = len(first)
    linear = np.zeros((m, size, len(every), size))
    rows = np.arange(m)
    linear[rows, :, place[m:], :] += np.eye(size)
    linear[rows, :, place[:m], :] -= turn
    off = moved - moved.mean(axis=0)
    if size == 3:
        turned = cross_matrix(off)
    else:
        turned = np.stack([-off[:, 1], off[:, 0]], axis=1)[:, :, None]
    change = np.concatenate([turned, np.broadcast_to(np.eye(size), (m, size, size))], axis=2).reshape(m * size, -1)
    basis, values, _ = np.linalg.svd(change, full_matrices=False)
    basis = basis[:, values > 1e-9 * values[0]]
    root = linear.reshape(m * size, -1) * np.repeat(np.sqrt(variance[every]), size)
    root = root - basis @ (basis.T @ root)
    left, scales, _ = np.linalg.svd(root, full_matrices=False)
    free = scales**2 > DEPENDENT * scales[0] ** 2
    if not free.any():
        return EXACT
    chi2 = float(((left[:, free].T @ deviation / scales[free]) ** 2).sum())
    rank = float(free.sum())
    # a displacement of the size τ over the noise makes the deviations 1 + τ² times as large, squared
    largest = max(math.sqrt(float((off**2).sum(axis=1).mean()) / float(scales[0]) ** 2), math.e)
    excess = 1.0 + np.exp(np.linspace(0.0, 2.0 * math.log(largest), SIZES))
    displaced = student(chi2 / excess, np.full(SIZES, rank), NOISE_FREEDOM) - 0.5 * rank * np.log(excess)
    exact = float(student(np.array([chi2]), np.array([rank]), NOISE_FREEDOM)[0])
    odds = exact - (float(np.logaddexp.reduce(displaced)) - math.log(SIZES)) + math.log(EXACT / (1.0 - EXACT))
    return probability(odds)


def _fixes_all(points: Floats, variance: float, rank: int) -> bool:
    """Whether a motion that leaves these points (m, k) where they are leaves all: they span so many dimensions."""
    if len(points) <= rank:
        return False
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(values[rank - 1] > FAR * math.sqrt(variance))
