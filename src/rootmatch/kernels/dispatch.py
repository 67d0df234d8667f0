"""Which kernel serves which problem and residual, decided by types while compiling.

A driver calls `edge_residual` and `slab_residual`; the type of the problem's tables and the type of the kind (both
NamedTuples) choose the kernel. One driver thus serves every problem, and the on-disk cache of Numba finds it again:
a driver that took the kernel as an argument, or closed over it, would be compiled anew in each process.

Tables of single precision get the kernel's twin (`rootmatch.kernels.single`), in `edge_residual`, `fill_panel` and
`slab_residual`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import lower_builtin, overload
from numpy.typing import NDArray

from rootmatch.kernels.inner import inner
from rootmatch.kernels.single import serving

FASTMATH = {"contract", "arcp", "nsz", "reassoc"}
"""Reordering and fused products are welcome; NaN and infinity keep their meaning, as kernels compare with them."""

scalar = inner(fastmath=FASTMATH, error_model="numpy", forceinline=True)
"""Decorator of scalar kernels: straight-line arithmetic that LLVM inlines, and vectorises in the loop around it."""

kernel = inner(fastmath=FASTMATH, error_model="numpy", forceinline=True)
"""Decorator of what loops: row kernels and large scalars.

Inlined too, into the driver: a function of its own would be there twice, optimised apart, and a process that has just
compiled the driver would call the other copy than one that found it on disk, which differs in the last digits.
"""

part = inner(fastmath=FASTMATH, error_model="numpy")
"""Decorator of what LLVM may inline or call: pieces of the search, whose loop a large body would slow by two thirds."""

OVERLOADS: list[tuple[Callable[..., Any], Callable[..., Any]]] = []
"""Functions that choose a kernel by type, each with its choice; a backend of another target makes them known there."""


def chooses(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate the choice of what ``function`` is in compiled code, on processors and on every other target."""

    def known(choice: Callable[..., Any]) -> Callable[..., Any]:
        OVERLOADS.append((function, choice))
        result: Callable[..., Any] = overload(function, jit_options={"forceinline": True})(choice)
        return result

    return known


