"""Kernels over many hyper-edges on processor cores: given lists, and slabs of an enumeration.

Every driver serves all problems and kinds of residual (see `rootmatch.kernels.dispatch`), is compiled once for each and
found again in Numba's cache on disk.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from rootmatch.kernels.dispatch import PANEL_ROWS, SCRATCH_ROWS, edge_residual, fill_panel, slab_residual
from rootmatch.kernels.padding import target_columns


@njit(parallel=True, cache=True, error_model="numpy")
def evaluate(tables, kind, source_index, target_index):  # type: ignore[no-untyped-def]
    """Residuals (E,) of given hyper-edges, index arrays (E, d)."""
    residual = np.empty(source_index.shape[0])
    for e in prange(source_index.shape[0]):
        residual[e] = edge_residual(tables, kind, source_index[e], target_index[e])
    return residual


@njit(parallel=True, cache=True, error_model="numpy")
def sweep(tables, kind, bases, first_rank, last_rank, arrangements, gate, allowed, capacity, targets, points, chunks):  # type: ignore[no-untyped-def]
    """Hyper-edges below the gate among the slabs of ranks ``first_rank … last_rank − 1``.

    Parameters
    ----------
    bases : (B, d − 1) int64 array
        Minimal sets of source points, increasing; the last point of a hyper-edge runs from the last of them + 1 on.
    first_rank, last_rank : int
        A slab's rank is (minimal set) · arrangements + (arrangement of targets).
    arrangements : (P, d − 1) int32 array
        All arrangements of d − 1 targets.
    gate : float
        Residuals above it are dropped.
    allowed : (n, n') bool array, or (0, 0) for all
        Candidate correspondences.
    capacity : int
        What each chunk can keep.
    targets, points : int
        n' and n.
    chunks : int
        Pieces that the ranks are cut into; each writes into its own part of the output, in order.

    Returns
    -------
    codes : (chunks, capacity) int64 array
        ((rank · n) + last source) · n' + last target of each hyper-edge.
    residuals : (chunks, capacity) array
    counts, evaluated : (chunks,) int64 arrays
        Found and looked at. A count above ``capacity`` tells that the rest was lost.
    """
    d = bases.shape[1] + 1
    codes = np.empty((chunks, capacity), np.int64)
    residuals = np.empty((chunks, capacity))
    counts = np.zeros(chunks, np.int64)
    evaluated = np.zeros(chunks, np.int64)
    total = last_rank - first_rank
    masked = allowed.shape[0] > 0
    columns = target_columns(tables, targets)
    for chunk in prange(chunks):
        i = np.empty(d, np.int64)
        j = np.empty(d, np.int64)
        scratch = np.empty((SCRATCH_ROWS, points))
        out = np.empty((points, columns))
        panel = np.empty((PANEL_ROWS, columns))
        before = np.full(d, -1)  # whose panel it is: j[:d - 2] and, last, the rank of the minimal set
        count = 0
        done = 0
        for rank in range(first_rank + total * chunk // chunks, first_rank + total * (chunk + 1) // chunks):
            base = rank // arrangements.shape[0]
            order = rank % arrangements.shape[0]
            possible = True
            for k in range(d - 1):
                i[k] = bases[base, k]
                j[k] = arrangements[order, k]
                if masked and not allowed[i[k], j[k]]:
                    possible = False
            if not possible:
                continue
            first = bases[base, d - 2] + 1
            rows = points - first
            i[d - 1] = first
            j[d - 1] = 0
            known = before[d - 1] == base
            for k in range(d - 2):
                known = known and before[k] == j[k]
                before[k] = j[k]
            if not known:
                before[d - 1] = base
                fill_panel(tables, kind, i, j, panel)
            slab_residual(tables, kind, i, j, first, panel, scratch, out[:rows])
            done += rows * (targets - d + 1)
            for r in range(rows):
                line = out[r]
                hits = 0
                for m in range(columns):
                    hits += line[m] <= gate
                if hits == 0:
                    continue
                for k in range(d - 1):
                    line[arrangements[order, k]] = np.inf
                for m in range(targets):
                    if line[m] <= gate and (not masked or allowed[first + r, m]):
                        if count < capacity:
                            codes[chunk, count] = (rank * points + first + r) * targets + m
                            residuals[chunk, count] = line[m]
                        count += 1
        counts[chunk] = count
        evaluated[chunk] = done
    return codes, residuals, counts, evaluated


@njit(cache=True)
def decode(codes, bases, arrangements, targets, points):  # type: ignore[no-untyped-def]
    """Flat correspondences (E, d) int32 of the codes that `sweep` returns."""
    d = bases.shape[1] + 1
    indices = np.empty((codes.shape[0], d), np.int32)
    for e in range(codes.shape[0]):
        rest, m = divmod(codes[e], targets)
        rank, last = divmod(rest, points)
        base, order = divmod(rank, arrangements.shape[0])
        for k in range(d - 1):
            indices[e, k] = bases[base, k] * targets + arrangements[order, k]
        indices[e, d - 1] = last * targets + m
    return indices


def residuals(
    tables: Any, kind: Any, source_index: NDArray[np.integer], target_index: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Residuals (E,) of hyper-edges given as index arrays (E, d)."""
    result: NDArray[np.float64] = evaluate(
        tables, kind, np.ascontiguousarray(source_index, np.int64), np.ascontiguousarray(target_index, np.int64)
    )
    return result
