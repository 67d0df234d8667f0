"""Cliques of a hypergraph: d + 1 correspondences any d of which are a hyper-edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.rows import first_rows, sorted_rows
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function


def cliques(indices: NDArray[np.int32], shape: tuple[int, int], most: int) -> NDArray[np.int32] | None:
    """Sets (C, d + 1) of correspondences, ascending, all of whose d-subsets are among the hyper-edges (E, d), d ≥ 2.

    Hyper-edges that differ in their last correspondence alone are joined in pairs, and the other d − 1 subsets of what
    comes of it are looked up (the candidates of frequent item sets; Agrawal & Srikant 1994).

    Returns
    -------
    (C, d + 1) int32 array
        In lexicographic order; None where there are more than ``most``.
    """
    ordered = sorted_rows(indices)
    ordered = ordered[first_rows(ordered, shape[0] * shape[1])]
    starts = np.searchsorted(ordered[:, 0], np.arange(shape[0] * shape[1] + 1)).astype(np.int64)
    found = np.empty((min(most, 1 << 16), ordered.shape[1] + 1), np.int32)
    while True:
        count = int(_join(ordered, starts, shape[1], found))
        if count <= len(found):
            return found[:count]
        if count > most:
            return None
        found = np.empty((count, ordered.shape[1] + 1), np.int32)


@driver(nogil=True)
def _join(ordered, starts, n_target, found):  # type: ignore[no-untyped-def]
    """Fill ``found`` with cliques of the sorted hyper-edges; how many there are."""
    edges, d = ordered.shape
    wanted = np.empty(d, np.int32)
    count = 0
    for e in range(edges):
        for f in range(e + 1, edges):
            same = True
            for p in range(d - 1):
                same = same and ordered[e, p] == ordered[f, p]
            if not same:
                break
            one, two = ordered[e, d - 1], ordered[f, d - 1]
            if one // n_target == two // n_target or one % n_target == two % n_target:
                continue
            complete = True
            for left_out in range(d - 1):
                for p in range(d - 1):
                    wanted[p] = ordered[e, p + 1] if p >= left_out else ordered[e, p]
                # the prefix without one, then both last ones
                wanted[d - 2], wanted[d - 1] = one, two
                if not _contains(ordered, starts, wanted):
                    complete = False
                    break
            if complete:
                if count < found.shape[0]:
                    for p in range(d):
                        found[count, p] = ordered[e, p]
                    found[count, d] = two
                count += 1
    return count


@internal_function()
def _contains(ordered, starts, wanted):  # type: ignore[no-untyped-def]
    """Whether a hyper-edge is among the sorted ones."""
    d = wanted.size
    low, high = starts[wanted[0]], starts[wanted[0] + 1]
    while low < high:
        middle = (low + high) // 2
        before = False
        for p in range(1, d):
            if ordered[middle, p] != wanted[p]:
                before = ordered[middle, p] < wanted[p]
                break
            if p == d - 1:
                return True
        if before:
            low = middle + 1
        else:
            high = middle
    return False