def calls(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate the choice, by types, of the kernel that ``function`` is in compiled code on processors.

    Unlike an overload there is no function between the two, which would be optimised for itself once more.
    """

    def known(choice: Callable[..., Any]) -> Callable[..., Any]:
        class Chosen(AbstractTemplate):
            key = function

            def generic(self, arguments: Any, keywords: Any) -> Any:
                return types.Dispatcher(choice(*arguments)).get_call_type(self.context, arguments, keywords)

        infer_global(function, types.Function(Chosen))  # type: ignore[no-untyped-call]

        @lower_builtin(function, types.VarArg(types.Any))  # type: ignore[no-untyped-call]
        def called(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kernel = types.Dispatcher(choice(*signature.args))
            return context.get_function(kernel, signature)(builder, arguments)

        return choice

    return known


_EDGE: dict[tuple[type, type], Callable[..., Any]] = {}
_SLAB: dict[tuple[type, type], Callable[..., Any]] = {}
_PANEL: dict[tuple[type, type], Callable[..., Any]] = {}
_LISTED: dict[tuple[type, type], tuple[Callable[..., Any], Callable[..., Any]]] = {}
_SQUARES: set[tuple[type, type]] = set()
_SINGLE: set[tuple[type, type]] = set()


def register(
    tables: type,
    kind: type,
    edge: Callable[..., Any],
    slab: Callable[..., Any],
    panel: Callable[..., Any] | None = None,
    squares: bool = False,
    single: bool = False,
) -> None:
    """Make these functions the kernels of a pair of types.

    They are ``edge(tables, kind, i, j)`` and ``slab(tables, kind, i, j, first, scratch, out)``; with
    ``panel(tables, kind, i, j, panel)`` the slab's is ``slab(tables, kind, i, j, first, panel, scratch, out)``.
    ``squares`` says that the slab gives the squares of residuals, whose roots only what passes the gate is worth.
    ``single`` says that the ranking of hyper-edges by residual survives in single precision.
    """
    _EDGE[tables, kind] = edge
    _SLAB[tables, kind] = slab
    if panel is not None:
        _PANEL[tables, kind] = panel
    if squares:
        _SQUARES.add((tables, kind))
    if single:
        _SINGLE.add((tables, kind))


def register_listed(tables: type, kind: type, fill: Callable[..., Any], edge: Callable[..., Any]) -> None:
    """Kernels for lists of hyper-edges, where some of the work is done for many at once, in a loop that vectorises.

    They are ``fill(tables, kind, source, target, last, block)``, see `fill_block`, and
    ``edge(tables, kind, i, j, block, column)``, the residual of the hyper-edge whose column that is.
    """
    _LISTED[tables, kind] = fill, edge


def slab_of_rows(row: Callable[..., Any]) -> Any:
    """Slab kernel of a row kernel ``row(tables, kind, i, j, out)``, which does one last source point at a time."""

    @kernel
    def slab(tables, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
        last = i.shape[0] - 1
        for r in range(out.shape[0]):
            i[last] = first + r
            row(tables, kind, i, j, out[r])

    return slab


def edge_residual(tables: Any, kind: Any, i: Any, j: Any) -> float:
    """Residual of one hyper-edge: source indices ``i`` and target indices ``j``, sequences of length d."""
    return float(serving(tables, _EDGE[type(tables), type(kind)])(tables, kind, i, j))


def fill_panel(tables: Any, kind: Any, i: NDArray[np.int64], j: NDArray[np.int64], panel: NDArray[np.float64]) -> None:
    """What slabs share whose minimal sets differ in the last image alone, into ``panel`` (PANEL_ROWS, n').

    ``i[:d - 1]`` are the minimal set's source points and ``j[:d - 2]`` the images of all but its last point; the panel
    has what follows with every image of that one, say the roots, found in one loop that vectorises.
    """
    if (type(tables), type(kind)) in _PANEL:
        serving(tables, _PANEL[type(tables), type(kind)])(tables, kind, i, j, panel)


def slab_residual(
    tables: Any,
    kind: Any,
    i: NDArray[np.int64],
    j: NDArray[np.int64],
    first: int,
    panel: NDArray[np.float64],
    scratch: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Residuals ``out`` (m, n') of a minimal set with every last correspondence (first + r, k), r < m, k < n'.

    Their squares where `gives_squares` says so.

    ``i`` and ``j`` (d,) hold the minimal set; their last entries are free for the kernel. Entries of ``out`` whose k is
    among ``j[:d - 1]`` belong to no hyper-edge and mean nothing. ``panel`` is as `fill_panel` left it for this minimal
    set or for one that differs in ``j[d - 2]`` alone; ``scratch`` has SCRATCH_ROWS contiguous rows, at least m and
    SCRATCH_COLUMNS long. What depends on the minimal set alone is computed once: that is most of the work.
    """
    key = type(tables), type(kind)
    slab = serving(tables, _SLAB[key])
    if key in _PANEL:
        slab(tables, kind, i, j, first, panel, scratch, out)
    else:
        slab(tables, kind, i, j, first, scratch, out)


def gives_squares(tables: Any, kind: Any) -> bool:
    """Whether what `slab_residual` computes are squares of residuals."""
    return (type(tables), type(kind)) in _SQUARES


def fill_block(
    tables: Any,
    kind: Any,
    source: NDArray[np.int64],
    target: NDArray[np.int64],
    first: int,
    last: int,
    block: NDArray[np.float64],
) -> None:
    """What is computed at once for the hyper-edges first … last − 1 of index arrays (E, d), no more than BLOCK_COLUMNS.

    ``block`` is (BLOCK_ROWS, BLOCK_COLUMNS), a column for each; all columns are computed, so that none is the rest of a
    vector and the result of a hyper-edge does not depend on its place in the list.
    """
    if (type(tables), type(kind)) in _LISTED:
        _LISTED[type(tables), type(kind)][0](tables, kind, source, target, first, last, block)


def listed_residual(tables: Any, kind: Any, i: Any, j: Any, block: NDArray[np.float64], column: int) -> float:
    """`edge_residual` of one of a list, after `fill_block`."""
    key = type(tables), type(kind)
    if key in _LISTED:
        return float(_LISTED[key][1](tables, kind, i, j, block, column))
    return edge_residual(tables, kind, i, j)


SCRATCH_ROWS = 32
"""Rows of the scratch array that every caller of a slab kernel provides."""
SCRATCH_COLUMNS = 8
"""Least columns of it."""
PANEL_ROWS = 16
"""Rows of the panel that every caller of a slab kernel provides."""
BLOCK_ROWS, BLOCK_COLUMNS = 56, 64
"""Size of the block that every caller of `fill_block` provides."""


@chooses(edge_residual)
def _edge_overload(tables: Any, kind: Any, i: Any, j: Any) -> Callable[..., Any]:
    function = serving(tables, _EDGE[tables.instance_class, kind.instance_class])

    def implementation(tables: Any, kind: Any, i: Any, j: Any) -> Any:
        return function(tables, kind, i, j)

    return implementation


@kernel
def _no_panel(tables, kind, i, j, panel):  # type: ignore[no-untyped-def]
    """Panel kernel of those that have none."""


@chooses(fill_panel)
def _panel_overload(tables: Any, kind: Any, i: Any, j: Any, panel: Any) -> Callable[..., Any]:
    function = serving(tables, _PANEL.get((tables.instance_class, kind.instance_class), _no_panel))

    def implementation(tables: Any, kind: Any, i: Any, j: Any, panel: Any) -> Any:
        function(tables, kind, i, j, panel)

    return implementation


@kernel
def _no_block(tables, kind, source, target, first, last, block):  # type: ignore[no-untyped-def]
    """Where nothing is done for many hyper-edges at once."""


@calls(fill_block)
def _fill_block_choice(
    tables: Any, kind: Any, source: Any, target: Any, first: Any, last: Any, block: Any
) -> Callable[..., Any]:
    function, _ = _LISTED.get((tables.instance_class, kind.instance_class), (_no_block, None))
    return function


@calls(listed_residual)
def _listed_choice(tables: Any, kind: Any, i: Any, j: Any, block: Any, column: Any) -> Callable[..., Any]:
    key = tables.instance_class, kind.instance_class
    return _LISTED[key][1] if key in _LISTED else _one_by_one(_EDGE[key])


@cache
def _one_by_one(edge: Callable[..., Any]) -> Callable[..., Any]:
    """Kernel of one of a list from that of an edge."""

    @kernel
    def listed(tables, kind, i, j, block, column):  # type: ignore[no-untyped-def]
        return edge(tables, kind, i, j)

    return listed  # type: ignore[no-any-return]


@chooses(slab_residual)
def _slab_overload(
    tables: Any, kind: Any, i: Any, j: Any, first: Any, panel: Any, scratch: Any, out: Any
) -> Callable[..., Any]:
    key = tables.instance_class, kind.instance_class
    function = serving(tables, _SLAB[key])

    def plain(tables: Any, kind: Any, i: Any, j: Any, first: Any, panel: Any, scratch: Any, out: Any) -> Any:
        function(tables, kind, i, j, first, scratch, out)

    def with_panel(tables: Any, kind: Any, i: Any, j: Any, first: Any, panel: Any, scratch: Any, out: Any) -> Any:
        function(tables, kind, i, j, first, panel, scratch, out)

    return with_panel if key in _PANEL else plain


@chooses(gives_squares)
def _squares_overload(tables: Any, kind: Any) -> Callable[..., Any]:
    squares = (tables.instance_class, kind.instance_class) in _SQUARES

    def implementation(tables: Any, kind: Any) -> Any:
        return squares

    return implementation


def has_panel(tables: Any, kind: Any) -> bool:
    """Whether the slab kernel of these types reads its panel."""
    return (type(tables), type(kind)) in _PANEL


def has_single(tables: Any, kind: Any) -> bool:
    """Whether these types have a kernel of single precision."""
    return (type(tables), type(kind)) in _SINGLE


def kinds_of(tables: type) -> tuple[type, ...]:
    """The kinds of residual that are registered for a type of tables."""
    return tuple(kind for table, kind in _EDGE if table is tables)
