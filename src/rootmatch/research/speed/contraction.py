"""Contraction of a tensor, timed against its NumPy version."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.hypergraph.random_tuples import permuted_tuples
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.threads import use_one_thread
from rootmatch.research.speed.timing import seconds

BLOCK = 500_000


def random_pairs(rng: np.random.Generator, n: int, n_target: int, order: int, count: int) -> NDArray[np.int32]:
    """Random hyper-edges as flat indices, drawn in blocks to bound the memory."""
    blocks = []
    for first in range(0, count, BLOCK):
        size = min(BLOCK, count - first)
        source = permuted_tuples(rng, size, n, order)
        target = permuted_tuples(rng, size, n_target, order)
        blocks.append((source * n_target + target).astype(np.int32))
    return np.concatenate(blocks)


def planted_tensor(seed: int, n: int, n_target: int, order: int, count: int) -> tuple[AffinityTensor, Integers]:
    """Tensor of ``count`` hyper-edges, including all of the true assignment (n,)."""
    rng = np.random.default_rng(seed)
    truth = rng.permutation(n_target)[:n]
    source = np.array(list(itertools.combinations(range(n), order)))
    true = (source * n_target + truth[source]).astype(np.int32)
    false = random_pairs(rng, n, n_target, order, count - len(true))
    weights = np.exp(-np.concatenate([rng.chisquare(2, len(true)), rng.uniform(0, 12, len(false))]) / 2)
    mixed = rng.permutation(count)
    return AffinityTensor(np.concatenate([true, false])[mixed], weights[mixed], (n, n_target)), truth


def contract_by_add_at(tensor: AffinityTensor, x: Floats) -> Floats:
    """The contraction as one would write it in NumPy, with ``np.add.at``."""
    v, values = np.zeros(x.size), x.ravel()[tensor.indices]
    for p in range(tensor.order):
        np.add.at(v, tensor.indices[:, p], tensor.weights * np.delete(values, p, axis=1).prod(axis=1))
    return v.reshape(x.shape)


def measure_contraction(hyperedges: int, n: int, repeats: int) -> dict[str, float]:
    """Contract a planted tensor of order 3 with n = n', on one thread and on all."""
    tensor, _ = planted_tensor(0, n, n, 3, hyperedges)
    x = np.random.default_rng(0).random(tensor.shape)
    np.testing.assert_allclose(tensor.contract(x), contract_by_add_at(tensor, x), rtol=1e-9)
    on_all = seconds(lambda: tensor.contract(x), repeats)
    with use_one_thread():
        on_one = seconds(lambda: tensor.contract(x), repeats)
    numpy = seconds(lambda: contract_by_add_at(tensor, x), repeats)
    return {
        "hyperedges": float(tensor.size),
        "milliseconds_one_thread": 1e3 * on_one,
        "milliseconds": 1e3 * on_all,
        "milliseconds_add_at": 1e3 * numpy,
        "ratio_one_thread": numpy / on_one,
        "ratio": numpy / on_all,
    }
