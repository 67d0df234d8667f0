"""The pairs of minimal sets within a hyper-edge, and the kernels that compare several of them.

A hyper-edge of m + 1 correspondences holds m + 1 minimal sets of m; any two of them share m − 1. A residual compares
one such pair, or several: then it is the greatest of theirs. Each pair is an order of the correspondences, in which the
minimal sets are the first m, and the first m − 1 with the last.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from rootmatch.algebra.any_degree import make_singular_value_kernel
from rootmatch.algebra.bezout import make_last_entry_kernel, make_lesser_entry_kernel
from rootmatch.jit.decorators import kernel
from rootmatch.problems.limits import MAX_PAIRS
from rootmatch.problems.residual_kinds import QR, SVD, QRBoth


def pair_orders(minimal: int) -> tuple[tuple[int, ...], ...]:
    """Orders of a hyper-edge of ``minimal + 1`` correspondences, one for each choice of those that a pair shares."""
    every = range(minimal + 1)
    orders = [(*shared, *(k for k in every if k not in shared)) for shared in combinations(every, minimal - 1)]
    return tuple(orders[:MAX_PAIRS])


def comparisons(degree: int) -> dict[type, Any]:
    """Kernels that compare two polynomials of a degree, by the kind of residual; see `rootmatch.algebra.bezout`."""
    return {
        QR: make_last_entry_kernel(degree),
        QRBoth: make_lesser_entry_kernel(degree),
        SVD: make_singular_value_kernel(degree),
    }


def root_kernel(squared: Any) -> Any:
    """Edge kernel of a residual, from the one of its squares."""

    @kernel
    def edge(tables, kind, i, j):  # type: ignore[no-untyped-def]
        return np.sqrt(squared(tables, kind, i, j))

    return edge


def edge_kernel_of_pairs(residual: Any, minimal: int) -> Any:
    """Edge kernel: the greatest residual of the pairs that ``kind.pairs`` names.

    ``residual``: of one pair, the correspondences of the hyper-edge taken in an order of `pair_orders`. ``minimal``:
    correspondences of a minimal set.
    """
    orders = pair_orders(minimal)
    pairs = len(orders)

    @kernel
    def edge(tables, kind, i, j):  # type: ignore[no-untyped-def]
        greatest = -1.0
        for pair in range(pairs):
            if kind.pairs >> pair & 1:
                greatest = max(greatest, residual(tables, i, j, orders[pair]))
        return greatest

    return edge


def slab_kernel_of_edges(edge: Any) -> Any:
    """Kernel ``(tables, kind, i, j, first, out)`` that fills a slab by an edge kernel, one hyper-edge after the other.

    For several pairs at once, which share nothing.
    """

    @kernel
    def fill(tables, kind, i, j, first, out):  # type: ignore[no-untyped-def]
        last = i.shape[0] - 1
        for r in range(out.shape[0]):
            i[last] = first + r
            for k in range(out.shape[1]):
                j[last] = k
                out[r, k] = edge(tables, kind, i, j)

    return fill


def slab_kernel_of_rows(row: Any, edge: Any) -> Any:
    """Slab kernel: of the first pair alone row by row, of others by the edge kernel.

    ``row``: residuals of the first pair, of the minimal set with source point ``last`` and every target point.
    """
    several = slab_kernel_of_edges(edge)

    @kernel
    def slab(tables, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
        if kind.pairs == 1:
            for r in range(out.shape[0]):
                row(tables, i, j, first + r, out[r])
        else:
            several(tables, kind, i, j, first, out)

    return slab
