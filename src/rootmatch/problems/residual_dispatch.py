"""Which residual kernel serves which problem, decided by types while compiling.

A driver calls `edge_residual` and `slab_residual`; the type of the problem's tables, whose record names the kernels
(`rootmatch.problems.kernels`), and the type of the kind choose the kernel. One driver thus serves every problem, and
the on-disk cache of Numba finds it again: a driver that took the kernel as an argument, or closed over it, would be
compiled anew in each process.

Tables of single precision get the kernel's twin (`rootmatch.jit.float32`), in `edge_residual`, `fill_panel` and
`slab_residual`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from rootmatch.arrays import Floats, Integers
from rootmatch.jit.decorators import kernel
from rootmatch.jit.dispatch import call_by_types, choose_by_types, tuple_class
from rootmatch.jit.float32 import kernel_for_tables
from rootmatch.problems.kernels import ResidualKernels, kernel_record

SCRATCH_ROWS = 32
"""Rows of the scratch array that every caller of a slab kernel provides."""
SCRATCH_COLUMNS = 8
"""Least number of columns of that array."""
PANEL_ROWS = 16
"""Rows of the panel that every caller of a slab kernel provides."""
BLOCK_ROWS, BLOCK_COLUMNS = 60, 64
"""Size of the block that every caller of `fill_block` provides."""


def residual_kernels(tables: Any, kind: Any) -> ResidualKernels:
    """The kernels of tables and kind, both given as they are or as their Numba types."""
    return kernel_record(tables).residuals[tuple_class(kind)]


def edge_residual(tables: Any, kind: Any, i: Any, j: Any) -> float:
    """Residual of one hyper-edge: source indices ``i`` and target indices ``j``, sequences of length d."""
    return float(kernel_for_tables(tables, residual_kernels(tables, kind).edge)(tables, kind, i, j))


def fill_panel(tables: Any, kind: Any, i: Integers, j: Integers, panel: Floats) -> None:
    """Fill ``panel`` (PANEL_ROWS, n') with what slabs share whose minimal sets differ in the last image only.

    ``i[:d - 1]`` are the minimal set's source points and ``j[:d - 2]`` the images of all but its last point; the panel
    has what follows with every image of that one, say the roots, found in one loop that vectorises.
    """
    fill = residual_kernels(tables, kind).panel
    if fill is not None:
        kernel_for_tables(tables, fill)(tables, kind, i, j, panel)


def slab_residual(
    tables: Any, kind: Any, i: Integers, j: Integers, first: int, panel: Floats, scratch: Floats, out: Floats
) -> None:
    """Residuals ``out`` (m, n') of a minimal set with every last correspondence (first + r, k), r < m, k < n'.

    Their squares where `gives_squares` says so.

    ``i`` and ``j`` (d,) hold the minimal set; their last entries are free for the kernel. Entries of ``out`` whose k is
    among ``j[:d - 1]`` belong to no hyper-edge and mean nothing. ``panel`` is as `fill_panel` left it for this minimal
    set or for one that differs in ``j[d - 2]`` alone; ``scratch`` has SCRATCH_ROWS contiguous rows, at least m and
    SCRATCH_COLUMNS long. What depends on the minimal set alone is computed once: that is most of the work.
    """
    kernels = residual_kernels(tables, kind)
    slab = kernel_for_tables(tables, kernels.slab)
    if kernels.panel is not None:
        slab(tables, kind, i, j, first, panel, scratch, out)
    else:
        slab(tables, kind, i, j, first, scratch, out)


def gives_squares(tables: Any, kind: Any) -> bool:
    """Whether what `slab_residual` computes are squares of residuals."""
    return residual_kernels(tables, kind).squares


def fill_block(
    tables: Any, kind: Any, source: Integers, target: Integers, first: int, last: int, block: Floats
) -> None:
    """Compute the shared part of hyper-edges first … last − 1 of index arrays (E, d), at most BLOCK_COLUMNS of them.

    ``block`` is (BLOCK_ROWS, BLOCK_COLUMNS), a column for each; all columns are computed, so that none is the rest of a
    vector and the result of a hyper-edge does not depend on its place in the list.
    """
    fill = residual_kernels(tables, kind).fill
    if fill is not None:
        fill(tables, kind, source, target, first, last, block)


def listed_residual(tables: Any, kind: Any, i: Any, j: Any, block: Floats, column: int) -> float:
    """Residual of one hyper-edge of a list, as `edge_residual`, after `fill_block`."""
    listed = residual_kernels(tables, kind).listed
    if listed is not None:
        return float(listed(tables, kind, i, j, block, column))
    return edge_residual(tables, kind, i, j)


@choose_by_types(edge_residual)
def _edge_overload(tables: Any, kind: Any, i: Any, j: Any) -> Callable[..., Any]:
    function = kernel_for_tables(tables, residual_kernels(tables, kind).edge)

    def implementation(tables: Any, kind: Any, i: Any, j: Any) -> Any:
        return function(tables, kind, i, j)

    return implementation


@kernel
def _no_panel(tables, kind, i, j, panel):  # type: ignore[no-untyped-def]
    """Panel kernel that does nothing, for residuals that have none."""


@choose_by_types(fill_panel)
def _panel_overload(tables: Any, kind: Any, i: Any, j: Any, panel: Any) -> Callable[..., Any]:
    function = kernel_for_tables(tables, residual_kernels(tables, kind).panel or _no_panel)

    def implementation(tables: Any, kind: Any, i: Any, j: Any, panel: Any) -> Any:
        function(tables, kind, i, j, panel)

    return implementation


@kernel
def _no_block(tables, kind, source, target, first, last, block):  # type: ignore[no-untyped-def]
    """Block kernel that does nothing, for residuals that are computed one hyper-edge at a time."""


@call_by_types(fill_block)
def _fill_block_choice(
    tables: Any, kind: Any, source: Any, target: Any, first: Any, last: Any, block: Any
) -> Callable[..., Any]:
    return residual_kernels(tables, kind).fill or _no_block


@call_by_types(listed_residual)
def _listed_choice(tables: Any, kind: Any, i: Any, j: Any, block: Any, column: Any) -> Callable[..., Any]:
    kernels = residual_kernels(tables, kind)
    return kernels.listed or _make_listed_kernel(kernels.edge)


@cache
def _make_listed_kernel(edge: Callable[..., Any]) -> Callable[..., Any]:
    """Kernel for one hyper-edge of a list, made from the edge kernel."""

    @kernel
    def listed(tables, kind, i, j, block, column):  # type: ignore[no-untyped-def]
        return edge(tables, kind, i, j)

    return listed  # type: ignore[no-any-return]


@choose_by_types(slab_residual)
def _slab_overload(
    tables: Any, kind: Any, i: Any, j: Any, first: Any, panel: Any, scratch: Any, out: Any
) -> Callable[..., Any]:
    kernels = residual_kernels(tables, kind)
    function = kernel_for_tables(tables, kernels.slab)

    def plain(tables: Any, kind: Any, i: Any, j: Any, first: Any, panel: Any, scratch: Any, out: Any) -> Any:
        function(tables, kind, i, j, first, scratch, out)

    def with_panel(tables: Any, kind: Any, i: Any, j: Any, first: Any, panel: Any, scratch: Any, out: Any) -> Any:
        function(tables, kind, i, j, first, panel, scratch, out)

    return plain if kernels.panel is None else with_panel


@choose_by_types(gives_squares)
def _squares_overload(tables: Any, kind: Any) -> Callable[..., Any]:
    squares = residual_kernels(tables, kind).squares

    def implementation(tables: Any, kind: Any) -> Any:
        return squares

    return implementation


def has_panel(tables: Any, kind: Any) -> bool:
    """Whether the slab kernel of these types reads its panel."""
    return residual_kernels(tables, kind).panel is not None


def has_single(tables: Any, kind: Any) -> bool:
    """Whether these types have a kernel of single precision."""
    return residual_kernels(tables, kind).single


def residual_kinds_of_tables(tables: Any) -> tuple[type, ...]:
    """The kinds of residual that tables, or a type of tables, have kernels for."""
    return tuple(kernel_record(tables).residuals)
