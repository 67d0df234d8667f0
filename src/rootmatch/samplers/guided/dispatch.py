"""The kernels of a guided search, selected by the type of a problem's tables while a driver is compiled.

One driver serves all problems and is found again in the on-disk cache; see `rootmatch.problems.residual_dispatch`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rootmatch.jit.dispatch import calls
from rootmatch.problems.kernels import HypothesisKernels, ListedKernels, kernels_of


def hypothesis_kernels(tables: Any) -> HypothesisKernels:
    """The kernels of some tables, of their class or of their Numba type, which must have them."""
    kernels = kernels_of(tables).hypotheses
    if kernels is None:
        raise TypeError(f"{tables}: no kernels for a guided search; ask has_hypotheses() first")
    return kernels


def has_hypotheses(tables: type) -> bool:
    """Whether a type of tables has the kernels for a guided search."""
    return kernels_of(tables).hypotheses is not None


def listed_kernels(tables: Any) -> ListedKernels:
    """The kernels for listed image triples, which must be there."""
    kernels = hypothesis_kernels(tables).listed
    if kernels is None:
        raise TypeError(f"{tables}: no kernels for listed image triples; ask has_listed() first")
    return kernels


def has_listed(tables: type) -> bool:
    """Whether a type of tables has the kernels for listed image triples."""
    kernels = kernels_of(tables).hypotheses
    return kernels is not None and kernels.listed is not None


def set_coordinates(tables: Any, sets: Any, others: Any) -> Any:
    """Coordinates of the other points and the normals of sets; see `HypothesisKernels`."""
    return hypothesis_kernels(tables).coordinates(tables, sets, others)


def solve_set(tables: Any, i: Any, j: Any, scratch: Any) -> Any:
    """Solutions of a set for every last image; see `HypothesisKernels`."""
    hypothesis_kernels(tables).solve(tables, i, j, scratch)


def set_known(tables: Any, grid: Any, i: Any, j: Any) -> Any:
    """The part of a set's frame that does not depend on its last image; see `HypothesisKernels`."""
    return hypothesis_kernels(tables).known(tables, grid, i, j)


def set_frame(tables: Any, grid: Any, known: Any, last: Any, scratch: Any, root: Any) -> Any:
    """Frame of a set at one root; see `HypothesisKernels`."""
    return hypothesis_kernels(tables).frame(tables, grid, known, last, scratch, root)


def predict_set(tables: Any, i: Any, j: Any, root: Any, out: Any) -> Any:
    """Prediction of every point at one root; see `HypothesisKernels`."""
    return hypothesis_kernels(tables).predict(tables, i, j, root, out)


def gather_listed(tables: Any, grid: Any, a: Any, b: Any, c: Any, block: Any, k: Any) -> Any:
    """Fill a column with an image triple; see `ListedKernels`."""
    listed_kernels(tables).gather(tables, grid, a, b, c, block, k)


def solve_listed(tables: Any, i: Any, block: Any, count: Any, scratch: Any) -> Any:
    """Solutions of a set for listed image triples; see `ListedKernels`."""
    listed_kernels(tables).solve(tables, i, block, count, scratch)


def listed_frame(tables: Any, i: Any, block: Any, k: Any, scratch: Any, root: Any) -> Any:
    """Frame of a set at one root of a listed image triple; see `ListedKernels`."""
    return listed_kernels(tables).frame(tables, i, block, k, scratch, root)


@calls(gather_listed)
def _gather_choice(tables: Any, grid: Any, a: Any, b: Any, c: Any, block: Any, k: Any) -> Callable[..., Any]:
    return listed_kernels(tables).gather


@calls(solve_listed)
def _solve_listed_choice(tables: Any, i: Any, block: Any, count: Any, scratch: Any) -> Callable[..., Any]:
    return listed_kernels(tables).solve


@calls(listed_frame)
def _listed_frame_choice(tables: Any, i: Any, block: Any, k: Any, scratch: Any, root: Any) -> Callable[..., Any]:
    return listed_kernels(tables).frame


@calls(solve_set)
def _solve_choice(tables: Any, i: Any, j: Any, scratch: Any) -> Callable[..., Any]:
    return hypothesis_kernels(tables).solve


@calls(set_known)
def _known_choice(tables: Any, grid: Any, i: Any, j: Any) -> Callable[..., Any]:
    return hypothesis_kernels(tables).known


@calls(set_frame)
def _hypothesis_choice(tables: Any, grid: Any, known: Any, last: Any, scratch: Any, root: Any) -> Callable[..., Any]:
    return hypothesis_kernels(tables).frame


@calls(predict_set)
def _predict_choice(tables: Any, i: Any, j: Any, root: Any, out: Any) -> Callable[..., Any]:
    return hypothesis_kernels(tables).predict
