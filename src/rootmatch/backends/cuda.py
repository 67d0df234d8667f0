"""Kernels over many hyper-edges on an NVIDIA card, through numba-cuda: the very same scalar kernels as on processors.

Imported only when it is asked for. `sweep` gives each thread one minimal set with one last source point, whose slab
kernel does every target in a row: what depends on the minimal set is computed once for n' hyper-edges, and
neighbouring threads differ in their targets alone, so they read the same source tables and take the same turns. What
passes the gate is compacted with an atomic counter, in any order, and sorted by its number on the host: the tensor has
the same hyper-edges in the same order as that of the processor.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from rootmatch.backends.strongest import Block, Enumeration, Strongest, make_strongest
from rootmatch.errors import InputError
from rootmatch.jit.cuda import SIMULATED, register_kernels
from rootmatch.jit.float32 import is_single
from rootmatch.problems.residual_dispatch import (
    PANEL_ROWS,
    SCRATCH_COLUMNS,
    SCRATCH_ROWS,
    edge_residual,
    fill_panel,
    gives_squares,
    has_panel,
    slab_residual,
)

THREADS = 4 if SIMULATED else 128
"""Threads per block."""
BLOCKS = 8
"""Blocks per multiprocessor: with the kernels' registers two to four run at a time."""
LAUNCH = 1 << 28
"""Hyper-edges per launch: a twentieth of a second, between two checks for progress and Ctrl-C."""
FIRST_LAUNCH = 1 << 20
"""Hyper-edges of the first launch: well below a millisecond."""
LISTED = 1 << 22
"""Given hyper-edges per launch, 32 bytes each."""
LONGEST = 8
"""Highest order of a hyper-edge."""
CAPACITY = 1 << 20
"""Hyper-edges below the gate that there is room for at first; a launch that finds more is repeated with more room."""


def evaluate_kernel(tables, kind, source_index, target_index, residual):  # type: ignore[no-untyped-def]
    """Residuals (E,) of given hyper-edges, index arrays (E, d): one a thread."""
    for e in range(cuda.grid(1), residual.shape[0], cuda.gridsize(1)):
        residual[e] = edge_residual(tables, kind, source_index[e], target_index[e])


