"""Floating-point operations per hyper-edge, counted.

The kernels' own Python source runs uncompiled on numbers that count the operations done on them: additions,
multiplications, divisions and square roots count as one each; comparisons and selections are free. This counts the
kernel as written. The compiler fuses multiplications and additions, which changes nothing here, and hoists invariants
out of loops, so the share of the machine's peak that follows is an upper bound, by a tenth or so. Compilation can only
be disabled for a whole process, so `operations` runs another one.
"""

from __future__ import annotations

import math
from typing import Any
from unittest.mock import patch

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor
from numpy.typing import NDArray

from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.affinity import KINDS
from rootmatch.problems.residual_dispatch import PANEL_ROWS, SCRATCH_COLUMNS, SCRATCH_ROWS, fill_panel, slab_residual
from rootmatch.research.speed.scenes import scene_and_tables

_done = 0
_root = math.sqrt


def _count_operation(value: float) -> Counted:
    global _done
    _done += 1
    return Counted(value)


class Counted(float):
    """A number that counts the operations done on it; as in the compiled kernels, nothing raises."""

    def __add__(self, other: float) -> Counted:
        return _count_operation(float(self) + float(other))

    def __sub__(self, other: float) -> Counted:
        return _count_operation(float(self) - float(other))

    def __rsub__(self, other: float) -> Counted:
        return _count_operation(float(other) - float(self))

    def __mul__(self, other: float) -> Counted:
        return _count_operation(float(self) * float(other))

    def __truediv__(self, other: float) -> Counted:
        return _count_operation(_quotient(float(self), float(other)))

    def __rtruediv__(self, other: float) -> Counted:
        return _count_operation(_quotient(float(other), float(self)))

    def __neg__(self) -> Counted:
        return Counted(-float(self))

    def __abs__(self) -> Counted:
        return Counted(abs(float(self)))

    __radd__ = __add__
    __rmul__ = __mul__


def _quotient(a: float, b: float) -> float:
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a)


def _square_root(x: float) -> Counted:
    return _count_operation(_root(float(x)) if float(x) >= 0.0 else math.nan)


def _as_counting(field: NDArray[Any]) -> NDArray[Any]:
    """The array with counting numbers as elements."""
    out = np.empty(field.shape, object)
    out.ravel()[:] = [Counted(value) for value in field.ravel()]
    return out


def count(problem: str, kind: str, points: int, outliers: int, samples: int) -> float:
    """Operations per hyper-edge of an exhaustive sweep, from so many random panels; compilation has to be disabled."""
    global _done
    scene, tables = scene_and_tables(problem, points, outliers)
    order, (n, n_target) = scene.problem.order, (len(scene.source), len(scene.target))
    tables = type(tables)(*map(_as_counting, tables))
    residual = KINDS[kind](pairs=1)
    rng = np.random.default_rng(0)
    bases = enumeration.source_bases(n, order)
    _done = 0
    with patch.object(math, "sqrt", _square_root), patch.object(np, "sqrt", _square_root):
        evaluated = sum(
            _panel(tables=tables, residual=residual, order=order, bases=bases, rng=rng, n=n, n_target=n_target)
            for _ in range(samples)
        )
    return _done / evaluated


def _panel(
    tables: Any, residual: Any, order: int, bases: NDArray[np.int64], rng: np.random.Generator, n: int, n_target: int
) -> int:
    """Run a random panel and all of its slabs; returns their number of hyper-edges."""
    panel, scratch = np.empty((PANEL_ROWS, n_target), object), np.empty((SCRATCH_ROWS, max(n, SCRATCH_COLUMNS)), object)
    i = np.append(bases[rng.integers(len(bases))], 0)
    j = np.append(rng.choice(n_target, order - 2, replace=False), (0, 0))
    first = int(i[order - 2]) + 1
    fill_panel(tables, residual, i, j, panel)
    lasts = np.setdiff1d(np.arange(n_target), j[: order - 2])
    for last in lasts:
        j[order - 2] = last
        slab_residual(tables, residual, i, j, first, panel, scratch, np.empty((n - first, n_target), object))
    return len(lasts) * (n - first) * (n_target - order + 1)


def operations(cases: list[tuple[str, str, int, int]], samples: int) -> list[float]:
    """`count` for each case (problem, kind, points, outliers), in a process with compilation disabled."""
    with ProcessPoolExecutor(1, env={"NUMBA_DISABLE_JIT": "1"}) as pool:
        return [pool.submit(count, *case, samples).result() for case in cases]
