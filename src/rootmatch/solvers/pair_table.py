"""Order 3: which hyper-edges contain two given correspondences, by a table of all pairs.

A tensor of triples mostly has several hyper-edges for each pair of correspondences that there can be. Then a pair needs
no hash: its rank among all pairs is its place in a table, and what completes it, with its weight, lies there side by
side (compressed rows). Nothing is compared, and an ascent reads memory in order.

Memory beside the tensor: 30 bytes a hyper-edge and 12 a pair.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rootmatch.kernels.inner import inner

SPARSEST = 2
"""Pairs of the table for each that a hyper-edge has, at most."""

LARGEST = 1 << 23
"""Entries of the table, at most: 80 MB, and 200 MB for pairs. Larger tensors take the leaner index.

With so many pairs at most there are fewer than 2^16 correspondences, which is what 16 bits hold."""


def worth_a_table(size: int, order: int, correspondences: int) -> bool:
    """Whether E hyper-edges of some order among n n' correspondences are looked up in a table of pairs."""
    return order == 3 and 3 * size <= LARGEST and pairs_of(correspondences) <= SPARSEST * 3 * size


def pairs_of(correspondences: int) -> int:
    """Pairs of correspondences."""
    return correspondences * (correspondences - 1) // 2


@inner()
def rank(a, b):  # type: ignore[no-untyped-def]
    """Place of a pair among all pairs; a and b are int64, in any order."""
    low, high = min(a, b), max(a, b)
    return ((high * (high - 1)) >> 1) + low


@njit(cache=True, nogil=True)
def _fill(indices, weights, start, others, held, sums, marginals):  # type: ignore[no-untyped-def]
    """Counting sort of the pairs of all hyper-edges (E, 3), into the arrays of a `PairTable`.

    `start` is one longer than there. `start`, `sums` and `marginals` are all 0 at first.
    """
    # Counted two ahead, so that filling moves each to where the next pair starts.
    one = np.uint32(1)
    for e in range(indices.shape[0]):
        a, b, c = np.int64(indices[e, 0]), np.int64(indices[e, 1]), np.int64(indices[e, 2])
        for r in (rank(a, b), rank(a, c), rank(b, c)):
            start[r + 2] += one
    for r in range(2, start.size):
        start[r] += start[r - 1]
    for e in range(indices.shape[0]):
        a, b, c, h = np.int64(indices[e, 0]), np.int64(indices[e, 1]), np.int64(indices[e, 2]), weights[e]
        for rest, r in ((c, rank(a, b) + 1), (b, rank(a, c) + 1), (a, rank(b, c) + 1)):
            place = start[r]
            start[r] = place + one
            others[place] = rest
            held[place] = h
    # Read in order, now that a pair's weights lie side by side.
    r, place = 0, 0
    for high in range(marginals.size):
        for low in range(high):
            total = 0.0
            for t in range(place, np.int64(start[r + 1])):
                total += held[t]
            place = np.int64(start[r + 1])
            sums[r] = total
            # Each hyper-edge of a correspondence is in two of its pairs.
            marginals[high] += 0.5 * total
            marginals[low] += 0.5 * total
            r += 1


@njit(cache=True, nogil=True)
def pair_support(indices, weights, sums, support):  # type: ignore[no-untyped-def]
    """Weights of the other hyper-edges that share two correspondences with each, (E,), from the sums of the pairs."""
    for e in range(indices.shape[0]):
        a, b, c = np.int64(indices[e, 0]), np.int64(indices[e, 1]), np.int64(indices[e, 2])
        shared = sums[rank(a, b)] + sums[rank(a, c)] + sums[rank(b, c)]
        # Rounding must not make a lonely hyper-edge's support negative.
        support[e] = max(shared - 3.0 * weights[e], 0.0)


class PairTable(NamedTuple):
    """Pairs of the correspondences of a tensor of order 3."""

    start: NDArray[np.uint32]  # (pairs + 1,) first entry of each pair
    others: NDArray[np.uint16]  # (3 E,) what completes it, hyper-edges ascending
    held: NDArray[np.float64]  # (3 E,) and the weight
    sums: NDArray[np.float64]  # (pairs,) of the weights
    marginals: NDArray[np.float64]  # (n n',)


def pair_table(indices: NDArray[np.int32], weights: NDArray[np.float64], correspondences: int) -> PairTable:
    """The table of hyper-edges (E, 3)."""
    pairs = pairs_of(correspondences)
    start, sums, marginals = np.zeros(pairs + 2, np.uint32), np.zeros(pairs), np.zeros(correspondences)
    others, held = np.empty(indices.size, np.uint16), np.empty(indices.size)
    _fill(indices, weights, start, others, held, sums, marginals)
    return PairTable(start[:-1], others, held, sums, marginals)
