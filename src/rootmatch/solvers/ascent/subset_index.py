"""Index of the hyper-edges that contain given d−1 correspondences, on which the discrete ascent runs.

Each hyper-edge has d subsets of d−1 correspondences. The hash of a subset is the sum of fixed random 64-bit numbers of
its correspondences, so that neither order nor sorting matters. Its upper bits name a bucket; buckets are stored one
after the other (compressed rows). An entry is the number of the hyper-edge, and above it as many further bits of the
hash as the 32 bits leave over (9 for 8 million hyper-edges): other entries of a bucket are passed over without
a look-up of the hyper-edge itself. The others are compared in full: collisions cost time and change no result.

A tensor of order 3 with many hyper-edges for its points has a table of all pairs instead (see `pair_table`).

Memory beside the tensor: 4 d + (2 d to 4 d) bytes a hyper-edge, 24 to 32 at order 4; 8 d more while it is built.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.shell_sort import shell_sort
from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError
from rootmatch.hypergraph.contraction import CHUNK as WORTH_A_THREAD
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function
from rootmatch.jit.threads import run_in_threads, worthwhile_threads
from rootmatch.solvers.ascent.pair_table import add_own_weights, is_table_worthwhile, pair_ranks, pair_table

PART_BITS = 17
"""2^17 buckets are sorted at a time: their counters, half a megabyte, stay in the cache of one core."""

CHUNK = 1 << 19
"""Hyper-edges that are counted, or moved to their parts, between two looks for signals: some hundredths of a second."""

KEPT_KEYS = 4096
"""Correspondences up to which their keys are kept for the next problem of as many. A round value."""

FEW, LONG = 4, 32
"""Buckets with more than FEW entries mostly hold one subset; those with more than LONG are sorted to find theirs."""


class SubsetIndex(NamedTuple):
    """A tensor and its subsets, as jitted code takes them."""

    indices: NDArray[np.int32]  # (E, d)
    weights: Floats  # (E,)
    unary: Floats  # (n n',), zeros where the tensor has none
    marginals: Floats  # (n n',): the most that a correspondence can gain from hyper-edges
    source: Integers  # (n n',) point of each correspondence
    keys: NDArray[np.uint64]  # (n n',) random numbers
    start: NDArray[np.uint32]  # (buckets + 1,), or (pairs + 1,) of a table of pairs: the first entry of each
    entries: NDArray[np.uint32]  # (d E,): hash bits above, hyper-edge below; ascending in a long bucket
    paired: bool  # whether there is a table of pairs (see `pair_table`) instead of buckets
    others: NDArray[np.uint16]  # (3 E,) of a table of pairs: what completes each, hyper-edges ascending
    held: Floats  # (3 E,) of a table of pairs: and the weight
    sums: Floats  # (pairs,) of a table of pairs: of the weights
    bucket_shift: int
    tag_shift: int
    edge_bits: int
    n: int
    n_target: int


def build_index(tensor: AffinityTensor, bucket_bits: int | None = None) -> SubsetIndex:
    """Index of the (d−1)-subsets of a tensor's hyper-edges.

    ``bucket_bits``: 2^bucket_bits buckets; by default such that a bucket holds one to two entries, or a table of pairs.
    """
    count = tensor.size * tensor.order
    if count >= 2**32 or tensor.size >= 2**31:
        raise InputError(
            f"{tensor.size} hyper-edges of order {tensor.order} are more than the index holds (2³² subsets): "
            "keep the strongest only (max_hyperedges)"
        )
    size = tensor.shape[0] * tensor.shape[1]
    unary = np.zeros(size) if tensor.unary is None else tensor.unary.reshape(-1)
    source = np.repeat(np.arange(tensor.shape[0]), tensor.shape[1])
    if bucket_bits is None and is_table_worthwhile(tensor.size, tensor.order, size):
        start, others, held, sums, marginals = pair_table(tensor.indices, tensor.weights, size)
        return SubsetIndex(
            tensor.indices, tensor.weights, unary, marginals, source,
            keys=np.empty(0, np.uint64), start=start, entries=np.empty(0, np.uint32), paired=True,
            others=others, held=held, sums=sums, bucket_shift=0, tag_shift=0, edge_bits=0,
            n=tensor.shape[0], n_target=tensor.shape[1],
        )  # fmt: skip
    bits = max(1, (count // 2).bit_length()) if bucket_bits is None else bucket_bits
    edge_bits = max(1, (tensor.size - 1).bit_length())
    tag_bits = min(32 - edge_bits, 64 - bits)
    keys = _kept_keys(size) if size <= KEPT_KEYS else _random_keys(size)
    shifts = (64 - bits, 64 - bits - tag_bits)
    if bits <= PART_BITS + 2:
        start, entries, marginals = _index_at_once(tensor.indices, tensor.weights, keys, bits, *shifts, edge_bits)
    else:
        start, entries = _sort_by_parts(tensor.indices, keys, bits, *shifts, edge_bits)
        marginals = tensor.marginals().reshape(-1)
    return SubsetIndex(
        tensor.indices, tensor.weights, unary, marginals, source,
        keys=keys, start=start, entries=entries, paired=False,
        others=np.empty(0, np.uint16), held=np.empty(0), sums=np.empty(0),
        bucket_shift=shifts[0], tag_shift=shifts[1], edge_bits=edge_bits, n=tensor.shape[0], n_target=tensor.shape[1],
    )  # fmt: skip


def _random_keys(count: int) -> NDArray[np.uint64]:
    """Fixed numbers without pattern (the output function of SplitMix64; Steele, Lea and Flood 2014)."""
    z = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(z ^ (z >> np.uint64(31)))


_kept_keys = lru_cache(maxsize=16)(_random_keys)  # a small problem shares them with the next of its size


@internal_function()
def total_hash(indices, keys, e):  # type: ignore[no-untyped-def]
    """Sum of the keys of a hyper-edge; less one of them it is the hash of a subset."""
    total = np.uint64(0)
    for p in range(indices.shape[1]):
        total += keys[indices[e, p]]
    return total


@driver()
def _index_at_once(  # type: ignore[no-untyped-def]
    indices, weights, keys, bits, bucket_shift, tag_shift, edge_bits
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Counting sort of the subsets of a small tensor, and the weight of the hyper-edges of each correspondence."""
    edges, order = indices.shape
    marginals = np.zeros(keys.size)
    down, tag_down, up = np.uint64(bucket_shift), np.uint64(tag_shift), np.uint64(edge_bits)
    tag_mask = np.uint64((1 << (bucket_shift - tag_shift)) - 1)
    # Counted two ahead, so that filling moves each to where the next bucket starts.
    start = np.zeros((1 << bits) + 2, np.uint32)
    for e in range(edges):
        total = total_hash(indices, keys, e)
        for p in range(order):
            start[np.int64((total - keys[indices[e, p]]) >> down) + 2] += np.uint32(1)
            marginals[indices[e, p]] += weights[e]
    for bucket in range(2, start.size):
        start[bucket] += start[bucket - 1]
    entries = np.empty(edges * order, np.uint32)
    for e in range(edges):
        total = total_hash(indices, keys, e)
        for p in range(order):
            subset = total - keys[indices[e, p]]
            own = np.int64(subset >> down) + 1
            place = start[own]
            entries[place] = np.uint32((((subset >> tag_down) & tag_mask) << up) | np.uint64(e))
            start[own] = place + np.uint32(1)
    for b in range(1 << bits):
        if start[b + 1] - start[b] > LONG:
            shell_sort(entries, int(start[b]), int(start[b + 1]))
    return start[: start.size - 1], entries, marginals


