"""The solver protocol: a solver takes an affinity tensor and returns a `Solution`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from inspect import signature
from typing import Any, Protocol

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, Deadline, OutOfTime, checkpoint
from rootmatch.errors import InputError, quote_value
from rootmatch.hypergraph.assignment import check_assignment, margin
from rootmatch.hypergraph.tensor import AffinityTensor

Alternatives = list[tuple[Integers, float]]

SECONDS_PER_PAIR = 1.5e-8
"""A solver's tables of all pairs take at least so long (benchmarks/deadlines.py, task 605)."""


@dataclass(frozen=True, eq=False)
class Solution:
    """An assignment, its score and alternatives, and how the solver arrived at it.

    Parameters
    ----------
    soft : (n, n') float64
        Soft assignment, non-negative, in the solver's own units.
    assignment : (n,) int64
        Target of each source point, −1 where unmatched.
    score : float
        Objective of the assignment (`AffinityTensor.score`; less the penalty for a solver that has one).
    alternatives : list of ((n,) int64, float)
        The best different assignments known, best first, with their scores. The assignment itself is not among them.
    converged : bool
        Whether the solver stopped by its own criterion rather than at a limit.
    iterations : int
        Passes over the tensor, or moves of a discrete ascent.
    statistics : dict of float
        Statistics of the solver's own.
    groups : (n,) int64, optional
        Group (motion) of each point, −1 where unmatched, from a solver that finds several.
    """

    soft: Floats
    assignment: Integers
    score: float
    alternatives: Alternatives
    converged: bool
    iterations: int
    statistics: dict[str, float] = field(default_factory=dict)
    groups: Integers | None = None

    @property
    def margin(self) -> float:
        """Lead over the best alternative: 0 for a tie or if one scores more, 1 when nothing else scores."""
        return margin(self.score, self.alternatives)

    @property
    def status(self) -> str:
        """How the solver ended, and which option to change."""
        if not (self.assignment >= 0).any():
            return "empty: no hyper-edge or unary weight supports any pair; give more hyper-edges or a larger rho"
        if not self.converged:
            return f"stopped after {self.iterations} iterations before it settled; raise the solver's limit"
        return "converged"


class Solver(Protocol):
    """A frozen dataclass of options that is called with a tensor.

    Its assignments decide a match that no model judges: with the residuals of the paper, of problems of one's own, and
    several motions. Where poses judge, they are a few proposals among those of the hyper-edges, and seldom matter.

    One that can end early takes ``deadline`` as well, a `rootmatch.deadline.Deadline`; those of this package do.
    """

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """Solve; the same seed gives the same solution, whatever the number of threads."""
        ...


def solve_tensor(solver: Solver, tensor: AffinityTensor, seed: int, deadline: Deadline = NEVER) -> Solution:
    """The solution of a tensor, by the deadline if the solver can keep to one."""
    bounded: Any = solver
    try:
        checkpoint(SECONDS_PER_PAIR * tensor.shape[0] * tensor.shape[1])
        if not deadline.is_set or "deadline" not in signature(solver).parameters:
            solution = bounded(tensor, seed=seed)
        else:
            solution = bounded(tensor, seed=seed, deadline=deadline)
    except OutOfTime:
        return replace(empty_solution(tensor), converged=False)
    if not isinstance(solution, Solution):
        raise InputError(
            f"solver: {quote_value(solver)} returned {type(solution).__name__}; a solver returns a Solution"
        )
    try:
        if np.shape(solution.soft) != tensor.shape:
            raise InputError(f"soft: shape {np.shape(solution.soft)} given, {tensor.shape} expected")
        assignment = check_assignment(solution.assignment, tensor.shape)
        alternatives = [(check_assignment(one, tensor.shape), float(score)) for one, score in solution.alternatives]
    except (InputError, TypeError) as error:
        raise InputError(f"solver: what {quote_value(solver)} returned cannot be used: {error}") from None
    return replace(solution, assignment=assignment, alternatives=alternatives)


def empty_solution(tensor: AffinityTensor) -> Solution:
    """The solution of a tensor without any weight: no point is matched."""
    empty = np.full(tensor.shape[0], -1, np.int64)
    return Solution(np.zeros(tensor.shape), empty, 0.0, [], converged=True, iterations=0)


def is_empty(tensor: AffinityTensor) -> bool:
    """Whether no assignment of this tensor can score; what is no tensor is refused here, where each solver begins."""
    if not isinstance(tensor, AffinityTensor):
        raise InputError(
            f"tensor: {type(tensor).__name__} given; give an AffinityTensor, as from_dense() makes of an array"
        )
    return not tensor.weights.any() and (tensor.unary is None or not tensor.unary.any())
