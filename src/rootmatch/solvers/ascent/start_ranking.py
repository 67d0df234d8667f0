"""Which hyper-edges to start from: those of the highest rank, their weight with their support."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import driver
from rootmatch.jit.threads import run_in_threads, worthwhile_threads
from rootmatch.solvers.ascent.subset_index import SubsetIndex, ranked_hyperedges, total_hash

SHARES = 16
"""Parts in which the heaviest hyper-edges are ranked: between two of them what was read is summed up."""
SAMPLE = 1 << 20
"""Weights by which the heaviest are told from the others."""
WORTH_A_THREAD = 20_000
"""Hyper-edges to rank that are worth a thread: some milliseconds."""


def rank_candidates(index: SubsetIndex, count: int, max_reads: int) -> tuple[NDArray[np.int32], Floats]:
    """Hyper-edges to start from, (P, d), and their ranks, best first: ``count``, and the best of each correspondence.

    All hyper-edges are ranked, or the heaviest ones if there are more entries in the index than may be read.
    """
    if index.paired or index.indices.size <= max_reads:
        rank, best = ranked_hyperedges(index)
        numbers = np.arange(rank.size)
    else:
        numbers, rank = rank_heaviest(index, max_reads)
        best = np.full(index.unary.size, -1)
        _best_of_each(index.indices, numbers, rank, best)
    count = min(count, rank.size)
    highest = np.argpartition(rank, rank.size - count)[rank.size - count :] if count else np.empty(0, np.int64)
    chosen = np.union1d(highest, best[best >= 0])
    chosen = chosen[index.weights[numbers[chosen]] > 0]
    chosen = chosen[np.argsort(-rank[chosen], kind="stable")]
    return index.indices[numbers[chosen]], rank[chosen]


def rank_heaviest(index: SubsetIndex, max_reads: int) -> tuple[Integers, Floats]:
    """Numbers (R,) of the heaviest hyper-edges and their ranks (R,), as `ranked_hyperedges` has them.

    As many as can be ranked by so many entries of the index, about.
    """
    heavy = heaviest(index.weights, max(max_reads // index.indices.shape[1], 1))
    numbers, ranks, reads = [], [], 0
    for share in range(SHARES):
        some = heavy[share::SHARES]
        rank, read = np.empty(len(some)), np.empty(len(some), np.int64)
        run_in_threads(
            partial(_rank_by_lookup, index, some, rank, read),
            len(some),
            worthwhile_threads(len(some) // WORTH_A_THREAD),
        )
        numbers.append(some)
        ranks.append(rank)
        reads += int(read.sum())
        if reads >= max_reads:
            break
    return np.concatenate(numbers), np.concatenate(ranks)


def heaviest(weights: Floats, count: int) -> Integers:
    """Numbers, ascending, of about so many of the heaviest hyper-edges; of equal ones some from everywhere."""
    if count >= weights.size:
        return np.arange(weights.size)
    # Places without a period (Weyl), as neighbours in a tensor often belong together.
    places = (np.arange(min(SAMPLE, weights.size)) * 0.6180339887498949 % 1.0 * weights.size).astype(np.int64)
    sample = weights[places]
    above = min(int(count / weights.size * sample.size), sample.size - 1)
    minimum = np.partition(sample, sample.size - 1 - above)[sample.size - 1 - above]
    heavier, equal = np.flatnonzero(weights > minimum), np.flatnonzero(weights == minimum)
    missing = max(count - len(heavier), 1)
    return np.sort(np.concatenate([heavier, equal[:: -(-len(equal) // missing)]]))


@driver(nogil=True)
def _rank_by_lookup(index, numbers, rank, read, first, last):  # type: ignore[no-untyped-def]
    """Ranks of the hyper-edges numbers[first … last − 1], and how many entries were read for each."""
    index = borrow(index)
    numbers, rank, read = borrow((numbers, rank, read))
    indices, weights, keys, start, entries = index.indices, index.weights, index.keys, index.start, index.entries
    order = indices.shape[1]
    down, tag_down = np.uint64(index.bucket_shift), np.uint64(index.tag_shift)
    tag_mask = np.uint64((1 << (index.bucket_shift - index.tag_shift)) - 1)
    edge_bits, mask = np.uint32(index.edge_bits), np.uint32((1 << index.edge_bits) - 1)
    for r in range(first, last):
        e = numbers[r]
        total = total_hash(indices, keys, e)
        # Each of its d subsets has the hyper-edge itself too.
        found, count = (1 - order) * weights[e], np.int64(0)
        for p in range(order):
            subset = total - keys[indices[e, p]]
            bucket = np.int64(subset >> down)
            tag = np.uint32((subset >> tag_down) & tag_mask)
            begin, end = np.int64(start[bucket]), np.int64(start[bucket + 1])
            for t in range(begin, end):
                found += weights[entries[t] & mask] if entries[t] >> edge_bits == tag else 0.0
            count += end - begin
        rank[r], read[r] = found, count


@driver(nogil=True)
def _best_of_each(indices, numbers, rank, best):  # type: ignore[no-untyped-def]
    """Places, among some hyper-edges, of the best of each correspondence; all of ``best`` is −1 before."""
    for r in range(numbers.size):
        for p in range(indices.shape[1]):
            a = indices[numbers[r], p]
            if best[a] < 0 or rank[r] > rank[best[a]]:
                best[a] = r
