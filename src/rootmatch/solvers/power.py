"""Tensor power iteration, dense and with ℓ¹ constraints on rows (the solver of the paper) or on both sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.deadline import NEVER, Deadline
from rootmatch.errors import InputError
from rootmatch.hypergraph.assignment import discretise
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.alternatives import best_neighbours
from rootmatch.solvers.base import Solution, empty_solution, is_empty

Norm = Literal["l1", "l2"]
Normalise = Literal["rows", "both", "smaller"]


@dataclass(frozen=True)
class PowerIteration:
    """Power iteration for the symmetric affinity tensor, then the Hungarian method.

    With v_a(X) = Σ_{e∋a} h_e Π_{b∈e, b≠a} X_b (`AffinityTensor.contract`):

    * ``"l2"``, dense: X ← v(X) / ‖v(X)‖₂;
    * ``"l1"``, sparse: X = Y∘Y, Y ← Y ∘ v(X), then lines of Y are normalised to unit ℓ² norm, so that those of X sum
      to 1. Which lines, ``normalise`` says.

    Both start from equal values. A line without any gain keeps its last values, so it stays finite.

    Source: Duchenne, Bach, Kweon and Ponce, A tensor-based algorithm for high-order graph matching, PAMI 2011,
    algorithms 1 and 2, which have the rows; ``"both"`` and ``"smaller"`` are not theirs.

    Parameters
    ----------
    norm : "l1" or "l2"
    normalise : "rows", "both" or "smaller"
        Lines that the ℓ¹ iteration normalises. ``"rows"``: those of the source points, whatever n and n' are.
        ``"both"``: rows, then columns. ``"smaller"``: of the smaller set; where n = n', rows and then columns. With
        rows alone, as the article has it, several source points may take the same target: where n = n', balancing finds
        far more matches. Not used with ``"l2"``.
    bias : float
        This much of the start value is added to each iterate before it is normalised, as in the authors' own code; it
        revives rows without hyper-edges and makes the result depend on the scale of the weights. The equations have 0.
    iterations : int
        Limit; each is one pass over the hyper-edges.
    tolerance : float
        Settled when no entry of X changes by more, relative to the largest.
    keep : int
        Alternatives to report: the best single changes of the answer.
    """

    norm: Norm = "l1"
    normalise: Normalise = "rows"
    bias: float = 0.0
    iterations: int = 200
    tolerance: float = 1e-8
    keep: int = 16

    def __post_init__(self) -> None:
        if self.norm not in get_args(Norm):
            raise InputError(f"norm: got {self.norm!r}; expected 'l1' or 'l2'")
        if self.normalise not in get_args(Normalise):
            raise InputError(f"normalise: got {self.normalise!r}; expected 'rows', 'both' or 'smaller'")
        if not (self.bias >= 0 and self.tolerance >= 0 and self.iterations >= 1 and self.keep >= 0):
            raise InputError("PowerIteration: expected bias, tolerance, keep ≥ 0 and iterations ≥ 1")

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0, deadline: Deadline = NEVER) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return empty_solution(tensor)
        sparse = self.norm == "l1"
        axes = _normalised_axes(self.normalise, tensor.shape)
        ones = np.ones(tensor.shape)
        start = _normalise_lines(ones, ones, axes) if sparse else _normalise_matrix(ones)
        y = start
        change, done = np.inf, 0
        while done < self.iterations and change > self.tolerance and (done == 0 or not deadline.passed()):
            v = tensor.contract(y * y if sparse else y)
            if self.bias == 0:
                # Only directions matter; this keeps products of tiny weights from underflow.
                v /= v.max() if v.max() > 0 else 1.0
            if sparse:
                new = _normalise_lines(y * v + self.bias * start, y, axes)
                change = np.abs(new * new - y * y).max()
            else:
                new = _normalise_matrix(v + self.bias * start, y)
                change = np.abs(new - y).max() / new.max()
            y = new
            done += 1
        soft = y * y if sparse else y
        assignment = discretise(np.where(tensor.contract(soft) > 0, soft, 0.0))
        statistics = {
            "change": float(change),
            "dead_rows": float(np.sum(tensor.contract(soft).max(axis=1) == 0)),
            "sparsity": float(np.mean(soft.max(axis=1) >= 0.99 * soft.sum(axis=1))),
        }
        return Solution(
            soft=soft,
            assignment=assignment,
            score=tensor.score(assignment),
            alternatives=best_neighbours(tensor, assignment, self.keep),
            converged=bool(change <= self.tolerance),
            iterations=done,
            statistics=statistics,
        )


def _normalise_matrix(v: Floats, last: Floats | None = None) -> Floats:
    """Unit ℓ² norm; the last iterate when v is zero."""
    norm = np.linalg.norm(v)
    return v / norm if norm > 0 else (v if last is None else last)


def _normalised_axes(normalise: Normalise, shape: tuple[int, int]) -> tuple[int, ...]:
    """Axes along which norms are taken: 1 for the norms of rows, 0 for those of columns."""
    n, n_target = shape
    if normalise == "rows":
        return (1,)
    if normalise == "both" or n == n_target:
        return (1, 0)
    return (1,) if n < n_target else (0,)


def _normalise_lines(y: Floats, last: Floats, axes: tuple[int, ...]) -> Floats:
    """Lines along these axes, one axis after another, of unit ℓ² norm; a line of zeros keeps its last values."""
    for axis in axes:
        # A line of tiny values must not be lost to the squares in its norm.
        largest = y.max(axis=axis, keepdims=True)
        scaled = y / np.where(largest > 0, largest, 1.0)
        y = np.where(largest > 0, scaled, last)
        norm = np.linalg.norm(y, axis=axis, keepdims=True)
        y = y / np.where(norm > 0, norm, 1.0)
    return y
