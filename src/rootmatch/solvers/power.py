"""Tensor power iteration, dense and with ℓ¹ rows: the solver of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.hypergraph.assignment import discretise
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.base import Solution, is_empty, neighbours, nothing


@dataclass(frozen=True)
class PowerIteration:
    """Power iteration for the symmetric affinity tensor, then the Hungarian method.

    With v_a(X) = Σ_{e∋a} h_e Π_{b∈e, b≠a} X_b (`AffinityTensor.contract`):

    * ``"l2"``, dense: X ← v(X) / ‖v(X)‖₂;
    * ``"l1"``, sparse: X = Y∘Y with rows of Y of unit ℓ² norm, so that rows of X sum to 1:
      Y ← Y ∘ v(X), then each row of Y is normalised. Rows are those of the smaller set: columns of Y when n > n',
      rows and then columns when n = n'.

    Both start from equal values. A row without any gain keeps its last values, so it stays finite.

    Source: Duchenne, Bach, Kweon and Ponce, A tensor-based algorithm for high-order graph matching, PAMI 2011,
    algorithms 1 and 2.

    Parameters
    ----------
    normalisation : "l1" or "l2"
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

    normalisation: Literal["l1", "l2"] = "l1"
    bias: float = 0.0
    iterations: int = 200
    tolerance: float = 1e-8
    keep: int = 16

    def __post_init__(self) -> None:
        if self.normalisation not in ("l1", "l2"):
            raise InputError(f"normalisation: got {self.normalisation!r}; expected 'l1' or 'l2'")
        if not (self.bias >= 0 and self.tolerance >= 0 and self.iterations >= 1 and self.keep >= 0):
            raise InputError("PowerIteration: expected bias, tolerance, keep ≥ 0 and iterations ≥ 1")

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return nothing(tensor)
        sparse = self.normalisation == "l1"
        start = _unit_lines(np.ones(tensor.shape), np.ones(tensor.shape)) if sparse else _unit(np.ones(tensor.shape))
        y = start
        change, done = np.inf, 0
        while done < self.iterations and change > self.tolerance:
            v = tensor.contract(y * y if sparse else y)
            if self.bias == 0:
                # Only directions matter; this keeps products of tiny weights from underflow.
                v /= v.max() if v.max() > 0 else 1.0
            if sparse:
                new = _unit_lines(y * v + self.bias * start, y)
                change = np.abs(new * new - y * y).max()
            else:
                new = _unit(v + self.bias * start, y)
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
            soft,
            assignment,
            tensor.score(assignment),
            neighbours(tensor, assignment, self.keep),
            bool(change <= self.tolerance),
            done,
            statistics,
        )


def _unit(v: NDArray[np.float64], last: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Unit ℓ² norm; the last iterate when v is zero."""
    norm = np.linalg.norm(v)
    return v / norm if norm > 0 else (v if last is None else last)


def _unit_lines(y: NDArray[np.float64], last: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows, columns, or rows and then columns (by n and n') of unit ℓ² norm; a line of zeros keeps its last values."""
    n, n_target = y.shape
    for axis in (1, 0) if n == n_target else (1,) if n < n_target else (0,):
        # A line of tiny values must not be lost to the squares in its norm.
        largest = y.max(axis=axis, keepdims=True)
        scaled = y / np.where(largest > 0, largest, 1.0)
        y = np.where(largest > 0, scaled, last)
        norm = np.linalg.norm(y, axis=axis, keepdims=True)
        y = y / np.where(norm > 0, norm, 1.0)
    return y
