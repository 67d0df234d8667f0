"""Solvers of the hypergraph matching problem; one signature, one result."""

from __future__ import annotations

from inspect import signature

from rootmatch.errors import InputError, quote_value
from rootmatch.solvers.ascent.solver import MultiStartAscent
from rootmatch.solvers.base import Solution, Solver
from rootmatch.solvers.bcagm import BlockCoordinateAscent
from rootmatch.solvers.hgm import KLProjection
from rootmatch.solvers.power import PowerIteration
from rootmatch.solvers.rrwhm import ReweightedWalk

__all__ = [
    "SOLVERS",
    "BlockCoordinateAscent",
    "KLProjection",
    "MultiStartAscent",
    "PowerIteration",
    "ReweightedWalk",
    "Solution",
    "Solver",
    "get_solver",
]

SOLVERS: dict[str, Solver] = {
    "ascent": MultiStartAscent(),
    "power-l1": PowerIteration("l1"),
    "power-l1-balanced": PowerIteration("l1", normalise="smaller"),
    "power-l1-start": PowerIteration("l1", bias=1.0),
    "power-dense": PowerIteration("l2"),
    "rrwhm": ReweightedWalk(),
    "rrwhm-published": ReweightedWalk(slack=False),
    "rrwhm-soft": ReweightedWalk(walk=0.8),
    "hgm": KLProjection(),
    "bcagm": BlockCoordinateAscent(),
}
"""The common choices by name, with default options.

``power-l1`` is the paper's, which normalises the rows; ``power-l1-balanced`` balances both sets where they are equal;
``power-l1-start`` adds the start value to each iterate, as the published code of that solver does.
``rrwhm`` gives the larger set a slack line, ``rrwhm-published`` balances to equal sums as its authors' code does, and
``rrwhm-soft`` walks longer and jumps less (docs/hypergraph.md compares them).
"""


def get_solver(solver: str | Solver) -> Solver:
    """The solver of a name, or the given one.

    Raises
    ------
    InputError
        For an unknown name, or something that cannot be called with a tensor.
    """
    if isinstance(solver, str):
        if solver not in SOLVERS:
            raise InputError(f"solver: got {solver!r}; expected one of {', '.join(SOLVERS)}, or a solver object")
        return SOLVERS[solver]
    if isinstance(solver, type) or not callable(solver):
        raise InputError(f"solver: got {solver!r}; expected a name or a solver object such as PowerIteration()")
    try:
        signature(solver).bind(None, seed=0)
    except TypeError:
        raise InputError(
            f"solver: {quote_value(solver)} cannot be called with a tensor and seed=; give it the signature "
            "(tensor, *, seed=0)"
        ) from None
    except ValueError:  # what is written in another language may not tell
        pass
    return solver
