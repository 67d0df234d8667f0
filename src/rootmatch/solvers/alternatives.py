"""Alternatives to the assignment of a solver: its best one-change neighbours, exactly scored."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.assignment import one_hot
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function
from rootmatch.solvers.base import Alternatives


def best_neighbours(tensor: AffinityTensor, assignment: NDArray[np.int64], keep: int) -> Alternatives:
    """The best `keep` assignments that differ by one change, best first.

    A change moves a point to a free target, gives its target to an unmatched point, or exchanges two points' targets.
    Exactly scored, from one contraction v at the assignment and one pass for pairs: with P the weight of the
    hyper-edges inside that contain both points, and Q of those that an exchange would bring, an exchange changes the
    score by Σ v_new − Σ v_old + P + Q.
    """
    n, n_target = tensor.shape
    if keep == 0 or not (assignment >= 0).any():
        return []
    x, maximum = one_hot(assignment, n_target), min(keep, n * (n + n_target))
    v, own, images, changes = tensor.contract(x), np.empty(n), np.empty((maximum, n), np.int64), np.empty(maximum)
    scratch = np.ones(n_target, np.bool_), np.empty(maximum, np.int64), np.zeros((n, n))
    count = _best_changes(tensor.indices, tensor.weights, assignment, v, own, images, changes, *scratch)
    if tensor.unary is not None:
        own += (tensor.order - 1) * (tensor.unary * x).sum(axis=1)
    score = float(own.sum()) / tensor.order
    return list(zip(images[:count], (score + changes[:count]).tolist(), strict=True))


@driver(nogil=True)
def _best_changes(indices, weights, image, v, own, images, changes, free, moves, pairs):  # type: ignore[no-untyped-def]
    """Fill in the best one-change neighbours (K, n), best first, and how each changes the score; their number.

    Among equals moves come before exchanges, in the order of their points. ``v`` (n, n') is the contraction; ``own``
    (n,) becomes the part of each matched point in it. The rest is scratch: ``free`` (n',), true at first, ``moves``
    (K,), and ``pairs`` (n, n), zero at first.
    """
    n, n_target = v.shape
    count = 0
    for i in range(n):
        own[i] = 0.0
        if image[i] >= 0:
            own[i] = v[i, image[i]]
            free[image[i]] = False
    for i in range(n):
        for k in range(n_target):
            if image[i] >= 0 and free[k]:
                count = _enter_move(changes, moves, count, v[i, k] - own[i], i * n_target + k)
    _add_pair_weights(indices, weights, image, n_target, pairs)
    for i in range(n):
        for j in range(n):
            if image[i] >= 0 and (image[j] < 0 or j > i):
                change = v[j, image[i]]
                if image[j] >= 0:
                    change += v[i, image[j]]
                change = change - own[i] - own[j] + pairs[i, j]
                count = _enter_move(changes, moves, count, change, n * n_target + i * n + j)
    for place in range(count):
        for i in range(n):
            images[place, i] = image[i]
        i, k = moves[place] // n_target, moves[place] % n_target
        if i < n:
            images[place, i] = k
        else:
            i, j = (moves[place] - n * n_target) // n, (moves[place] - n * n_target) % n
            images[place, i], images[place, j] = image[j], image[i]
    return count


@internal_function()
def _enter_move(changes, moves, count, change, move):  # type: ignore[no-untyped-def]
    """Put a move in its place among the best so far, behind its equals; their number with it."""
    keep = changes.size
    if count == keep and not change > changes[keep - 1]:
        return count
    place = min(count, keep - 1)
    while place > 0 and changes[place - 1] < change:
        changes[place], moves[place] = changes[place - 1], moves[place - 1]
        place -= 1
    changes[place], moves[place] = change, move
    return min(count + 1, keep)


@internal_function()
def _add_pair_weights(indices, weights, image, n_target, total):  # type: ignore[no-untyped-def]
    """Add P + Q of each pair of points (n, n): hyper-edges inside with both, and those with their targets exchanged."""
    order = indices.shape[1]
    for e in range(weights.size):
        inside, first, second = 0, -1, -1
        for p in range(order):
            a = indices[e, p]
            if image[a // n_target] == a % n_target:
                inside += 1
            else:
                first, second = second, a
        if inside == order:
            for p in range(order):
                for q in range(order):
                    if p != q:
                        total[indices[e, p] // n_target, indices[e, q] // n_target] += weights[e]
        elif inside == order - 2:
            i, j = first // n_target, second // n_target
            if image[i] == second % n_target and image[j] == first % n_target:
                total[i, j] += weights[e]
                total[j, i] += weights[e]
