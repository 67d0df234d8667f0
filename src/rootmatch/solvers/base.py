"""What every solver hands back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rootmatch.hypergraph.assignment import margin, one_hot
from rootmatch.hypergraph.tensor import AffinityTensor

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
    groups : (n,) int64, optional
        Which of several groups each point belongs to, −1 where unmatched, from a solver that tells them apart.
    """

    soft: NDArray[np.float64]
    assignment: NDArray[np.int64]
    score: float
    alternatives: Alternatives
    converged: bool
    iterations: int
    statistics: dict[str, float] = field(default_factory=dict)
    groups: NDArray[np.int64] | None = None

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

    An exchange with an unmatched point moves the target over to it. Best first, exactly scored, from one contraction v
    at the assignment and one pass for pairs: with P the weight of the hyper-edges inside that contain both points, and
    Q of those that an exchange would bring, it changes the score by Σ v_new − Σ v_old + P + Q.
    """
    n, n_target = tensor.shape
    if keep == 0 or not (assignment >= 0).any():
        return []
    x = one_hot(assignment, n_target)
    v = tensor.contract(x)
    matched = assignment >= 0
    old = np.where(matched, v[np.arange(n), assignment], 0.0)
    order = tensor.order
    score = float((old if tensor.unary is None else old + (order - 1) * (tensor.unary * x).sum(axis=1)).sum()) / order

    # to_free[i, k]: point i to target k; theirs[i, j]: point i to the target of j.
    to_free = np.where(matched[:, None] & (x.sum(axis=0) == 0), v - old[:, None], -np.inf)
    theirs = np.where(matched, v[:, assignment], 0.0)
    exchange = theirs + theirs.T - old[:, None] - old[None, :]
    exchange += _pair_weights(tensor.indices, tensor.weights, assignment, n_target)
    usable = matched[:, None] & (~matched[None, :] | np.triu(np.ones((n, n), np.bool_), 1))
    changes = np.concatenate([to_free.ravel(), np.where(usable, exchange, -np.inf).ravel()])

    found: Alternatives = []
    for place in np.argsort(-changes, kind="stable")[:keep].tolist():
        if changes[place] == -np.inf:
            break
        changed = assignment.copy()
        if place < n * n_target:
            changed[place // n_target] = place % n_target
        else:
            pair = list(divmod(place - n * n_target, n))
            changed[pair] = assignment[pair[::-1]]
        found.append((changed, score + float(changes[place])))
    return found


@njit(cache=True)
def _pair_weights(indices: NDArray[Any], weights: NDArray[Any], image: NDArray[Any], n_target: int) -> NDArray[Any]:
    """P + Q of each pair of points (n, n): hyper-edges inside with both, and those with their targets exchanged."""
    n, order = image.size, indices.shape[1]
    total = np.zeros((n, n))
    for e in range(weights.size):
        inside, first, second = 0, -1, -1
        for p in range(order):
            a = indices[e, p]
            if image[a // n_target] == a % n_target:
                inside += 1
            else:
                first, second = second, a
        if inside == order:
            for p in range(order):
                for q in range(order):
                    if p != q:
                        total[indices[e, p] // n_target, indices[e, q] // n_target] += weights[e]
        elif inside == order - 2:
            i, j = first // n_target, second // n_target
            if image[i] == second % n_target and image[j] == first % n_target:
                total[i, j] += weights[e]
                total[j, i] += weights[e]
    return total
