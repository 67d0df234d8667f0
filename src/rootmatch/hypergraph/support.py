"""Support: unmatching the points of an assignment that its other points do not support.

Many assignments of one tensor are treated in one pass: the hyper-edges inside each are found once, and only they are
visited again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.shell_sort import shell_sort
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.decorators import driver


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
    kept = assignments.copy()
    return kept, _score_and_drop(tensor, kept, float(fraction))


def score_assignments(tensor: AffinityTensor, assignments: NDArray[np.int64]) -> NDArray[np.float64]:
    """Scores (K,) of assignments (K, n), as `AffinityTensor.score`, in one call."""
    return _score_and_drop(tensor, np.array(assignments, np.int64), ALL_STAY)


ALL_STAY = -1.0
"""Stands in place of a fraction: no entry of the assignment changes."""


def _score_and_drop(tensor: AffinityTensor, kept: NDArray[np.int64], fraction: float) -> NDArray[np.float64]:
    """Scores of assignments, in which points are unmatched in place."""
    scores, edges = np.zeros(len(kept)), np.empty(len(tensor.indices), np.int64)
    unary = np.empty((0, 0)) if tensor.unary is None else tensor.unary
    _drop(tensor.indices, tensor.weights, unary, tensor.shape[1], fraction, edges, kept, scores)
    return scores


@driver(nogil=True)
def _drop(indices, weights, unary, n_target, fraction, edges, kept, scores):  # type: ignore[no-untyped-def]
    """Unmatch in place, and fill in the scores; ``edges`` (E,) is scratch."""
    n = kept.shape[1]
    gains, matched = np.empty(n), np.empty(n)
    for row in range(kept.shape[0]):
        assignment = kept[row]
        count = indices.shape[0]
        for e in range(count):
            edges[e] = e
        weak = True
        while weak:
            score = 0.0
            for i in range(n):
                gains[i] = unary[i, assignment[i]] if unary.size > 0 and assignment[i] >= 0 else 0.0
                score += gains[i]
            inside = 0
            for place in range(count):
                e = edges[place]
                p = 0
                while p < indices.shape[1] and assignment[indices[e, p] // n_target] == indices[e, p] % n_target:
                    p += 1
                if p == indices.shape[1]:
                    edges[inside] = e
                    inside += 1
                    score += weights[e]
                    for q in range(indices.shape[1]):
                        gains[indices[e, q] // n_target] += weights[e]
            count = inside
            scores[row] = score
            if fraction < 0.0:
                break
            size = 0
            for i in range(n):
                if assignment[i] >= 0:
                    matched[size] = gains[i]
                    size += 1
            weak = False
            if size > 0:
                shell_sort(matched, 0, size)
                median = 0.5 * (matched[(size - 1) // 2] + matched[size // 2])
                for i in range(n):
                    if assignment[i] >= 0 and (gains[i] < fraction * median or gains[i] <= 0.0):
                        assignment[i] = -1
                        weak = True
