"""Kernels over many hyper-edges on processor cores: given lists, and slabs of an enumeration.

Every driver serves all problems and kinds of residual (see `rootmatch.jit.dispatch`), is compiled once for each and
found again in Numba's cache on disk.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends.strongest import Block, Enumeration, Strongest, Sweep, make_strongest
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import driver
from rootmatch.jit.threads import run_in_threads, worthwhile_threads
from rootmatch.problems.padding import pad_tables, target_columns
from rootmatch.problems.residual_dispatch import (
    BLOCK_COLUMNS,
    BLOCK_ROWS,
    PANEL_ROWS,
    SCRATCH_COLUMNS,
    SCRATCH_ROWS,
    fill_block,
    fill_panel,
    gives_squares,
    listed_residual,
    slab_residual,
)

BLOCK = 4_000_000
"""Hyper-edges evaluated between two looks at the progress and at Ctrl-C."""
CHUNKS = 32
"""Pieces of a block, whatever the number of threads, so that the result does not depend on it."""
SMALL = 100_000
"""Hyper-edges up to which one thread evaluates all of them in a millisecond (`benchmarks/matches.py --only small`)."""
FIRST_CAPACITY = 1 << 14
"""Hyper-edges below the gate in a chunk that there is room for at first."""
PIECE = 1024
"""Given hyper-edges that a thread evaluates in a row, a whole number of blocks."""
DECODED = 1 << 20
"""Hyper-edges that are decoded between two looks for signals: some hundredths of a second."""
FIRST_BLOCK = 50_000
"""Hyper-edges of the first block: a millisecond or two."""
PARTS = 4
"""Ranges of chunks for each thread: where much is found, or forbidden, takes another time."""
WORTH_A_THREAD = 16384
"""Hyper-edges of a list, a few milliseconds."""


@driver(nogil=True, error_model="numpy")
def evaluate(tables, kind, source_index, target_index, first, last, block, residual):  # type: ignore[no-untyped-def]
    """Residuals of the hyper-edges first … last − 1 of index arrays (E, d), into an array (E,), and a scratch block."""
    tables, source_index, target_index, block = borrow((tables, source_index, target_index, block))
    for start in range(first, last, BLOCK_COLUMNS):
        end = min(start + BLOCK_COLUMNS, last)
        fill_block(tables, kind, source_index, target_index, start, end, block)
        for e in range(start, end):
            residual[e] = listed_residual(tables, kind, source_index[e], target_index[e], block, e - start)


def sweep(
    work: Enumeration, first: int, last: int, gate: float, *, capacity: int, chunks: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Hyper-edges below the gate among the slabs of ranks ``first … last − 1`` of an enumeration.

    Parameters
    ----------
    work : Enumeration
        Its tables may be padded.
    first, last : int
    gate : float
        Residuals above it are dropped.
    capacity : int
        What each chunk can keep.
    chunks : int
        Pieces that the ranks are cut into; each writes into its own part of the output, in order.

    Returns
    -------
    codes : (chunks, capacity) int64 array
        Number of each hyper-edge, see `Enumeration`.
    residuals : (chunks, capacity) array
    counts, evaluated : (chunks,) int64 arrays
        Found and looked at. A count above ``capacity`` tells that the rest was lost.
    """
    codes = np.empty((chunks, capacity), np.int64)
    residuals = np.empty((chunks, capacity))
    counts = np.zeros(chunks, np.int64)
    evaluated = np.zeros(chunks, np.int64)

    points, targets = work.shape
    columns = target_columns(work.tables, targets)

    def sweep_chunks(first_chunk: int, last_chunk: int) -> None:
        scratch = np.empty((SCRATCH_ROWS, max(points, SCRATCH_COLUMNS)))
        out, panel = np.empty((points, columns)), np.empty((PANEL_ROWS, columns))
        i, j, before = (np.empty(work.order, np.int64) for _ in range(3))
        _sweep(
            work.tables, work.kind, work.bases, first, last, work.arrangements, gate, work.allowed, targets, points,
            chunks, first_chunk, last_chunk, i, j, before, scratch, out, panel, codes, residuals, counts, evaluated,
        )  # fmt: skip

    run_in_threads(sweep_chunks, chunks, worthwhile_threads(chunks), PARTS)
    return codes, residuals, counts, evaluated