def _sort_by_parts(
    indices: NDArray[np.int32], keys: NDArray[np.uint64], bits: int, bucket_shift: int, tag_shift: int, edge_bits: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Counting sort of all subsets, first into parts by the upper bits of the bucket and then within each part.

    Counters of a part stay in the cache, whereas those of all buckets would not; and threads never meet.
    """
    edges, order = indices.shape
    threads = worthwhile_threads(edges // WORTH_A_THREAD)
    chunks, parts = max(threads, edges // CHUNK), 1 << (bits - PART_BITS)
    bounds = np.array([chunk * edges // chunks for chunk in range(chunks + 1)])
    place = np.zeros((chunks, parts), np.int64)

    def count(first: int, last: int) -> None:
        for chunk in range(first, last):
            _count_parts(indices, keys, bucket_shift, bounds[chunk], bounds[chunk + 1], place[chunk])

    run_in_threads(count, chunks, threads)
    # Part by part, and within each chunk by chunk.
    counts = place.T.flatten()
    before = np.cumsum(counts) - counts
    place[:] = before.reshape(parts, chunks).T
    first_of = np.append(place[0], edges * order)

    # Bucket and entry side by side.
    moved = np.empty(edges * order, np.uint64)

    def move(first: int, last: int) -> None:
        for chunk in range(first, last):
            _move_to_parts(
                indices, keys, bucket_shift, tag_shift, edge_bits, bounds[chunk], bounds[chunk + 1], place[chunk], moved
            )

    run_in_threads(move, chunks, threads)
    start, entries = np.empty((1 << bits) + 1, np.uint32), np.empty(edges * order, np.uint32)
    start[1 << bits] = first_of[-1]
    run_in_threads(lambda first, last: _sort_parts(moved, first_of, first, last, start, entries), parts, threads)
    return start, entries


@driver(nogil=True)
def _count_parts(indices, keys, bucket_shift, first, last, place):  # type: ignore[no-untyped-def]
    """Subsets of hyper-edges first…last−1 in each part."""
    down = np.uint64(bucket_shift + PART_BITS)
    for e in range(first, last):
        total = total_hash(indices, keys, e)
        for p in range(indices.shape[1]):
            place[np.int64((total - keys[indices[e, p]]) >> down)] += 1


@driver(nogil=True)
def _move_to_parts(  # type: ignore[no-untyped-def]
    indices, keys, bucket_shift, tag_shift, edge_bits, first, last, place, moved
):
    """Write the subsets of hyper-edges first…last−1 to where the place of their part is, which moves on."""
    down, tag_down, up = np.uint64(bucket_shift), np.uint64(tag_shift), np.uint64(edge_bits)
    tag_mask = np.uint64((1 << (bucket_shift - tag_shift)) - 1)
    part_down, half = np.uint64(PART_BITS), np.uint64(32)
    for e in range(first, last):
        total = total_hash(indices, keys, e)
        for p in range(indices.shape[1]):
            subset = total - keys[indices[e, p]]
            bucket = subset >> down
            tag = (subset >> tag_down) & tag_mask
            to = np.int64(bucket >> part_down)
            moved[place[to]] = (bucket << half) | (tag << up) | np.uint64(e)
            place[to] += 1


@driver(nogil=True)
def _sort_parts(moved, first_of, first, last, start, entries):  # type: ignore[no-untyped-def]
    """Counting sort of the parts first…last−1 by bucket."""
    local, half = 1 << PART_BITS, np.uint64(32)
    ends = np.zeros(local + 1, np.uint32)
    for part in range(first, last):
        base = part * local
        ends[:] = 0
        for t in range(first_of[part], first_of[part + 1]):
            ends[np.int64(moved[t] >> half) - base + 1] += np.uint32(1)
        ends[0] = np.uint32(first_of[part])
        for b in range(local):
            start[base + b] = ends[b]
            ends[b + 1] += ends[b]
        for t in range(first_of[part], first_of[part + 1]):
            bucket_in_part = np.int64(moved[t] >> half) - base
            entries[ends[bucket_in_part]] = np.uint32(moved[t] & np.uint64(0xFFFFFFFF))
            ends[bucket_in_part] += np.uint32(1)
        # Each end has moved to where the next bucket starts.
        for b in range(local):
            if ends[b] - start[base + b] > LONG:
                shell_sort(entries, int(start[base + b]), int(ends[b]))


def ranked_hyperedges(index: SubsetIndex) -> tuple[Floats, Integers]:
    """Rank of each hyper-edge, (E,), and the best one of each correspondence, (n n',), −1 for none.

    The rank is the weight with its support, the weights of all other hyper-edges that have d−1 correspondences in
    common with it, as `AffinityTensor.support` has it, but for rare collisions of hashes.
    """
    rank, best = np.empty(index.weights.size), np.full(index.unary.size, -1)
    if index.paired:
        pair_ranks(index.indices, index.weights, index.sums, rank, best)
    else:
        _hashed_ranks(index, rank, best)
    return rank, best


@driver()
def _hashed_ranks(index, support, best):  # type: ignore[no-untyped-def]
    """Sums over the entries of each bucket that have the same bits of the hash, to which own weights are added."""
    order = index.indices.shape[1]
    for e in range(support.size):
        support[e] = -order * index.weights[e]
    entries, weights = index.entries, index.weights
    up, mask = np.uint32(index.edge_bits), np.uint32((1 << index.edge_bits) - 1)
    for bucket in range(index.start.size - 1):
        t, last = np.int64(index.start[bucket]), np.int64(index.start[bucket + 1])
        total, single = 0.0, last - t > FEW
        if single:
            # Most buckets of this length hold one subset only.
            for s in range(t, last):
                total += weights[entries[s] & mask]
                single = single and entries[s] >> up == entries[t] >> up
        if single:
            for s in range(t, last):
                support[entries[s] & mask] += total
            continue
        if last - t <= LONG:
            for s in range(t, last):
                total = 0.0
                for r in range(t, last):
                    # A conditional value, not a branch, which no processor could predict.
                    h = weights[entries[r] & mask]
                    total += h if entries[r] >> up == entries[s] >> up else 0.0
                support[entries[s] & mask] += total
            continue
        while t < last:
            tag, first, total = entries[t] >> up, t, 0.0
            while t < last and entries[t] >> up == tag:
                total += weights[entries[t] & mask]
                t += 1
            for s in range(first, t):
                support[entries[s] & mask] += total
    add_own_weights(index.indices, weights, support, best)