def panel_kernel(tables, kind, bases, arrangements, first_stem, panels):  # type: ignore[no-untyped-def]
    """Kernel for the shared part of slabs whose minimal sets differ only in the last image, one per thread.

    ``first_stem``: rank of the first slab of the first stem over slabs a stem, n' − d + 2. ``panels`` (stems,
    PANEL_ROWS, n').
    """
    d = bases.shape[1] + 1
    slabs = panels.shape[2] - d + 2
    i = cuda.local.array(LONGEST, np.int64)[:d]
    j = cuda.local.array(LONGEST, np.int64)[:d]
    for stem in range(cuda.grid(1), panels.shape[0], cuda.gridsize(1)):
        rank = (first_stem + stem) * slabs
        for k in range(d - 1):
            i[k] = bases[rank // arrangements.shape[0], k]
            j[k] = arrangements[rank % arrangements.shape[0], k]
        fill_panel(tables, kind, i, j, panels[stem])


def sweep_kernel(  # type: ignore[no-untyped-def]
    tables, kind, bases, first_rank, last_rank, arrangements, maximum, masked, allowed, points, first_stem,
    panels, lines, codes, residuals, counts,
):  # fmt: skip
    """Hyper-edges below the gate among the slabs of ranks ``first_rank … last_rank − 1``; see `cpu.sweep`.

    In the precision of the tables, which is that of ``maximum`` and of all arrays of numbers.

    Parameters
    ----------
    maximum : float
        The gate, or its square where the slab kernel gives squares.
    masked : bool
        Whether ``allowed`` (n, n') counts.
    points : int
        n.
    first_stem : int
    panels : (stems, PANEL_ROWS, n') array
        Of `panel_kernel`; one stem of no meaning where the kernels have no panel.
    lines : (1, n', threads) array
        Room for each thread's row of residuals; that of neighbouring threads lies side by side.
    codes : (capacity,) int64 array
    residuals : (capacity,) array
        Numbers and residuals of what is found, in no order.
    counts : (2,) int64 array
        Found and looked at; the first may exceed the capacity, and what is beyond it is lost.
    """
    thread = cuda.grid(1)
    threads = cuda.gridsize(1)
    d = bases.shape[1] + 1
    targets = lines.shape[1]
    i = cuda.local.array(LONGEST, np.int64)[:d]
    j = cuda.local.array(LONGEST, np.int64)[:d]
    scratch = cuda.local.array((SCRATCH_ROWS, SCRATCH_COLUMNS), lines.dtype)
    out = lines[:, :, thread]
    slabs = last_rank - first_rank
    slabs_a_stem = targets - d + 2
    squares = gives_squares(tables, kind)
    done = 0
    for task in range(thread, slabs * (points - d + 1), threads):
        rank = first_rank + task % slabs
        base = rank // arrangements.shape[0]
        order = rank % arrangements.shape[0]
        last = bases[base, d - 2] + 1 + task // slabs
        if last >= points:
            continue
        possible = True
        for k in range(d - 1):
            i[k] = bases[base, k]
            j[k] = arrangements[order, k]
            if masked and not allowed[i[k], j[k]]:
                possible = False
        if not possible:
            continue
        i[d - 1] = last
        j[d - 1] = 0
        stem = min(rank // slabs_a_stem - first_stem, panels.shape[0] - 1)
        slab_residual(tables, kind, i, j, last, panels[stem], scratch, out)
        done += targets - d + 1
        for k in range(d - 1):
            out[0, arrangements[order, k]] = np.inf
        for m in range(targets):
            value = out[0, m]
            if value <= maximum and (not masked or allowed[last, m]):
                place = cuda.atomic.add(counts, 0, 1)
                if place < codes.shape[0]:
                    codes[place] = (rank * points + last) * targets + m
                    residuals[place] = math.sqrt(value) if squares else value
    if done > 0:
        cuda.atomic.add(counts, 1, done)


_evaluate = cuda.jit(evaluate_kernel, cache=not SIMULATED)
_panel = cuda.jit(panel_kernel, cache=not SIMULATED)
_sweep = cuda.jit(sweep_kernel, cache=not SIMULATED)


def block_count() -> int:
    """Blocks of a launch that fills the card."""
    return 2 if SIMULATED else BLOCKS * int(cuda.get_current_device().MULTIPROCESSOR_COUNT)


def tables_to_device(tables: Any) -> Any:
    """Tables with their arrays on the card."""
    return type(tables)(*(cuda.to_device(np.ascontiguousarray(array)) for array in tables))


def launch(kernel: Any, *arguments: Any) -> None:
    """Run a kernel; one that cannot be compiled for a card is an input error."""
    register_kernels()
    try:
        kernel[block_count(), THREADS](*arguments)
    except Exception as error:
        if SIMULATED or type(error).__name__ not in ("TypingError", "LoweringError", "UnsupportedError", "LinkerError"):
            raise
        kind = type(arguments[1]).__name__
        raise InputError(
            f"backend: the residual {kind} of this problem does not run on a GPU "
            f'({str(error).strip().splitlines()[0]}); use backend="cpu"'
        ) from error


def _evaluate_listed(
    tables: Any, kind: Any, source_index: NDArray[Any], target_index: NDArray[Any]
) -> NDArray[np.float64]:
    """Residuals (E,) of hyper-edges given as index arrays (E, d), by tables on the card."""
    values = np.empty(len(source_index))
    for first in range(0, len(values), LISTED):
        part = slice(first, first + LISTED)
        source, target = (
            cuda.to_device(np.ascontiguousarray(index[part], np.int32)) for index in (source_index, target_index)
        )
        out = cuda.device_array(len(source), np.float64)
        launch(_evaluate, tables, kind, source, target, out)
        values[part] = out.copy_to_host()
    return values


def evaluated(tables: Any, kind: Any, blocks: Iterable[Block]) -> Iterator[tuple[Block, NDArray[np.float64]]]:
    """See `Backend.evaluated`."""
    there = tables_to_device(tables)
    for block in blocks:
        yield block, _evaluate_listed(there, kind, *block)


class Sweep:
    """An enumeration on the card, with room for what is found; in the precision of its tables."""

    def __init__(self, work: Enumeration) -> None:
        n, n_target = work.shape
        self.number: Any = np.float32 if is_single(work.tables) else np.float64
        self.squares = gives_squares(work.tables, work.kind)
        self.tables, self.kind = tables_to_device(work.tables), work.kind
        self.bases, self.arrangements = cuda.to_device(work.bases), cuda.to_device(work.arrangements)
        self.masked, self.points = work.allowed.size > 0, n
        self.allowed = cuda.to_device(work.allowed if self.masked else np.ones((1, 1), np.bool_))
        self.lines = cuda.device_array((1, n_target, block_count() * THREADS), self.number)
        self.counts = cuda.device_array(2, np.int64)
        self.has_panel = has_panel(work.tables, work.kind)
        self.slabs_a_stem = n_target - work.order + 2
        self.panels = cuda.device_array((1, PANEL_ROWS, n_target), self.number)
        self._reserve(CAPACITY)

    def _reserve(self, capacity: int) -> None:
        self.codes = cuda.device_array(capacity, np.int64)
        self.residuals = cuda.device_array(capacity, self.number)

    def _fill_panels(self, first: int, last: int) -> int:
        """Panels of the stems of these ranks; the first of the stems."""
        if not self.has_panel:
            return 0
        first_stem, stems = first // self.slabs_a_stem, -(-last // self.slabs_a_stem) - first // self.slabs_a_stem
        if stems != self.panels.shape[0]:
            self.panels = cuda.device_array((stems, *self.panels.shape[1:]), self.number)
        launch(_panel, self.tables, self.kind, self.bases, self.arrangements, first_stem, self.panels)
        return first_stem

    def run(self, first: int, last: int, gate: float) -> tuple[int, int]:
        """How many of the slabs of these ranks are below the gate, and looked at; ``codes`` has them, in no order."""
        first_stem = self._fill_panels(first, last)
        # entries that are no hyper-edge are infinite: the limit stays below that
        maximum = self.number(min(gate * gate if self.squares else gate, float(np.finfo(self.number).max)))
        while True:
            self.counts.copy_to_device(np.zeros(2, np.int64))
            launch(
                _sweep, self.tables, self.kind, self.bases, first, last, self.arrangements, maximum, self.masked,
                self.allowed, self.points, first_stem, self.panels, self.lines, self.codes, self.residuals, self.counts,
            )  # fmt: skip
            found, looked = (int(number) for number in self.counts.copy_to_host())
            if found <= self.codes.size:
                return found, looked
            self._reserve(1 << found.bit_length())

    def __call__(self, first: int, last: int, kept: Strongest) -> int:
        """Add the hyper-edges below the gate among the slabs of these ranks; how many were looked at."""
        found, looked = self.run(first, last, kept.gate)
        kept.add(self.codes[:found].copy_to_host(), self.residuals[:found].copy_to_host())
        return looked


strongest = make_strongest(Sweep, LAUNCH, FIRST_LAUNCH)
"""See `Backend.strongest`."""