@driver(nogil=True, error_model="numpy")
def _sweep(  # type: ignore[no-untyped-def]
    tables, kind, bases, first_rank, last_rank, arrangements, gate, allowed, targets, points,
    chunks, first_chunk, last_chunk, i, j, before, scratch, out, panel, codes, residuals, counts, evaluated,
):  # fmt: skip
    """Chunks first_chunk … last_chunk − 1 of `sweep`; the arrays from i, j (d,) to the panel are scratch.

    ``before`` (d,) tells whose panel it is: j[:d - 2] and, last, the rank of the minimal set.
    """
    tables, bases, arrangements, allowed = borrow((tables, bases, arrangements, allowed))
    codes, residuals, counts, evaluated = borrow((codes, residuals, counts, evaluated))
    i, j, before, scratch, out, panel = borrow((i, j, before, scratch, out, panel))
    d = bases.shape[1] + 1
    capacity = codes.shape[1]
    total = last_rank - first_rank
    masked = allowed.shape[0] > 0
    columns = out.shape[1]
    squares = gives_squares(tables, kind)
    # entries that are no hyper-edge are infinite: the limit stays below that
    limit = min(gate * gate, 1e300) if squares else gate
    for chunk in range(first_chunk, last_chunk):
        before[d - 1] = -1
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
                    hits += line[m] <= limit
                if hits == 0:
                    continue
                for k in range(d - 1):
                    line[arrangements[order, k]] = np.inf
                for m in range(targets):
                    if line[m] <= limit and (not masked or allowed[first + r, m]):
                        if count < capacity:
                            codes[chunk, count] = (rank * points + first + r) * targets + m
                            residuals[chunk, count] = np.sqrt(line[m]) if squares else line[m]
                        count += 1
        counts[chunk] = count
        evaluated[chunk] = done


def decode(work: Enumeration, codes: NDArray[np.int64]) -> NDArray[np.int32]:
    """Flat correspondences (E, d) int32 of hyper-edges by their numbers in an enumeration."""
    points, targets = work.shape
    indices = np.empty((codes.size, work.order), np.int32)
    for first in range(0, codes.size, DECODED):
        last = min(first + DECODED, codes.size)
        _decode(codes, work.bases, work.arrangements, targets, points, first, last, indices)
    return indices


@driver(nogil=True)
def _decode(codes, bases, arrangements, targets, points, first, last, indices):  # type: ignore[no-untyped-def]
    """Fill in rows ``first … last − 1`` of `decode`."""
    d = indices.shape[1]
    for e in range(first, last):
        rest = codes[e] // targets
        rank = rest // points
        base = rank // arrangements.shape[0]
        order = rank - base * arrangements.shape[0]
        for p in range(d - 1):
            indices[e, p] = bases[base, p] * targets + arrangements[order, p]
        indices[e, d - 1] = (rest - rank * points) * targets + codes[e] - rest * targets


def residuals(
    tables: Any, kind: Any, source_index: NDArray[np.integer], target_index: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Residuals (E,) of hyper-edges given as index arrays (E, d)."""
    source = np.ascontiguousarray(source_index, np.int64)
    target = np.ascontiguousarray(target_index, np.int64)
    residual = np.empty(len(source))

    def work(first: int, last: int) -> None:
        block = np.empty((BLOCK_ROWS, BLOCK_COLUMNS))
        evaluate(tables, kind, source, target, first * PIECE, min(last * PIECE, len(source)), block, residual)

    run_in_threads(work, -(-len(source) // PIECE), worthwhile_threads(len(source) // WORTH_A_THREAD))
    return residual


def evaluated(tables: Any, kind: Any, blocks: Iterable[Block]) -> Iterator[tuple[Block, NDArray[np.float64]]]:
    """See `Backend.evaluated`."""
    for block in blocks:
        yield block, residuals(tables, kind, *block)


def _make_sweep(work: Enumeration) -> Sweep:
    """Sweeps on threads; what more is found than there is room for is looked for again."""
    work = replace(work, tables=pad_tables(work.tables, work.shape[1]))
    capacity = FIRST_CAPACITY

    def swept(first: int, last: int, kept: Strongest) -> int:
        nonlocal capacity
        chunks = CHUNKS if (last - first) * work.per_slab > SMALL else 1
        while True:
            try:
                codes, values, counts, looked = sweep(work, first, last, kept.gate, capacity=capacity, chunks=chunks)
            except SystemError as error:
                # Ctrl-C met while a compiled function returns
                if isinstance(error.__cause__, KeyboardInterrupt):
                    raise KeyboardInterrupt from None
                raise
            if counts.max() <= capacity:
                break
            capacity = 1 << int(counts.max()).bit_length()
        for chunk in np.flatnonzero(counts):
            kept.add(codes[chunk, : counts[chunk]], values[chunk, : counts[chunk]])
        return int(looked.sum())

    return swept


strongest = make_strongest(_make_sweep, BLOCK, FIRST_BLOCK)
"""See `Backend.strongest`."""
