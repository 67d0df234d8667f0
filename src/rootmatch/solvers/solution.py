"""What every solver hands back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rootmatch.assignment import margin, one_hot
from rootmatch.tensor import AffinityTensor

Alternatives = list[tuple[NDArray[np.int64], float]]


@dataclass(frozen=True, eq=False)
class Solution:
    """An assignment, how sure the solver is of it, and how it went.

    Parameters
    ----------
    soft : (n, n') float64
        Soft assignment, non-negative; what it means is the solver's to say.
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
        Figures of the solver's own.
    """

    soft: NDArray[np.float64]
    assignment: NDArray[np.int64]
    score: float
    alternatives: Alternatives
    converged: bool
    iterations: int
    statistics: dict[str, float] = field(default_factory=dict)

    @property
    def margin(self) -> float:
        """Lead over the best alternative: 0 for a tie, 1 when nothing else scores."""
        return margin(self.score, self.alternatives)

    @property
    def status(self) -> str:
        """What became of it, and what to change."""
        if not (self.assignment >= 0).any():
            return "empty: no hyper-edge or unary weight speaks for any pair; give more hyper-edges or a larger rho"
        if not self.converged:
            return f"stopped after {self.iterations} iterations before it settled; raise the solver's limit"
        return "converged"


class Solver(Protocol):
    """A frozen dataclass of options that is called with a tensor."""

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """Solve; the same seed gives the same answer, whatever the number of threads."""
        ...


def nothing(tensor: AffinityTensor) -> Solution:
    """The answer to a tensor without any weight: no point is matched."""
    empty = np.full(tensor.shape[0], -1, np.int64)
    return Solution(np.zeros(tensor.shape), empty, 0.0, [], True, 0)


def is_empty(tensor: AffinityTensor) -> bool:
    """Whether no assignment of this tensor can score."""
    return not tensor.weights.any() and (tensor.unary is None or not tensor.unary.any())


def neighbours(tensor: AffinityTensor, assignment: NDArray[np.int64], keep: int) -> Alternatives:
    """The best modifications of an assignment: one point to a free target, or two points with exchanged targets.

    From one contraction v at the assignment: the first kind changes the score by v_new − v_old exactly; the second by
    v_new − v_old of both points and a term of the hyper-edges that hold both, so the `keep` most promising are scored.
    Best first; an exchange with an unmatched point moves the target over to it.
    """
    n, n_target = tensor.shape
    x = one_hot(assignment, n_target)
    v = tensor.contract(x)
    rows = np.arange(n)
    old = np.where(assignment >= 0, v[rows, assignment], 0.0)

    free = np.flatnonzero(x.sum(axis=0) == 0)
    moves: list[tuple[float, int, int, int]] = []
    matched = np.flatnonzero(assignment >= 0)
    for k in free:
        moves += [(float(v[i, k] - old[i]), int(i), int(k), -1) for i in matched]
    other = np.where(assignment >= 0, v[:, assignment], 0.0)  # other[i, j]: gain of i at the target of j
    exchange = other + other.T - old[:, None] - old[None, :]
    for i in matched:
        partners = rows[(assignment < 0) | (rows > i)]
        moves += [(float(exchange[i, j]), int(i), int(assignment[j]), int(j)) for j in partners]

    found: Alternatives = []
    for _, row, target, partner in sorted(moves, key=lambda move: (-move[0], *move[1:]))[:keep]:
        changed = assignment.copy()
        if partner >= 0:
            changed[partner] = assignment[row]
        changed[row] = target
        found.append((changed, tensor.score(changed)))
    return sorted(found, key=lambda pair: -pair[1])
