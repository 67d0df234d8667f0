"""Order 3: which hyper-edges contain two given correspondences, by a table of all pairs.

A tensor of triples mostly has several hyper-edges for each pair of correspondences that there can be. Then a pair needs
no hash: its rank among all pairs is its row in a table, where the completing correspondences and weights lie side by
side (compressed rows). Nothing is compared, and an ascent reads memory in order.

Memory beside the tensor: 30 bytes a hyper-edge and 12 a pair.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function

SPARSEST = 2
"""Pairs of the table for each that a hyper-edge has, at most."""

LARGEST = 1 << 23
"""Entries of the table, at most: 80 MB, and 200 MB for pairs. Larger tensors take the leaner index.

With so many pairs at most there are fewer than 2^16 correspondences, which is what 16 bits hold."""


def is_table_worthwhile(size: int, order: int, correspondences: int) -> bool:
    """Whether E hyper-edges of some order among n n' correspondences are looked up in a table of pairs."""
    return order == 3 and 3 * size <= LARGEST and pair_total(correspondences) <= SPARSEST * 3 * size


def pair_total(correspondences: int) -> int:
    """Number of pairs of correspondences."""
    return correspondences * (correspondences - 1) // 2


@internal_function()
def place_of_pair(a, b):  # type: ignore[no-untyped-def]
    """Place of a pair among all pairs; a and b are uint32, in any order.

    Unsigned, so that it is not taken for a place counted from an array's end: half of the time of a look-up.
    """
    low, high = min(a, b), max(a, b)
    return ((high * (high - np.uint32(1))) >> np.uint32(1)) + low


@driver(nogil=True)
def _fill_pair_table(indices, weights, start, others, held, sums, marginals):  # type: ignore[no-untyped-def]
    """Counting sort of the pairs of all hyper-edges (E, 3), into the arrays of `pair_table`.

    `start` is one longer than there. `start`, `sums` and `marginals` are all 0 at first.
    """
    # Counted two ahead, so that filling moves each to where the next pair starts.
    one, two = np.uint32(1), np.uint32(2)
    for e in range(indices.shape[0]):
        a, b, c, h = np.uint32(indices[e, 0]), np.uint32(indices[e, 1]), np.uint32(indices[e, 2]), weights[e]
        # Written out three times: a loop over a tuple goes through memory, which takes twice as long.
        r = place_of_pair(a, b)
        start[r + two] += one
        sums[r] += h
        r = place_of_pair(a, c)
        start[r + two] += one
        sums[r] += h
        r = place_of_pair(b, c)
        start[r + two] += one
        sums[r] += h
    for r in range(2, start.size):
        start[r] += start[r - 1]
    for e in range(indices.shape[0]):
        a, b, c, h = np.uint32(indices[e, 0]), np.uint32(indices[e, 1]), np.uint32(indices[e, 2]), weights[e]
        r = place_of_pair(a, b) + one
        place = start[r]
        start[r] = place + one
        others[place], held[place] = c, h
        r = place_of_pair(a, c) + one
        place = start[r]
        start[r] = place + one
        others[place], held[place] = b, h
        r = place_of_pair(b, c) + one
        place = start[r]
        start[r] = place + one
        others[place], held[place] = a, h
    pair = 0
    for high in range(marginals.size):
        total = 0.0
        for low in range(high):
            # Each hyper-edge of a correspondence is in two of its pairs.
            half = 0.5 * sums[pair]
            total += half
            marginals[low] += half
            pair += 1
        marginals[high] = total


@internal_function()
def add_own_weights(indices, weights, rank, best):  # type: ignore[no-untyped-def]
    """Add each hyper-edge's weight to its support; `best` (n n'), −1 as given, becomes the first of the highest."""
    for e in range(indices.shape[0]):
        own = rank[e] + weights[e]
        rank[e] = own
        for p in range(indices.shape[1]):
            a = np.uint32(indices[e, p])
            if best[a] < 0 or own > rank[best[a]]:
                best[a] = e


@driver(nogil=True)
def pair_ranks(indices, weights, sums, support, best):  # type: ignore[no-untyped-def]
    """Support of each hyper-edge, (E,), from the sums of the pairs, to which own weights are added."""
    for e in range(indices.shape[0]):
        a, b, c = np.uint32(indices[e, 0]), np.uint32(indices[e, 1]), np.uint32(indices[e, 2])
        shared = sums[place_of_pair(a, b)] + sums[place_of_pair(a, c)] + sums[place_of_pair(b, c)]
        # Rounding must not make a lonely hyper-edge's support negative.
        support[e] = max(shared - 3.0 * weights[e], 0.0)
    add_own_weights(indices, weights, support, best)


def pair_table(
    indices: NDArray[np.int32], weights: Floats, correspondences: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint16], Floats, Floats, Floats]:
    """The table of hyper-edges (E, 3): start, others, held, sums and marginals as of a `SubsetIndex`."""
    pairs = pair_total(correspondences)
    start, sums, marginals = np.zeros(pairs + 2, np.uint32), np.zeros(pairs), np.zeros(correspondences)
    others, held = np.empty(indices.size, np.uint16), np.empty(indices.size)
    _fill_pair_table(indices, weights, start, others, held, sums, marginals)
    return start[:-1], others, held, sums, marginals
