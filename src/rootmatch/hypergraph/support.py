"""Which points of an answer the others support: for many answers of one tensor in one pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.contraction import inside


def supported_answers(
    indices: NDArray[np.int32],
    weights: NDArray[np.float64],
    unary: NDArray[np.float64] | None,
    n_target: int,
    answers: NDArray[np.int64],
    fraction: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Answers without the points that the others do not support, and their scores.

    As `rootmatch.hypergraph.assignment.drop_unsupported` and `AffinityTensor.score`, for all answers side by side; the
    hyper-edges inside an answer are found once, and only they are looked at again.

    Parameters
    ----------
    indices : (E, d) int32 array
    weights : (E,) array
    unary : (n, n') array, optional
    n_target : int
    answers : (K, n) int64 array
    fraction : float
        Part of the median gain of the matched points below which a point is left out.

    Returns
    -------
    kept : (K, n) int64 array
    scores : (K,) array
    """
    count, n = answers.shape
    kept = answers.copy()
    chosen = np.zeros((count, n, n_target), np.bool_)
    a, i = np.nonzero(kept >= 0)
    chosen[a, i, kept[a, i]] = True
    which, edges = inside(indices, chosen.reshape(count, -1))
    held = weights[edges]
    # Places in `kept` of the points of each hyper-edge inside.
    places = which[:, None] * n + indices[edges] // n_target
    prior = np.zeros((count, n))
    if unary is not None:
        prior[a, i] = unary[i, kept[a, i]]
    while True:
        matched = kept >= 0
        prior[~matched] = 0.0
        within = matched.ravel()[places].all(axis=1)
        which, held, places = which[within], held[within], places[within]
        scores = prior.sum(axis=1) + np.bincount(which, held, count)
        gains = prior + np.bincount(places.ravel(), np.repeat(held, places.shape[1]), count * n).reshape(count, n)
        ordered = np.sort(np.where(matched, gains, np.inf), axis=1)
        size, every = matched.sum(axis=1), np.arange(count)
        median = np.where(size > 0, 0.5 * (ordered[every, (size - 1) // 2] + ordered[every, size // 2 % n]), 0.0)
        weak = matched & ((gains < fraction * median[:, None]) | (gains <= 0.0))
        if not weak.any():
            return kept, scores
        kept[weak] = -1


def scores_of(
    indices: NDArray[np.int32],
    weights: NDArray[np.float64],
    unary: NDArray[np.float64] | None,
    answers: NDArray[np.int64],
    n_target: int,
) -> NDArray[np.float64]:
    """Scores (K,) of answers (K, n), as `AffinityTensor.score`, in one call."""
    count, n = answers.shape
    chosen = np.zeros((count, n, n_target), np.bool_)
    a, i = np.nonzero(answers >= 0)
    chosen[a, i, answers[a, i]] = True
    which, edges = inside(indices, chosen.reshape(count, -1))
    # of no hyper-edges at all the counts are integers, whatever the weights
    scores = np.bincount(which, weights[edges], count).astype(np.float64)
    if unary is not None:
        scores += np.bincount(a, unary[i, answers[a, i]], count)
    return np.asarray(scores)
