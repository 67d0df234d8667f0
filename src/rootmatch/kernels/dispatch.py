"""Which kernel serves which problem and residual, decided by types while compiling.

A driver calls `edge_residual` and `row_residual`; the type of the problem's tables and the type of the kind (both
NamedTuples) choose the kernel. One driver thus serves every problem, and the on-disk cache of Numba finds it again:
a driver that took the kernel as an argument, or closed over it, would be compiled anew in each process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numba.extending import overload
from numpy.typing import NDArray

FASTMATH = {"contract", "arcp", "nsz", "reassoc"}
"""Reordering and fused products are welcome; NaN and infinity keep their meaning, as kernels compare with them."""

scalar = njit(fastmath=FASTMATH, error_model="numpy")
"""Decorator of scalar kernels: straight-line arithmetic that LLVM can vectorise when a loop calls it."""

_EDGE: dict[tuple[type, type], Callable[..., Any]] = {}
_ROW: dict[tuple[type, type], Callable[..., Any]] = {}


def register(tables: type, kind: type, edge: Callable[..., Any], row: Callable[..., Any]) -> None:
    """Make ``edge(tables, kind, i, j)`` and ``row(tables, kind, i, j, out)`` the kernels of a pair of types."""
    _EDGE[tables, kind] = edge
    _ROW[tables, kind] = row


def kinds_of(tables: type) -> tuple[type, ...]:
    """The kinds of residual that are registered for a type of tables."""
    return tuple(kind for table, kind in _EDGE if table is tables)


def edge_residual(tables: Any, kind: Any, i: Any, j: Any) -> float:
    """Residual of one hyper-edge: source indices ``i`` and target indices ``j``, sequences of length d."""
    return float(_EDGE[type(tables), type(kind)](tables, kind, i, j))


def row_residual(tables: Any, kind: Any, i: Any, j: Any, out: NDArray[np.float64]) -> None:
    """Residuals ``out`` (n',) of the hyper-edges whose last target index runs over all targets.

    ``j[d - 1]`` is ignored; the entries at ``j[0] … j[d - 2]`` belong to no hyper-edge and mean nothing.
    """
    _ROW[type(tables), type(kind)](tables, kind, i, j, out)


@overload(edge_residual)
def _edge_overload(tables: Any, kind: Any, i: Any, j: Any) -> Callable[..., Any]:
    kernel = _EDGE[tables.instance_class, kind.instance_class]

    def implementation(tables: Any, kind: Any, i: Any, j: Any) -> Any:
        return kernel(tables, kind, i, j)

    return implementation


@overload(row_residual)
def _row_overload(tables: Any, kind: Any, i: Any, j: Any, out: Any) -> Callable[..., Any]:
    kernel = _ROW[tables.instance_class, kind.instance_class]

    def implementation(tables: Any, kind: Any, i: Any, j: Any, out: Any) -> Any:
        kernel(tables, kind, i, j, out)

    return implementation
