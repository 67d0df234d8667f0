"""Tables and dispatch of derived problems: one type for all, told apart by a tag that is part of the type.

The drivers find a kernel by the types of their arguments, and their compiled form on disk by the same types. A class
made anew for every derived problem could not be found again in the next process. So all derived problems share
`DerivedTables`, whose last field is an array of one record; the record's only field bears the name of the problem's
generated code (a digest of it). The name is part of the array's type: another problem is another type, and the same
problem is the same type in any process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats
from rootmatch.jit.decorators import kernel
from rootmatch.jit.dispatch import choose_by_types, tuple_class
from rootmatch.problems.kernels import ProblemKernels, ResidualKernels
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth


class DerivedTables(NamedTuple):
    """Quantities of one and of two points, and their derivatives in unit noise."""

    source: Floats
    """(quantities, n)."""
    source_pair: Floats
    """(quantities, n, n)."""
    target: Floats
    """(quantities, n')."""
    target_pair: Floats
    """(quantities, n', n')."""
    source_noise: Floats
    """(quantities · D, n), D the noise dimensions of a source point."""
    source_pair_noise: Floats
    """(quantities · 2 · D, n, n): of each quantity D derivatives in the first point's noise, then D in the second's."""
    target_noise: Floats
    """(quantities · D, n'), D the noise dimensions of a target point."""
    target_pair_noise: Floats
    """(quantities · 2 · D, n', n'), in the order of `source_pair_noise`."""
    tag: Any
    """(1,) record array whose field's name tells the problem."""

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem's kernels."""
        return KERNELS


def make_tag(name: str) -> NDArray[Any]:
    """The tag of generated code of that name."""
    return np.zeros(1, dtype=np.dtype([(name, np.float64)]))


_EDGE: dict[tuple[str, type], Callable[..., Any]] = {}
_SLAB: dict[tuple[str, type], Callable[..., Any]] = {}


def is_registered(name: str) -> bool:
    """Whether the kernels of that tag are registered in this process."""
    return (name, QR) in _EDGE


def register_derived(name: str, kind: type, edge: Callable[..., Any], slab: Callable[..., Any]) -> None:
    """Make these the kernels of the derived problem with that tag; see `ResidualKernels`."""
    _EDGE[name, kind] = edge
    _SLAB[name, kind] = slab


def derived_edge(tables: Any, kind: Any, i: Any, j: Any) -> float:
    """Edge kernel of the tables' problem."""
    return float(_EDGE[tables.tag.dtype.names[0], type(kind)](tables, kind, i, j))


def derived_slab(tables: Any, kind: Any, i: Any, j: Any, first: Any, scratch: Any, out: Any) -> None:
    """Slab kernel of the tables' problem."""
    _SLAB[tables.tag.dtype.names[0], type(kind)](tables, kind, i, j, first, scratch, out)


def _name(tables: Any) -> str:
    tag = tables.types[DerivedTables._fields.index("tag")]
    return str(next(iter(tag.dtype.fields)))


@choose_by_types(derived_edge)
def _edge_overload(tables: Any, kind: Any, i: Any, j: Any) -> Callable[..., Any]:
    function = _EDGE[_name(tables), tuple_class(kind)]

    def implementation(tables: Any, kind: Any, i: Any, j: Any) -> Any:
        return function(tables, kind, i, j)

    return implementation


@choose_by_types(derived_slab)
def _slab_overload(tables: Any, kind: Any, i: Any, j: Any, first: Any, scratch: Any, out: Any) -> Callable[..., Any]:
    function = _SLAB[_name(tables), tuple_class(kind)]

    def implementation(tables: Any, kind: Any, i: Any, j: Any, first: Any, scratch: Any, out: Any) -> Any:
        function(tables, kind, i, j, first, scratch, out)

    return implementation


@kernel
def edge(tables, kind, i, j):  # type: ignore[no-untyped-def]
    """Edge kernel of all derived problems."""
    return derived_edge(tables, kind, i, j)


@kernel
def slab(tables, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
    """Slab kernel of all derived problems."""
    derived_slab(tables, kind, i, j, first, scratch, out)


KERNELS = ProblemKernels(residuals=dict.fromkeys((QR, QRBoth, SVD, Normalised, Joint), ResidualKernels(edge, slab)))
