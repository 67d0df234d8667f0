"""Enumeration of hyper-edges: all of them, or a seeded random stream as in the paper; always in blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import cache_by_values
from rootmatch.deadline import checkpoint
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


def sweep_cost(n: int, n_target: int, order: int, mask: NDArray[np.bool_] | None) -> float:
    """Cost of an exhaustive search, in hyper-edges: each minimal set is looked at, which takes as long as one."""
    count = estimated_count(n, n_target, order, mask)
    if mask is None:
        return count
    points, targets = np.count_nonzero(mask.any(axis=1)), np.count_nonzero(mask.any(axis=0))
    return max(count, float(math.comb(points, order - 1)) * math.perm(targets, order - 1))


LOOKED = 64
"""First targets of arrangements, or first points of subsets, between two looks at the time."""
SECONDS_PER_ENTRY = 4e-9
"""Time that an index of a list of subsets or arrangements takes."""
MAX_BYTES = 3 << 30
"""Memory of such a list, at most. A round value."""
KEPT_POINTS = 1024
"""Points up to which their order is kept for the next frame. A round value."""
KEPT_SUBSETS = 16_384
"""Subsets, or arrangements, up to which they are kept for the next frame: 400 kB of triples."""

MAX_SHUFFLED = 1 << 20
"""Arrangements that are listed for a search in random order; of pairs those of a thousand targets. More than its budget
lets it try for a wave of minimal sets. A round value."""


def subsets(n: int, size: int) -> NDArray[np.int64]:
    """All subsets (C(n, size), size) of the indices below n, ascending, in lexicographic order."""
    return _kept_subsets(n, size).copy() if math.comb(n, size) <= KEPT_SUBSETS else _subsets(n, size)


def _subsets(n: int, size: int) -> NDArray[np.int64]:
    if size == 0:
        return np.empty((1, 0), np.int64)
    _check_room(math.comb(n, size), size, 8)
    after = _subsets(max(n - 1, 0), size - 1)
    every = np.empty((math.comb(n, size), size), np.int64)
    place = 0
    for first in range(n - size + 1):
        if first % LOOKED == 0:
            checkpoint()
        # those of larger numbers come last
        count = math.comb(n - 1 - first, size - 1)
        every[place : place + count, 0] = first
        every[place : place + count, 1:] = after[len(after) - count :] + 1
        place += count
    return every


_kept_subsets = lru_cache(maxsize=16)(_subsets)


def _check_room(count: int, length: int, size: int) -> None:
    """See that a list of rows of so many indices, each of some bytes, has room in memory and the time left."""
    if count * length * size > MAX_BYTES:
        raise InputError(
            f"{count:.3g} sets of {length} points are more than is listed; use fewer points, "
            'sampler="guided" or sampler="random"'
        )
    checkpoint(SECONDS_PER_ENTRY * count * length)


def source_bases(n: int, order: int, usable: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Minimal sets (B, d − 1) of source points, increasing, that leave at least one later point to complete them.

    Of the points that are usable (n,), if that is given.
    """
    if usable is None:
        return subsets(n - 1, order - 1)
    points = np.flatnonzero(usable)
    return points[subsets(max(len(points) - 1, 0), order - 1)]


def target_arrangements(n_target: int, length: int, usable: NDArray[np.bool_] | None = None) -> NDArray[np.int32]:
    """All ordered choices (P, length) of target points without repetition, in lexicographic order.

    Of the points that are usable (n',), if that is given.
    """
    if usable is not None:
        points = np.flatnonzero(usable).astype(np.int32)
        return points[target_arrangements(len(points), length)]
    if n_target**length <= KEPT_SUBSETS:
        return _kept_arrangements(n_target, length).copy()
    return _arrangements(n_target, length)


def _arrangements(n_target: int, length: int) -> NDArray[np.int32]:
    if length == 0:
        return np.empty((1, 0), np.int32)
    _check_room(math.perm(n_target, length), length, 4)
    after = _arrangements(max(n_target - 1, 0), length - 1)
    every = np.empty((n_target, len(after), length), np.int32)
    for first in range(n_target):
        if first % LOOKED == 0:
            checkpoint()
        every[first, :, 0] = first
        every[first, :, 1:] = after + (after >= first)
    return every.reshape(-1, length)


_kept_arrangements = lru_cache(maxsize=64)(_arrangements)


def shuffled_arrangements(rng: np.random.Generator, n_target: int, length: int) -> NDArray[np.int32]:
    """All ordered choices (P, length) of target points in random order, or `MAX_SHUFFLED` random ones of more."""
    if math.perm(n_target, length) <= MAX_SHUFFLED:
        every: NDArray[np.int32] = rng.permutation(target_arrangements(n_target, length))
        return every
    checkpoint()
    return distinct_tuples(rng, MAX_SHUFFLED, n_target, length, np.int32)


def farthest_point_order(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order of points (n, k), each the farthest from all before it; the first is the farthest from the mean.

    The first points of a hyper-edge are its minimal set: solved from points far apart, it predicts best.
    """
    places = np.ascontiguousarray(points, np.float64)
    if len(places) <= KEPT_POINTS:
        return _kept_order(places).copy()
    return _farthest_point_order(places)


@cache_by_values(16)
def _kept_order(places: NDArray[np.float64]) -> NDArray[np.int64]:
    """The order of few points."""
    return _farthest_point_order(places.copy())  # what is read-only is another type to a kernel


def _farthest_point_order(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """See `farthest_point_order`."""
    from rootmatch.hypergraph.farthest_first import farthest_first  # takes Numba
    from rootmatch.jit.threads import run_in_pieces

    order = np.empty(len(points), dtype=np.int64)
    distance = ((points - points.sum(axis=0) / len(points)) ** 2).sum(axis=1)
    order[0] = distance.argmax()
    nearest = np.full(len(points), np.inf)
    run_in_pieces(lambda first, last: farthest_first(points, first, last, order, nearest), len(points))
    return order


def random_hyperedges(
    n: int, n_target: int, order: int, count: int, seed: int, block: int = 65536, mask: NDArray[np.bool_] | None = None
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
