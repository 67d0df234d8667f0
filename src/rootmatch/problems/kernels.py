"""The record of kernels by which a problem takes part in matching: what it leaves None it cannot do.

A driver calls functions such as `rootmatch.problems.residual_dispatch.slab_residual`; while it is compiled, the type of
the problem's tables says which kernels those are. So every type of tables has a method ``kernels()`` which hands over
one `ProblemKernels`. Nothing is registered anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rootmatch.jit.dispatch import tuple_class

Kernel = Callable[..., Any]


@dataclass(frozen=True)
class ResidualKernels:
    """Kernels of one kind of residual."""

    edge: Kernel
    """``(tables, kind, i, j)`` → float: the residual of one hyper-edge."""
    slab: Kernel
    """``(tables, kind, i, j, first, scratch, out)``: residuals of a minimal set with every last correspondence; with a
    panel ``(tables, kind, i, j, first, panel, scratch, out)``. See
    `rootmatch.problems.residual_dispatch.slab_residual`."""
    panel: Kernel | None = None
    """``(tables, kind, i, j, panel)``: what slabs share whose minimal sets differ in the last image alone."""
    fill: Kernel | None = None
    """``(tables, kind, source, target, first, last, block)``: what is computed for many hyper-edges of a list at once,
    in a loop that vectorises."""
    listed: Kernel | None = None
    """``(tables, kind, i, j, block, column)`` → float: the residual of one of a list, after ``fill``."""
    squares: bool = False
    """Whether the slab gives squares of residuals, whose roots only what passes the gate is worth."""
    single: bool = False
    """Whether the ranking of hyper-edges by residual survives in single precision."""


@dataclass(frozen=True)
class ListedKernels:
    """Kernels that the search among listed image triples needs (`rootmatch.samplers.guided.listed_triples`)."""

    gather: Kernel
    """``(tables, grid, a, b, c, block, k)``: fill column k of ``block`` (12, B) with an image triple: its bearings in
    the grid's basis, then what is needed."""
    solve: Kernel
    """``(tables, i, block, count, scratch)``: solve the set ``i`` with the first ``count`` of them; ``scratch`` (8, B).
    """
    frame: Kernel
    """``(tables, i, block, k, scratch, root)`` → (bool, 12 numbers): as `HypothesisKernels.frame`, of column k."""


@dataclass(frozen=True)
class HypothesisKernels:
    """Kernels that the guided search needs of a problem, whose tables have ``rays`` (3, n') and ``variance`` (n',)."""

    coordinates: Kernel
    """``(tables, sets, others)`` → (S, 7, n − m), (S, m, 4): of sets (S, m) and the other points (S, n − m) of each, in
    the frame of the set: the others' coordinates, which end with their normals and the cosines of their view angles,
    and those of the set's own points. Not jitted."""
    solve: Kernel
    """``(tables, i, j, scratch)``: solve the set ``i`` with the first m − 1 images ``j`` and every last one;
    ``scratch`` (2 · solutions, n')."""
    known: Kernel
    """``(tables, grid, i, j)`` → tuple of numbers and vectors: what ``frame`` takes from the set before its last image
    is known."""
    frame: Kernel
    """``(tables, grid, known, last, scratch, root)`` → (bool, origin, three axes: 12 numbers): the frame of the set in
    the grid's basis at one root; a point with coordinates α, β, γ lies at origin + α e + β f + γ g. Without a
    branch, so that a loop over the last image vectorises; the rays of the grid have the padding of the tables."""
    predict: Kernel
    """``(tables, i, j, root, out)`` → bool: fill ``out`` (13, n) with the predicted bearing of every source point, two
    axes across it, the covariance along them (s11, s12, s22), and whether it can be visible (1 or 0)."""
    listed: ListedKernels | None = None
    """For triples of points with normals."""
    solutions: int = 4
    """Most solutions of a minimal set, at most 4."""


@dataclass(frozen=True)
class CompletionKernels:
    """Kernels that the completion of minimal sets needs, of tables with ``rays`` (3, n') and ``variance`` (n',)."""

    solutions: int
    """Most solutions of a minimal set."""
    fields: tuple[str, ...]
    """The fields (3, n) of the source points that a prediction needs."""
    predict: Kernel
    """``(tables, flat, count, j, root, out)`` → bool: fill the flat ``out``, rows of STRIDE, with what the minimal set
    of the first m of ``count`` points in ``flat`` (rows of STRIDE: the fields, one after another) with images ``j``
    predicts at one root: bearings x, y, z, the covariance s11, s12, s22 along `tangent_basis` of each, and whether
    it can be visible (1 or 0)."""


STRIDE = 64
"""Points that are predicted together, those of the minimal set among them. Written out in the code, it tells the
compiler that the rows of a flat array do not overlap, without which the loop over the points fills no vectors."""


@dataclass(frozen=True)
class ProblemKernels:
    """All kernels of a problem."""

    residuals: Mapping[type, ResidualKernels] = field(default_factory=dict)
    """By the kind of residual, a type of `rootmatch.problems.residual_kinds`."""
    hypotheses: HypothesisKernels | None = None
    """For the guided search."""
    completion: CompletionKernels | None = None
    """For the completion of minimal sets."""
    target_fields: tuple[str, ...] = ()
    """Fields of the tables with a target axis, which may be padded: the first (k, n'), others (n',), (k, n') or (n',
    n'). Empty: the tables are never padded."""
    source_fields: tuple[str, ...] = ()
    """Fields of the tables with a source axis: (k, n) or (n, n). Empty: a large object is never verified in part."""


def kernel_record(tables: Any) -> ProblemKernels:
    """The record of some tables, or of their Numba type.

    A class that serves several problems has ``kernels_of(tables)`` in the place of ``kernels()``.
    """
    made = tuple_class(tables)
    record: ProblemKernels = made.kernels_of(tables) if hasattr(made, "kernels_of") else made.kernels()
    return record
