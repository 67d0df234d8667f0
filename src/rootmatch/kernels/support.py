"""Which points of an answer the others support: for many answers of one tensor in one pass."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def _median(values, count):  # type: ignore[no-untyped-def]
    """Median of the first ``count`` values, which are sorted in place (insertion: a few hundred at most)."""
    for p in range(1, count):
        value = values[p]
        q = p - 1
        while q >= 0 and values[q] > value:
            values[q + 1] = values[q]
            q -= 1
        values[q + 1] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


@njit(cache=True)
def supported_answers(indices, weights, unary, n_target, answers, fraction):  # type: ignore[no-untyped-def]
    """Answers without the points that the others do not support, and their scores.

    As `rootmatch.assignment.drop_unsupported` and `AffinityTensor.score`, one answer after the other; here the
    hyper-edges inside an answer are found once, and only they are looked at again.

    Parameters
    ----------
    indices : (E, d) int32 array
    weights : (E,) array
    unary : (n, n') array, or (0, 0) for none
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
    edges, order = indices.shape
    kept = answers.copy()
    scores = np.zeros(count)
    inside = np.empty(edges, np.int64)
    gains = np.empty(n)
    ordered = np.empty(n)
    prior = unary.shape[0] > 0
    for a in range(count):
        answer = kept[a]
        held = 0
        for e in range(edges):
            member = True
            for p in range(order):
                i = indices[e, p] // n_target
                member = member and answer[i] == indices[e, p] - i * n_target
            if member:
                inside[held] = e
                held += 1
        changed = True
        while changed:
            changed = False
            matched = 0
            total = 0.0
            for i in range(n):
                gains[i] = unary[i, answer[i]] if prior and answer[i] >= 0 else 0.0
                total += gains[i]
            left = 0
            for q in range(held):
                e = inside[q]
                member = True
                for p in range(order):
                    member = member and answer[indices[e, p] // n_target] >= 0
                if not member:
                    continue
                inside[left] = e
                left += 1
                total += weights[e]
                for p in range(order):
                    gains[indices[e, p] // n_target] += weights[e]
            held = left
            for i in range(n):
                if answer[i] >= 0:
                    ordered[matched] = gains[i]
                    matched += 1
            scores[a] = total
            if matched > 0:
                floor = fraction * _median(ordered, matched)
                for i in range(n):
                    if answer[i] >= 0 and (gains[i] < floor or gains[i] <= 0.0):
                        answer[i] = -1
                        changed = True
    return kept, scores
