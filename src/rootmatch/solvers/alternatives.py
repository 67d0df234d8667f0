"""Alternatives to the assignment of a solver: its best one-change neighbours, exactly scored."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.assignment import one_hot
from rootmatch.hypergraph.neighbourhood import one_change_neighbours
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.decorators import driver
from rootmatch.solvers.base import Alternatives


def best_neighbours(tensor: AffinityTensor, assignment: NDArray[np.int64], keep: int) -> Alternatives:
    """The best `keep` assignments that differ by one change (`one_change_neighbours`), best first.

    Exactly scored, from one contraction v at the assignment and one pass for pairs: with P the weight of the
    hyper-edges inside that contain both points, and Q of those that an exchange would bring, an exchange changes the
    score by Σ v_new − Σ v_old + P + Q.
    """
    n, n_target = tensor.shape
    if keep == 0 or not (assignment >= 0).any():
        return []
    x = one_hot(assignment, n_target)
    v = tensor.contract(x)
    old = np.where(assignment >= 0, v[np.arange(n), assignment], 0.0)
    order = tensor.order
    score = float((old if tensor.unary is None else old + (order - 1) * (tensor.unary * x).sum(axis=1)).sum()) / order

    changes = one_change_neighbours(assignment, n_target)
    i, k, j, l = changes  # noqa: E741
    second = j >= 0
    change = np.where(k >= 0, v[i, k], 0.0)
    change[second] += v[j, l][second]
    change -= old[i]
    change[second] -= old[j][second]
    change[second] += _pair_weights(tensor.indices, tensor.weights, assignment, n_target)[i, j][second]
    chosen = np.argsort(-change, kind="stable")[:keep]
    return list(zip(changes.take(chosen).applied_to(assignment), (score + change[chosen]).tolist(), strict=True))


@driver()
def _pair_weights(indices: NDArray[Any], weights: NDArray[Any], image: NDArray[Any], n_target: int) -> NDArray[Any]:
    """P + Q of each pair of points (n, n): hyper-edges inside with both, and those with their targets exchanged."""
    n, order = image.size, indices.shape[1]
    total = np.zeros((n, n))
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
    return total
