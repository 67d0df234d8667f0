"""Cliques of a hypergraph: d + 1 correspondences any d of which are a hyper-edge."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.rows import are_one_to_one, first_rows, row_keys, sorted_rows

AT_ONCE = 1 << 20
"""Pairs of hyper-edges that are looked at together; it bounds memory. A round value."""


def cliques(indices: NDArray[np.int32], shape: tuple[int, int], most: int) -> NDArray[np.int32] | None:
    """Sets (C, d + 1) of correspondences, ascending, all of whose d-subsets are among the hyper-edges (E, d), d ≥ 2.

    Hyper-edges that differ in their last correspondence alone are joined in pairs, and the other d − 1 subsets of what
    comes of it are looked up (the candidates of frequent item sets; Agrawal & Srikant 1994).

    Returns
    -------
    (C, d + 1) int32 array
        In lexicographic order; None where there are more than ``most``, or where a row is no 64-bit number.
    """
    base, d = math.prod(shape), indices.shape[1]
    if float(base) ** d >= 2.0**63:
        return None
    ordered = sorted_rows(indices)
    ordered = ordered[first_rows(ordered, base)]
    keys = row_keys(ordered, base)
    # how many rows after each have its first d − 1 correspondences
    after = np.searchsorted(keys // base, keys // base, side="right") - np.arange(len(keys)) - 1
    ends, total = np.cumsum(after), int(after.sum())
    found, count = [np.empty((0, d + 1), np.int32)], 0
    for begin in range(0, total, AT_ONCE):
        number = np.arange(begin, min(begin + AT_ONCE, total))
        first = np.searchsorted(ends, number, side="right")
        second = first + 1 + number - (ends - after)[first]
        joined = np.column_stack([ordered[first], ordered[second, d - 1]])
        joined = joined[are_one_to_one(joined, shape[1])]
        for left_out in range(d - 1):
            wanted = row_keys(np.delete(joined, left_out, axis=1), base)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            joined = joined[keys[place] == wanted]
        found.append(joined)
        count += len(joined)
        if count > most:
            return None
    return np.concatenate(found)
