"""Slow, obvious re-statements of what the tensor and the solvers compute; nothing here calls the package."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray


def dense_tensor(indices: NDArray, weights: NDArray, size: int) -> NDArray:
    """Full symmetric array: every order of the correspondences of each hyper-edge gets its weight."""
    order = indices.shape[1]
    dense = np.zeros((size,) * order)
    for edge, weight in zip(indices, weights, strict=True):
        for entry in itertools.permutations(edge):
            dense[entry] += weight
    return dense


def dense_contraction(dense: NDArray, x: NDArray) -> NDArray:
    """H x … x with all axes but the first contracted; the full tensor holds (d−1)! copies of each product."""
    letters = "abcdef"[: dense.ndim]
    flat = [x.ravel()] * (dense.ndim - 1)
    out = np.einsum(f"{letters},{','.join(letters[1:])}->a", dense, *flat)
    return (out / math.factorial(dense.ndim - 1)).reshape(x.shape)


def naive_score(indices: NDArray, weights: NDArray, assignment: NDArray, n_target: int) -> float:
    chosen = {i * n_target + k for i, k in enumerate(assignment) if k >= 0}
    return sum(float(h) for edge, h in zip(indices, weights, strict=True) if set(edge.tolist()) <= chosen)


def naive_support(indices: NDArray, weights: NDArray) -> NDArray:
    order = indices.shape[1]
    sets = [set(edge.tolist()) for edge in indices]
    return np.array(
        [
            sum(
                h * math.comb(len(a & b), order - 1)
                for f, (b, h) in enumerate(zip(sets, weights, strict=True))
                if f != e
            )
            for e, a in enumerate(sets)
        ]
    )


def assignments(n: int, n_target: int, partial: bool = True):
    """All one-to-one assignments, those with unmatched points (−1) among them."""
    choices = [-1, *range(n_target)] if partial else list(range(n_target))
    for images in itertools.product(choices, repeat=n):
        matched = [k for k in images if k >= 0]
        if len(set(matched)) == len(matched):
            yield np.array(images)


def best_score(
    indices: NDArray, weights: NDArray, shape: tuple[int, int], unary: NDArray | None = None, penalty: float = 0.0
) -> float:
    """The optimum of the discrete objective by trying every assignment."""
    every = np.array(list(assignments(*shape)))
    chosen = np.zeros((len(every), *shape), bool)
    s, i = np.nonzero(every >= 0)
    chosen[s, i, every[s, i]] = True
    chosen = chosen.reshape(len(every), -1)
    value = chosen @ (np.zeros(shape) if unary is None else unary).ravel()
    for edge, h in zip(indices, weights, strict=True):
        value += h * chosen[:, edge].all(axis=1)
    for s, size in enumerate(chosen.sum(axis=1)):
        value[s] -= penalty * math.comb(int(size), indices.shape[1])
    return value.max()


def objective(
    indices: NDArray,
    weights: NDArray,
    assignment: NDArray,
    n_target: int,
    unary: NDArray | None = None,
    penalty: float = 0.0,
) -> float:
    value = naive_score(indices, weights, assignment, n_target)
    if unary is not None:
        value += sum(unary[i, k] for i, k in enumerate(assignment) if k >= 0)
    return value - penalty * math.comb(int(np.sum(assignment >= 0)), indices.shape[1])


def random_edges(rng: np.random.Generator, n: int, n_target: int, order: int, count: int) -> NDArray:
    """Random hyper-edges, distinct source and target points in each."""
    source = np.argsort(rng.random((count, n)), axis=1)[:, :order]
    target = np.argsort(rng.random((count, n_target)), axis=1)[:, :order]
    return (source * n_target + target).astype(np.int32)


def planted(
    seed: int, n: int, n_target: int, order: int, false_edges: int, hidden: int = 0
) -> tuple[NDArray, NDArray, NDArray]:
    """Hyper-edges, weights and true assignment: every true hyper-edge with weight exp(−χ²₂/2), and random false ones.

    `hidden` source points have no image: their truth is −1 and no true hyper-edge has them.
    """
    rng = np.random.default_rng(seed)
    truth = np.full(n, -1)
    if n - hidden <= n_target:
        truth[rng.permutation(n)[: n - hidden]] = rng.permutation(n_target)[: n - hidden]
    else:
        seen = rng.permutation(n)[:n_target]
        truth[seen] = rng.permutation(n_target)
    seen = np.flatnonzero(truth >= 0)
    source = np.array(list(itertools.combinations(seen, order)))
    true = source * n_target + truth[source]
    false = random_edges(rng, n, n_target, order, false_edges)
    weights = np.concatenate([np.exp(-rng.chisquare(2, len(true)) / 2), np.exp(-rng.uniform(0, 12, len(false)) / 2)])
    mixed = rng.permutation(len(weights))
    return np.concatenate([true, false]).astype(np.int32)[mixed], weights[mixed], truth
