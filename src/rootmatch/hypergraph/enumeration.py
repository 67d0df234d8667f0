"""Enumeration of hyper-edges: all of them, or a seeded random stream as in the paper; always in blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import chain, combinations

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.hypergraph.random_tuples import distinct_tuples

STREAM_BLOCK = 8192
"""Tuples drawn at once from the stream; fixed, so that the stream does not depend on how it is read."""


def exhaustive_count(n: int, n_target: int, order: int) -> int:
    """Number of hyper-edges, unordered in the source, ordered in the target: C(n, d) · n'! / (n' − d)!."""
    return math.comb(n, order) * math.perm(n_target, order)


def estimated_count(n: int, n_target: int, order: int, mask: NDArray[np.bool_] | None) -> float:
    """Approximate number of hyper-edges of an exhaustive search; exact without candidates."""
    count = float(exhaustive_count(n, n_target, order))
    return count if mask is None else count * float(mask.mean()) ** order


KEPT_SUBSETS = 16_384
"""Subsets, or arrangements, up to which they are kept for the next frame: 400 kB of triples."""


def subsets(n: int, size: int) -> NDArray[np.int64]:
    """All subsets (C(n, size), size) of the indices below n, ascending, in lexicographic order."""
    return _kept_subsets(n, size).copy() if math.comb(n, size) <= KEPT_SUBSETS else _subsets(n, size)


@lru_cache(maxsize=16)
def _kept_subsets(n: int, size: int) -> NDArray[np.int64]:
    return _subsets(n, size)


def _subsets(n: int, size: int) -> NDArray[np.int64]:
    every = chain.from_iterable(combinations(range(n), size))
    return np.fromiter(every, np.int64, math.comb(n, size) * size).reshape(-1, size)


def source_bases(n: int, order: int) -> NDArray[np.int64]:
    """Minimal sets (B, d − 1) of source points, increasing, that leave at least one later point to complete them."""
    return subsets(n - 1, order - 1)


def target_arrangements(n_target: int, length: int) -> NDArray[np.int32]:
    """All ordered choices (P, length) of target points without repetition, in lexicographic order."""
    if n_target**length <= KEPT_SUBSETS:
        return _kept_arrangements(n_target, length).copy()
    return _arrangements(n_target, length)


@lru_cache(maxsize=64)
def _kept_arrangements(n_target: int, length: int) -> NDArray[np.int32]:
    return _arrangements(n_target, length)


def _arrangements(n_target: int, length: int) -> NDArray[np.int32]:
    grid = np.indices((n_target,) * length, dtype=np.int32).reshape(length, -1)
    distinct = np.ones(grid.shape[1], dtype=bool)
    for first, second in combinations(range(length), 2):
        distinct &= grid[first] != grid[second]
    return np.ascontiguousarray(grid[:, distinct].T)


def wide_first(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order of points (n, k), each the farthest from all before it; the first is the farthest from the mean.

    The first points of a hyper-edge are its minimal set: solved from points far apart, it predicts best.
    """
    from rootmatch.hypergraph.farthest_first import farthest_first  # takes Numba

    order = np.empty(len(points), dtype=np.int64)
    distance = ((points - points.sum(axis=0) / len(points)) ** 2).sum(axis=1)
    farthest_first(np.ascontiguousarray(points, np.float64), int(distance.argmax()), order)
    return order


def random_hyperedges(
    n: int,
    n_target: int,
    order: int,
    count: int,
    seed: int,
    block: int = 65536,
    mask: NDArray[np.bool_] | None = None,
) -> Iterator[tuple[NDArray[np.int32], NDArray[np.int32]]]:
    """Uniformly random hyper-edges from one seeded stream (paper, section "Overall Algorithm", step 3a).

    The stream depends on the seed, the sizes and the mask alone: its first s hyper-edges are the same whatever
    ``count`` ≥ s and ``block`` are, so the tensors H_s of growing samples are nested.

    Parameters
    ----------
    n, n_target, order : int
        Source points, target points, correspondences of a hyper-edge.
    count : int
        How many to draw; with a mask, how many that the mask allows.
    seed : int
    block : int
        Most hyper-edges in one yield.
    mask : (n, n') bool array, optional
        Candidate correspondences; tuples with any other are passed over.

    Yields
    ------
    source_index, target_index : (B, order) int32 arrays

    Raises
    ------
    InputError
        If there are fewer points than the order, or the mask allows next to none of the tuples.
    """
    if min(n, n_target) < order:
        raise InputError(f"hyper-edges: {n} source and {n_target} target points given, at least {order} of each needed")
    if count < 1 or block < 1:
        raise InputError(f"hyper-edges: {count} samples in blocks of {block} given; give positive numbers")
    rng = np.random.default_rng(seed)
    pending: list[tuple[NDArray[np.int32], NDArray[np.int32]]] = []
    waiting = given = tried = accepted = 0
    while given < count:
        while waiting < min(block, count - given):
            source = distinct_tuples(rng, STREAM_BLOCK, n, order, np.int32)
            target = distinct_tuples(rng, STREAM_BLOCK, n_target, order, np.int32)
            tried += STREAM_BLOCK
            if mask is not None:
                allowed = mask[source, target].all(axis=1)
                source, target = source[allowed], target[allowed]
            accepted += len(source)
            if tried >= 1000 * STREAM_BLOCK and accepted < 1e-5 * tried:
                raise InputError(
                    "hyper-edges: the candidate mask allows fewer than 1 in 100,000 random tuples; "
                    'use sampler="exhaustive", which walks the mask'
                )
            if len(source):
                pending.append((source, target))
                waiting += len(source)
        sources = np.concatenate([pair[0] for pair in pending])
        targets = np.concatenate([pair[1] for pair in pending])
        take = min(block, count - given)
        yield sources[:take], targets[:take]
        given += take
        pending = [(sources[take:], targets[take:])]
        waiting = len(sources) - take
