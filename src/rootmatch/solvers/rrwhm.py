"""Reweighted random walks on the association hypergraph (RRWHM)."""

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

SECONDS_PER_ENTRY = 2e-9
"""Time that an entry takes in one step of Sinkhorn's method."""


@dataclass(frozen=True)
class ReweightedWalk(Options):
    """Random walk among correspondences whose jumps are reweighted towards one-to-one assignments.

    With x ≥ 0 of sum 1 and v_a(x) = Σ_{e∋a} h_e Π_{b∈e, b≠a} x_b:

    1. w = v(x) / Σ v(x);
    2. y = exp(inflation · w / max w), balanced to row and column sums of 1 (Sinkhorn), then to a sum of 1;
    3. x ← walk · w + (1 − walk) · y;

    until ‖Δx‖² < tolerance; then the Hungarian method. For n ≠ n' the larger set gets a slack line that takes what is
    left over, so lines of the smaller set sum to 1 and those of the larger to 1 at most. The published code balances
    both to equal sums instead, outliers too (``slack=False``).

    Source: Lee, Cho and Lee, Hyper-graph matching via reweighted random walks, CVPR 2011, algorithm 1.

    Parameters
    ----------
    walk : float
        Share of the walk against the jump, 0 … 1; as published. 0.8 finds a little more under deformation
        (docs/hypergraph.md).
    inflation : float
        Exponent of the jump, as published. Beyond 300 the exponential leaves the range of numbers whose ratios Sinkhorn
        can balance.
    iterations : int
        Limit; each is one pass over the hyper-edges. As published.
    tolerance : float
        Squared change below which the walk has settled.
    balancing : int
        Limit of Sinkhorn steps in an iteration.
    balanced_to : float
        Error of the row and column sums at which Sinkhorn's steps end.
    slack : bool
        Whether the larger set has a slack line; .651 against .595 at 200 outliers (docs/hypergraph.md).
    keep : int
        Alternatives to report: the best single changes of the assignment.
    """

    walk: float = option(0.2, minimum=0.0, maximum=1.0)
    inflation: float = option(30.0, above=0.0, maximum=300.0)
    iterations: int = option(300, minimum=1)
    tolerance: float = option(1e-6, minimum=0.0)
    balancing: int = option(100, minimum=1)
    balanced_to: float = option(1e-4, minimum=0.0)
    slack: bool = option(True)
    keep: int = option(16, minimum=0)

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0, deadline: Deadline = NEVER) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return empty_solution(tensor)
        x, done, change = self.run_walk(tensor, deadline)
        assignment = discretise(x)
        return Solution(
            soft=x,
            assignment=assignment,
            score=tensor.score(assignment),
            alternatives=best_neighbours(tensor, assignment, self.keep),
            converged=bool(change < self.tolerance),
            iterations=done,
            statistics={"change": change},
        )

    def run_walk(self, tensor: AffinityTensor, deadline: Deadline = NEVER) -> tuple[Floats, int, float]:
        """End of the walk (n, n'), the number of steps, and the squared change of the last step."""
        x = np.full(tensor.shape, 1.0 / (tensor.shape[0] * tensor.shape[1]))
        change, done = np.inf, 0
        while done < self.iterations and change >= self.tolerance and (done == 0 or not deadline.passed()):
            moved = self.walk_step(tensor.contract(x).ravel(), x)
            if moved is None:
                break
            x, change, done = *moved, done + 1
        return x, done, change

    def walk_step(self, w: Floats, x: Floats) -> tuple[Floats, float] | None:
        """The next x (n, n'), by the contraction w (n n',) of this one, and the squared change; None if w is zero."""
        largest = w.max()
        if largest <= 0.0:
            return None
        jump = np.exp(self.inflation * (w / largest)).reshape(x.shape)
        jump = balance_matrix(jump, self.balancing, self.balanced_to, slack=self.slack)
        new = self.walk * (w / w.sum()).reshape(x.shape) + (1.0 - self.walk) * (jump / jump.sum())
        return new, float(((new - x) ** 2).sum())


def balance_matrix(y: Floats, steps: int, tolerance: float = 1e-4, *, slack: bool = True) -> Floats:
    """Positive matrix (n, n') scaled so that lines of the smaller set sum to 1 and those of the larger to at most 1.

    Without `slack` all lines of the larger set sum to the same, which is less than 1.

    Sinkhorn's alternation on the matrix with a slack line, at most `steps` times or until sums are within tolerance.
    """
    wide = y.shape[0] <= y.shape[1]
    # A scale of its own makes no difference.
    out: Floats = np.ascontiguousarray(y if wide else y.T) / y.max()
    row, column, done, more = np.ones(out.shape[0]), np.ones(out.shape[1]), 0, True
    together = max(int(LONGEST / (SECONDS_PER_ENTRY * out.size)), 1)
    while more and done < steps:
        more = not _sinkhorn(out, row, column, slack, min(together, steps - done), tolerance)
        done += together
    out *= row[:, None] * column
    return out if wide else out.T


@driver(error_model="numpy")
def _sinkhorn(y, row, column, with_slack, steps, tolerance):  # type: ignore[no-untyped-def]
    """Factors of rows and of columns that balance a matrix with n ≤ n', and whether they do so within the tolerance.

    Columns' begin at 1, or where earlier steps have come to; the slack row is kept as one factor a column.
    """
    n, n_target = y.shape
    spare = float(n_target - n) if with_slack else 0.0
    column_sum = 1.0 if with_slack else n / n_target
    # y_ik r_i c_k, and the slack row s c_k.
    slack = 1.0
    for _ in range(steps):
        for i in range(n):
            total = 0.0
            for k in range(n_target):
                total += y[i, k] * column[k]
            row[i] = 1.0 / total
        if spare > 0:
            total = 0.0
            for k in range(n_target):
                total += column[k]
            slack = spare / total
        worst = 0.0
        for k in range(n_target):
            total = slack if spare > 0 else 0.0
            for i in range(n):
                total += y[i, k] * row[i]
            worst = max(worst, abs(total * column[k] - column_sum))
            column[k] = column_sum / total
        if worst < tolerance:
            return True
    return False
