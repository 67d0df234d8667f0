"""All hyper-edges screened in single precision on a card, and what passes evaluated again in double.

The screen runs the twins of the scalar kernels (`rootmatch.jit.float32`) with a wider gate. Residuals, gate and
weights are those of `rootmatch.backends.cuda`; only a hyper-edge that single precision puts beyond the wider gate is
not found. Lists of hyper-edges are evaluated in double from the start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import cuda

from rootmatch.backends.cuda import FIRST_LAUNCH, LAUNCH, LONGEST, Sweep, launch, tables_to_device
from rootmatch.backends.cuda import evaluated as evaluated
from rootmatch.backends.strongest import Enumeration, Strongest, make_strongest
from rootmatch.jit.cuda import SIMULATED
from rootmatch.jit.float32 import round_tables
from rootmatch.problems.residual_dispatch import edge_residual

WIDENED = 1.02
"""The screen's gate over the gate."""
DOUBLES_A_CLOCK = {(6, 0): 32, (7, 0): 32, (7, 2): 32, (8, 0): 32, (9, 0): 64, (10, 0): 64}
"""Fused multiply-adds in double that a multiprocessor does in a clock, by compute capability; 2 on the others, a 32nd
to a 64th of those in single."""


def pays() -> bool:
    """Whether the card is so slow in double that a screen in single precision pays."""
    return tuple(cuda.get_current_device().compute_capability) not in DOUBLES_A_CLOCK


def exact_kernel(tables, kind, bases, arrangements, points, targets, codes, residuals):  # type: ignore[no-untyped-def]
    """Residuals (E,) of hyper-edges given by their numbers in the enumeration, (E,): one a thread."""
    d = bases.shape[1] + 1
    i = cuda.local.array(LONGEST, np.int64)[:d]
    j = cuda.local.array(LONGEST, np.int64)[:d]
    for e in range(cuda.grid(1), codes.shape[0], cuda.gridsize(1)):
        rest = codes[e] // targets
        rank = rest // points
        for k in range(d - 1):
            i[k] = bases[rank // arrangements.shape[0], k]
            j[k] = arrangements[rank % arrangements.shape[0], k]
        i[d - 1] = rest % points
        j[d - 1] = codes[e] % targets
        residuals[e] = edge_residual(tables, kind, i, j)


_exact = cuda.jit(exact_kernel, cache=not SIMULATED)


class Screen:
    """An enumeration on the card in both precisions."""

    def __init__(self, work: Enumeration) -> None:
        self.shape = work.shape
        self.tables = tables_to_device(work.tables)
        self.sweep = Sweep(replace(work, tables=round_tables(work.tables)))

    def __call__(self, first: int, last: int, kept: Strongest) -> int:
        """Add the hyper-edges below the gate that pass the screen, as `Sweep`."""
        sweep = self.sweep
        passed, looked = sweep.run(first, last, WIDENED * kept.gate)
        codes, residuals = sweep.codes[:passed], cuda.device_array(max(passed, 1), np.float64)
        if passed:
            launch(
                _exact, self.tables, sweep.kind, sweep.bases, sweep.arrangements, *self.shape, codes, residuals
            )  # fmt: skip
        exact = residuals.copy_to_host()[:passed]
        below = exact <= kept.gate
        kept.add(codes.copy_to_host()[below], exact[below])
        return looked


strongest = make_strongest(Screen, LAUNCH, FIRST_LAUNCH)
"""See `Backend.strongest`."""
