"""Which hyper-edges contain given d−1 correspondences: the index that makes a discrete ascent cheap.

Each hyper-edge has d subsets of d−1 correspondences. The hash of a subset is the sum of fixed random 64-bit numbers of
its correspondences, so that neither order nor sorting matters. Its upper bits name a bucket; buckets are stored one
after the other (compressed rows). An entry is the number of the hyper-edge, and above it as many further bits of the
hash as the 32 bits leave over (9 for 8 million hyper-edges): other entries of a bucket are passed over without
a look at the hyper-edge itself. What passes is compared in full: collisions cost time and never change an answer.

Memory beside the tensor: 4 d + (2 d to 4 d) bytes a hyper-edge, 24 to 32 at order 4; 8 d more while it is built.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.kernels.contraction import CHUNK, threads_for
from rootmatch.tensor import AffinityTensor

PART_BITS = 17
"""2^17 buckets are sorted at a time: their counters, half a megabyte, stay in the cache of one core."""

LONG = 8
"""Buckets with more entries are sorted, so that those of one subset lie together."""


class SubsetIndex(NamedTuple):
    """A tensor and its subsets, as jitted code takes them."""

    indices: NDArray[np.int32]  # (E, d)
    weights: NDArray[np.float64]  # (E,)
    unary: NDArray[np.float64]  # (n n',), zeros where the tensor has none
    marginals: NDArray[np.float64]  # (n n',): the most that a correspondence can gain from hyper-edges
    keys: NDArray[np.uint64]  # (n n',) random numbers
    start: NDArray[np.uint32]  # (buckets + 1,)
    entries: NDArray[np.uint32]  # (d E,): hash bits above, hyper-edge below; ascending in a long bucket
    bucket_shift: int
    tag_shift: int
    edge_bits: int
    n: int
    n_target: int


def build_index(tensor: AffinityTensor, bucket_bits: int | None = None) -> SubsetIndex:
    """Index of the (d−1)-subsets of a tensor's hyper-edges.

    Parameters
    ----------
    tensor : AffinityTensor
    bucket_bits : int, optional
        2^bucket_bits buckets; by default such that a bucket holds one to two entries.

    Raises
    ------
    InputError
        If there are more subsets than 32 bits can count.
    """
    count = tensor.size * tensor.order
    if count >= 2**32 or tensor.size >= 2**31:
        raise InputError(
            f"{tensor.size} hyper-edges of order {tensor.order} are more than the index holds (2³² subsets): "
            "keep the strongest only (max_hyperedges)"
        )
    bits = max(1, (count // 2).bit_length()) if bucket_bits is None else bucket_bits
    edge_bits = max(1, (tensor.size - 1).bit_length())
    tag_bits = min(32 - edge_bits, 64 - bits)
    keys = _random_keys(tensor.shape[0] * tensor.shape[1])
    shifts = (64 - bits, 64 - bits - tag_bits)
    if bits <= PART_BITS + 2:
        start, entries = _sort_at_once(tensor.indices, keys, bits, *shifts, edge_bits)
    else:
        with threads_for(tensor.size // CHUNK):
            chunks = numba.get_num_threads()
            start, entries = _sort_by_parts(tensor.indices, keys, bits, *shifts, edge_bits, chunks)
    unary = np.zeros(keys.size) if tensor.unary is None else tensor.unary.reshape(-1)
    marginals = tensor.marginals().reshape(-1)
    return SubsetIndex(
        tensor.indices, tensor.weights, unary, marginals, keys, start, entries, *shifts, edge_bits, *tensor.shape
    )


def _random_keys(count: int) -> NDArray[np.uint64]:
    """Fixed numbers without pattern (the output function of SplitMix64; Steele, Lea and Flood 2014)."""
    z = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(z ^ (z >> np.uint64(31)))


@njit(cache=True)
def _subset_hashes(indices, keys, e, out):  # type: ignore[no-untyped-def]
    """Hashes of the d subsets of a hyper-edge: the sum of all keys less one."""
    total = np.uint64(0)
    for p in range(out.size):
        total += keys[indices[e, p]]
    for p in range(out.size):
        out[p] = total - keys[indices[e, p]]


@njit(cache=True)
def _sort_at_once(  # type: ignore[no-untyped-def]
    indices, keys, bits, bucket_shift, tag_shift, edge_bits
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Counting sort of the subsets of a small tensor."""
    edges, order = indices.shape
    down, tag_down, up = np.uint64(bucket_shift), np.uint64(tag_shift), np.uint64(edge_bits)
    tag_mask = np.uint64((1 << (bucket_shift - tag_shift)) - 1)
    hashes = np.empty(order, np.uint64)
    # Counted two ahead, so that filling moves each to where the next bucket starts.
    start = np.zeros((1 << bits) + 2, np.uint32)
    for e in range(edges):
        _subset_hashes(indices, keys, e, hashes)
        for p in range(order):
            start[np.int64(hashes[p] >> down) + 2] += np.uint32(1)
    for bucket in range(2, start.size):
        start[bucket] += start[bucket - 1]
    entries = np.empty(edges * order, np.uint32)
    for e in range(edges):
        _subset_hashes(indices, keys, e, hashes)
        for p in range(order):
            tag = (hashes[p] >> tag_down) & tag_mask
            place = np.int64(hashes[p] >> down) + 1
            entries[start[place]] = np.uint32((tag << up) | np.uint64(e))
            start[place] += np.uint32(1)
    for bucket in range(1 << bits):
        _sort_long(entries, int(start[bucket]), int(start[bucket + 1]))
    return start[: start.size - 1], entries


