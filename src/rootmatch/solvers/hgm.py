"""Probabilistic hypergraph matching by a Kullback–Leibler projection (HGM)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph.assignment import discretise
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.decorators import driver
from rootmatch.jit.threads import LONGEST
from rootmatch.options import Options, option
from rootmatch.solvers.alternatives import best_neighbours
from rootmatch.solvers.base import Solution, empty_solution, is_empty

SECONDS_PER_ENTRY = 5e-9
"""Time that an entry takes in one round of the projection, at most (benchmarks/solvers.py)."""


@dataclass(frozen=True)
class KLProjection(Options):
    """Marginals of the tensor, projected onto the soft assignments.

    Were correspondences independent, the tensor would be the d-fold product of their probabilities; its marginals

        Y_a = Σ_{e∋a} h_e (+ u_a)

    are then proportional to them. The result is the soft assignment nearest in relative entropy:

        min_X Σ_a X_a ln(X_a / Y_a) − X_a + Y_a   with X ≥ 0, rows ≤ 1, columns ≤ 1, Σ X = matches,

    then the Hungarian method. The solution has the form X_ik = Y_ik exp(−λ_i − μ_k − ν), λ, μ ≥ 0; each multiplier in
    turn is set to its best value (successive projections with Bregman's correction), which converges to the optimum.
    One pass over the tensor in all: fast, and the weakest where false hyper-edges outnumber the true.

    Source: Zass and Shashua, Probabilistic graph and hypergraph matching, CVPR 2008, sections 3 and 4.

    Parameters
    ----------
    matches : int, optional
        Expected number of matched points; min(n, n') by default, less if the hyper-edges cannot match as many.
    iterations : int
        Limit of rounds over all multipliers. A round value, not tuned.
    tolerance : float
        Settled when no multiplier changes by more. A round value, not tuned.
    keep : int
        Alternatives to report: the best single changes of the assignment.
    """

    matches: int | None = option(None, minimum=1)
    iterations: int = option(10_000, minimum=1)
    tolerance: float = option(1e-9, minimum=0.0)
    keep: int = option(16, minimum=0)

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0, deadline: Deadline = NEVER) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return empty_solution(tensor)
        y = tensor.marginals()
        if tensor.unary is not None:
            y += tensor.unary
        # More than a matching of the nonzero entries can hold no soft assignment holds either.
        from scipy.sparse import csr_array  # slow to import
        from scipy.sparse.csgraph import maximum_bipartite_matching

        maximum = int(np.sum(maximum_bipartite_matching(csr_array(y > 0)) >= 0))
        matches = maximum if self.matches is None else min(self.matches, maximum)
        limit = deadline.affordable(self.iterations, SECONDS_PER_ENTRY * y.size)
        soft, change, rounds = project(y / y.max(), float(matches), limit, self.tolerance)
        deadline.record_cut(left_out=rounds < self.iterations and change > self.tolerance)
        assignment = discretise(soft)
        return Solution(
            soft=soft,
            assignment=assignment,
            score=tensor.score(assignment),
            alternatives=best_neighbours(tensor, assignment, self.keep),
            converged=bool(change <= self.tolerance),
            iterations=int(rounds),
            statistics={"change": float(change), "matches": float(matches)},
        )


def project(y: Floats, matches: float, iterations: int, tolerance: float) -> tuple[Floats, float, int]:
    """Projection of y ≥ 0 (n, n') in relative entropy, the last change of a logarithm of a factor, and rounds made.

    An interrupt is seen every few rounds.
    """
    # Factors exp(−λ), exp(−μ) ≤ 1 and exp(−ν).
    row, column, scale = np.ones(y.shape[0]), np.ones(y.shape[1]), 1.0
    change, done = np.inf, 0
    together = max(int(LONGEST / (SECONDS_PER_ENTRY * y.size)), 1)
    while done < iterations and change > tolerance:
        scale, change, made = _rounds(y, row, column, scale, matches, min(together, iterations - done), tolerance)
        done += made
    return y * row[:, None] * column * scale, change, done


@driver(error_model="numpy")
def _rounds(  # type: ignore[no-untyped-def]
    y, row, column, scale, matches, iterations, tolerance
) -> tuple[float, float, int]:
    """Rounds over the factors of rows (n,) and columns (n',), changed in place; the scale, and as `project`."""
    n, n_target = y.shape
    change, done = np.inf, 0
    while done < iterations and change > tolerance:
        change = 0.0
        total = 0.0
        for i in range(n):
            line = 0.0
            for k in range(n_target):
                line += y[i, k] * column[k]
            line *= scale
            new = min(1.0, 1.0 / line) if line > 0 else 1.0
            change = max(change, abs(np.log(new / row[i])))
            row[i] = new
        for k in range(n_target):
            line = 0.0
            for i in range(n):
                line += y[i, k] * row[i]
            new = min(1.0, 1.0 / (line * scale)) if line > 0 else 1.0
            change = max(change, abs(np.log(new / column[k])))
            column[k] = new
            total += line * new
        new = matches / total
        change = max(change, abs(np.log(new / scale)))
        scale = new
        done += 1
    return scale, change, done
