"""Support: unmatching the points of an assignment that its other points do not support.

Many assignments of one tensor are treated in one pass: the hyper-edges inside each are found once, and only they are
visited again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.contraction import inside
from rootmatch.hypergraph.tensor import AffinityTensor


def drop_unsupported(
    tensor: AffinityTensor, assignments: NDArray[np.int64], fraction: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Unmatch the points that the others do not support, and score what is left.

    The gain of a matched point is what it adds to the score: the weights of the hyper-edges inside the assignment that
    contain it, and its unary weight. A point stays matched while its gain is positive and at least `fraction` of the
    median gain of the matched points. Gains shrink as points go, so this is repeated until nothing changes; the median
    is over what is left, so that a few dropped points do not make the rest look good.

    Parameters
    ----------
    tensor : AffinityTensor
    assignments : (K, n) int64 array
        −1 where unmatched.
    fraction : float
        0 keeps every point with any support; 1 would keep the better half only.

    Returns
    -------
    kept : (K, n) int64 array
        The assignments, −1 for points without support.
    scores : (K,) array
        As `AffinityTensor.score`.
    """
    count, n = assignments.shape
    kept = assignments.copy()
    which, edges, a, i = _inside(tensor, kept)
    held = tensor.weights[edges]
    # positions in `kept` of the points of each hyper-edge inside
    points = which[:, None] * n + tensor.indices[edges] // tensor.shape[1]
    prior = np.zeros((count, n))
    if tensor.unary is not None:
        prior[a, i] = tensor.unary[i, kept[a, i]]
    while True:
        matched = kept >= 0
        prior[~matched] = 0.0
        within = matched.ravel()[points].all(axis=1)
        which, held, points = which[within], held[within], points[within]
        scores = prior.sum(axis=1) + np.bincount(which, held, count)
        gains = prior + np.bincount(points.ravel(), np.repeat(held, points.shape[1]), count * n).reshape(count, n)
        ordered = np.sort(np.where(matched, gains, np.inf), axis=1)
        size, every = matched.sum(axis=1), np.arange(count)
        median = np.where(size > 0, 0.5 * (ordered[every, (size - 1) // 2] + ordered[every, size // 2 % n]), 0.0)
        weak = matched & ((gains < fraction * median[:, None]) | (gains <= 0.0))
        if not weak.any():
            return kept, scores
        kept[weak] = -1


def scores_of(tensor: AffinityTensor, assignments: NDArray[np.int64]) -> NDArray[np.float64]:
    """Scores (K,) of assignments (K, n), as `AffinityTensor.score`, in one call."""
    which, edges, a, i = _inside(tensor, assignments)
    # of no hyper-edges at all the counts are integers, whatever the weights
    scores = np.bincount(which, tensor.weights[edges], len(assignments)).astype(np.float64)
    if tensor.unary is not None:
        scores += np.bincount(a, tensor.unary[i, assignments[a, i]], len(assignments))
    return np.asarray(scores)


def _inside(
    tensor: AffinityTensor, assignments: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.intp], NDArray[np.intp]]:
    """Assignment and number of each hyper-edge inside one; assignment and point of each match."""
    a, i = np.nonzero(assignments >= 0)
    chosen = np.zeros((*assignments.shape, tensor.shape[1]), np.bool_)
    chosen[a, i, assignments[a, i]] = True
    return *inside(tensor.indices, chosen.reshape(len(assignments), -1)), a, i