@njit(cache=True, parallel=True)
def _sort_by_parts(  # type: ignore[no-untyped-def]
    indices, keys, bits, bucket_shift, tag_shift, edge_bits, chunks
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Counting sort of all subsets, first into parts by the upper bits of the bucket and then within each part.

    Counters of a part stay in the cache, whereas those of all buckets would not; and threads never meet.
    """
    edges, order = indices.shape
    parts, local = 1 << (bits - PART_BITS), 1 << PART_BITS
    down, tag_down = np.uint64(bucket_shift), np.uint64(tag_shift)
    tag_mask = np.uint64((1 << (bucket_shift - tag_shift)) - 1)
    up, part_down, half = np.uint64(edge_bits), np.uint64(PART_BITS), np.uint64(32)

    place = np.zeros((chunks, parts), np.int64)
    for chunk in prange(chunks):
        hashes = np.empty(order, np.uint64)
        for e in range(chunk * edges // chunks, (chunk + 1) * edges // chunks):
            _subset_hashes(indices, keys, e, hashes)
            for p in range(order):
                place[chunk, np.int64((hashes[p] >> down) >> part_down)] += 1
    first = np.zeros(parts + 1, np.int64)
    total = 0
    for part in range(parts):
        first[part] = total
        for chunk in range(chunks):
            count = place[chunk, part]
            place[chunk, part] = total
            total += count
    first[parts] = total

    # Bucket and entry side by side.
    moved = np.empty(edges * order, np.uint64)
    for chunk in prange(chunks):
        hashes = np.empty(order, np.uint64)
        for e in range(chunk * edges // chunks, (chunk + 1) * edges // chunks):
            _subset_hashes(indices, keys, e, hashes)
            for p in range(order):
                bucket = hashes[p] >> down
                tag = (hashes[p] >> tag_down) & tag_mask
                own = np.int64(bucket >> part_down)
                moved[place[chunk, own]] = (bucket << half) | (tag << up) | np.uint64(e)
                place[chunk, own] += 1

    start = np.empty((1 << bits) + 1, np.uint32)
    start[1 << bits] = np.uint32(total)
    entries = np.empty(edges * order, np.uint32)
    for part in prange(parts):
        base = part * local
        ends = np.zeros(local + 1, np.uint32)
        for t in range(first[part], first[part + 1]):
            ends[np.int64(moved[t] >> half) - base + 1] += np.uint32(1)
        ends[0] = np.uint32(first[part])
        for b in range(local):
            start[base + b] = ends[b]
            ends[b + 1] += ends[b]
        for t in range(first[part], first[part + 1]):
            bucket_in_part = np.int64(moved[t] >> half) - base
            entries[ends[bucket_in_part]] = np.uint32(moved[t] & np.uint64(0xFFFFFFFF))
            ends[bucket_in_part] += np.uint32(1)
        # Each end has moved to where the next bucket starts.
        for b in range(local):
            _sort_long(entries, int(start[base + b]), int(ends[b]))
    return start, entries


@njit(cache=True)
def _sort_long(entries, first, last):  # type: ignore[no-untyped-def]
    """Ascending order of a long bucket, by Shell's steps: popular subsets may fill it with thousands."""
    if last - first <= LONG:
        return
    gap = 1
    while 9 * gap < last - first:
        gap = 3 * gap + 1
    while gap > 0:
        for t in range(first + gap, last):
            entry = entries[t]
            s = t
            while s - gap >= first and entries[s - gap] > entry:
                entries[s] = entries[s - gap]
                s -= gap
            entries[s] = entry
        gap //= 3


@njit(cache=True)
def index_support(index: SubsetIndex) -> NDArray[np.float64]:
    """Support of each hyper-edge, (E,), as `AffinityTensor.support` has it, but for rare collisions of hashes."""
    order = index.indices.shape[1]
    support = np.empty(index.weights.size)
    for e in range(support.size):
        support[e] = -order * index.weights[e]
    entries, weights = index.entries, index.weights
    up, mask = np.uint32(index.edge_bits), np.uint32((1 << index.edge_bits) - 1)
    for bucket in range(index.start.size - 1):
        t, last = np.int64(index.start[bucket]), np.int64(index.start[bucket + 1])
        if last - t <= LONG:
            for s in range(t, last):
                total, own = 0.0, entries[s] >> up
                for r in range(t, last):
                    # A choice of values, not of ways: nobody could predict it.
                    h = weights[entries[r] & mask]
                    total += h if entries[r] >> up == own else 0.0
                support[entries[s] & mask] += total
            continue
        while t < last:
            tag, first, total = entries[t] >> up, t, 0.0
            while t < last and entries[t] >> up == tag:
                total += weights[entries[t] & mask]
                t += 1
            for s in range(first, t):
                support[entries[s] & mask] += total
    return support
