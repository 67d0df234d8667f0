"""Which hyper-edges contain given d−1 correspondences: the index that makes a discrete ascent cheap.

Each hyper-edge has d subsets of d−1 correspondences. The hash of a subset is the sum of fixed random 64-bit numbers of
its correspondences, so that neither order nor sorting matters. Its upper bits name a bucket; buckets are stored one
after the other (compressed rows). An entry is the number of the hyper-edge, and above it as many further bits of the
hash as the 32 bits leave over (9 for 8 million hyper-edges): other entries of a bucket are passed over without
a look at the hyper-edge itself. What passes is compared in full: collisions cost time and never change an answer.

Memory: 4 d + (d to 2 d) bytes a hyper-edge, 20 to 24 at order 4, beside the tensor.
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


class SubsetIndex(NamedTuple):
    """A tensor and its subsets, as jitted code takes them."""

    indices: NDArray[np.int32]  # (E, d)
    weights: NDArray[np.float64]  # (E,)
    unary: NDArray[np.float64]  # (n n',), zeros where the tensor has none
    marginals: NDArray[np.float64]  # (n n',): the most that a correspondence can gain from hyper-edges
    keys: NDArray[np.uint64]  # (n n',) random numbers
    start: NDArray[np.uint32]  # (buckets + 1,)
    entries: NDArray[np.uint32]  # (d E,): hash bits above, hyper-edge below; ascending in each bucket
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
        2^bucket_bits buckets; by default such that a bucket holds two to four entries.

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
    bits = max(1, (count // 4).bit_length()) if bucket_bits is None else bucket_bits
    edge_bits = max(1, (tensor.size - 1).bit_length())
    tag_bits = min(32 - edge_bits, 64 - bits)
    keys = _random_keys(tensor.shape[0] * tensor.shape[1])
    shifts = (64 - bits, 64 - bits - tag_bits)
    with threads_for(tensor.size // CHUNK):
        ranges = min(numba.get_num_threads(), 1 << bits)
        start, entries = _sort_into_buckets(tensor.indices, keys, bits, *shifts, edge_bits, ranges)
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


@njit(cache=True, parallel=True)
def _sort_into_buckets(  # type: ignore[no-untyped-def]
    indices, keys, bits, bucket_shift, tag_shift, edge_bits, ranges
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Counting sort of all subsets; each thread fills a range of the buckets, so none waits for another."""
    edges, order = indices.shape
    buckets = 1 << bits
    down, tag_down = np.uint64(bucket_shift), np.uint64(tag_shift)
    tag_mask = np.uint64((1 << (bucket_shift - tag_shift)) - 1)
    up = np.uint64(edge_bits)
    # One ahead, so that filling moves each counter to where the next bucket starts.
    start = np.zeros(buckets + 2, np.uint32)
    for part in prange(ranges):
        first, last = np.uint64(part * buckets // ranges), np.uint64((part + 1) * buckets // ranges)
        for e in range(edges):
            total = np.uint64(0)
            for p in range(order):
                total += keys[indices[e, p]]
            for p in range(order):
                bucket = (total - keys[indices[e, p]]) >> down
                if first <= bucket < last:
                    start[np.int64(bucket) + 2] += np.uint32(1)
    for bucket in range(2, buckets + 2):
        start[bucket] += start[bucket - 1]
    entries = np.empty(edges * order, np.uint32)
    for part in prange(ranges):
        first, last = np.uint64(part * buckets // ranges), np.uint64((part + 1) * buckets // ranges)
        for e in range(edges):
            total = np.uint64(0)
            for p in range(order):
                total += keys[indices[e, p]]
            for p in range(order):
                subset = total - keys[indices[e, p]]
                bucket = subset >> down
                if first <= bucket < last:
                    tag = (subset >> tag_down) & tag_mask
                    entries[start[np.int64(bucket) + 1]] = np.uint32((tag << up) | np.uint64(e))
                    start[np.int64(bucket) + 1] += np.uint32(1)
    # Only now: while others fill, the bounds of a range still move.
    for part in prange(ranges):
        for bucket_number in range(part * buckets // ranges, (part + 1) * buckets // ranges):
            _sort_entries(entries, np.int64(start[bucket_number]), np.int64(start[bucket_number + 1]))
    return start[: buckets + 1], entries


@njit(cache=True)
def _sort_entries(entries, first, last):  # type: ignore[no-untyped-def]
    """Ascending order of one bucket, by insertion; Shell's steps first where a popular subset makes it long."""
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
    up, mask = np.uint32(index.edge_bits), np.uint32((1 << index.edge_bits) - 1)
    for bucket in range(index.start.size - 1):
        t, last = np.int64(index.start[bucket]), np.int64(index.start[bucket + 1])
        while t < last:
            # Entries of one subset lie together, having the same tag.
            tag, first, total = index.entries[t] >> up, t, 0.0
            while t < last and index.entries[t] >> up == tag:
                total += index.weights[index.entries[t] & mask]
                t += 1
            for s in range(first, t):
                support[index.entries[s] & mask] += total
    return support
