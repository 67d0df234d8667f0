"""Block-coordinate ascent of the multilinear form of the score (the idea of BCAGM)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph.assignment import maximise_total, one_hot
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.options import Options, option
from rootmatch.solvers.alternatives import best_neighbours
from rootmatch.solvers.base import Solution, empty_solution, is_empty

MIN_STEP = 1e-12
"""Improvement over the objective that is rounding."""
CACHED = 64
"""Contractions that are kept. Bounds the memory; not tuned."""


@dataclass(frozen=True)
class BlockCoordinateAscent(Options):
    """Ascent of the score by linear assignment problems, exact in one of several copies of the assignment at a time.

    The score S(x) = Σ_e h_e Π_{a∈e} x_a has a symmetric multilinear form F with F(x, …, x) = S(x). With all blocks but
    one held, F is linear in that block, and the Hungarian method finds its best assignment.

    * Even order d: D = d blocks.
    * Odd order d: D = d + 1 blocks and the form of S(x)·⟨1, x⟩/m, where m = min(n, n') is the number of matched points
      of every assignment, so that its value there is again S(x): the mean of the form of S over all choices of d
      among the D blocks.

    Blocks start equal and soft. They are improved in turn until F stands still. If one of them alone is better, it is
    copied to all. If not, the term α ‖x‖^D is added in the same multilinear form. It is the same for every assignment,
    and for α large enough it makes the objective convex, so that some block alone is at least as good as the mixture
    (max_u S_α(u, …, u) ≥ F_α). α is (1 − 1/d) times the largest marginal, doubled while a mixture still wins. The
    iteration has converged where all blocks agree and none can be improved. F_α never decreases while α is held, and
    the score of the best block so far, which is the result, never at all.

    The form is evaluated by polarisation, from contractions C (`AffinityTensor.contract`) of sums of blocks: at
    order 3, 3 F(·, y, z) = (C(y + z) − C(y) − C(z)) / 2.

    Source: Nguyen, Gautier and Hein, A flexible tensor block coordinate ascent scheme for hypergraph matching, CVPR
    2015. Theirs takes order 3 by the fourth-order lift, as here.

    Parameters
    ----------
    iterations : int
        Limit of rounds over all blocks. A round value, not tuned.
    keep : int
        Alternatives to report: the best single changes of the assignment.
    """

    iterations: int = option(100, minimum=1)
    keep: int = option(16, minimum=0)

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0, deadline: Deadline = NEVER) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return empty_solution(tensor)
        run = _Ascent(tensor)
        done = 0
        while done < self.iterations and not run.settled and (done == 0 or not deadline.passed()):
            run.round()
            done += 1
        best = run.winner
        x = one_hot(best, tensor.shape[1])
        soft = tensor.contract(x)
        # A full assignment may hold pairs that no hyper-edge supports.
        assignment = np.where((soft * x).sum(axis=1) > 0, best, -1)
        total = soft.sum(axis=1, keepdims=True)
        return Solution(
            soft=soft / np.where(total > 0, total, 1.0),
            assignment=assignment,
            score=run.score,
            alternatives=best_neighbours(tensor, assignment, self.keep),
            converged=run.settled,
            iterations=done,
            statistics={"contractions": float(run.contractions), "alpha": run.alpha},
        )


class _Ascent:
    """The blocks, their contractions and the best assignment so far."""

    def __init__(self, tensor: AffinityTensor) -> None:
        self.tensor, self.order = tensor, tensor.order
        self.blocks = self.order + self.order % 2
        n, n_target = tensor.shape
        self.matched = min(n, n_target)
        self.unary = np.zeros(tensor.shape) if tensor.unary is None else tensor.unary
        self.alpha, self.settled, self.contractions = 0.0, False, 0
        self.cache: dict[tuple[bytes, ...], Floats] = {}
        even = np.full(tensor.shape, self.matched / (n * n_target))
        self.x = [even] * self.blocks
        self.key = [b""] * self.blocks
        # The best block so far, and its score.
        self.winner, self.score = np.full(n, -1, np.int64), 0.0

    def round(self) -> None:
        """Improve each block once; agree, or turn to the convex objective, when that leads nowhere."""
        minimum = MIN_STEP * (self.score + self.alpha * self.matched ** (self.blocks // 2))
        improved = False
        for b in range(self.blocks):
            slope = self.gradient(b)
            assignment = maximise_total(slope)  # min(n, n') points, without gain too
            x = one_hot(assignment, self.tensor.shape[1])
            if self.key[b] == b"" or float((slope * (x - self.x[b])).sum()) > minimum:
                self.x[b], self.key[b] = x, assignment.tobytes()
                self.keep_best(b, assignment)
                improved = True
        if improved:
            return
        if len(set(self.key)) == 1:
            self.settled = True
            return
        alone = [self.own_score(b) for b in range(self.blocks)]
        b = int(np.argmax(alone))
        if alone[b] + self.alpha * self.matched ** (self.blocks // 2) > self.value() + minimum:
            self.x, self.key = [self.x[b]] * self.blocks, [self.key[b]] * self.blocks
        elif self.alpha > 0:
            self.alpha *= 2
        else:
            self.alpha = (1 - 1 / self.order) * float(self.tensor.marginals().max() + self.unary.max())

    def keep_best(self, b: int, assignment: Integers) -> None:
        """Keep a block that scores better than all before."""
        score = self.own_score(b)
        if score > self.score:
            self.winner, self.score = assignment, score

    def own_score(self, b: int) -> float:
        """S of one block."""
        x = self.x[b]
        return float((self.contraction((b,)) * x).sum() / self.order + (self.unary * x).sum())

    def contraction(self, blocks: tuple[int, ...]) -> Floats:
        """C of the sum of some blocks, without unary weights; kept, as blocks agree more and more."""
        key = tuple(sorted(self.key[b] for b in blocks))
        if key not in self.cache:
            if len(self.cache) > CACHED:
                self.cache.clear()
            v = self.tensor.contract(np.sum([self.x[b] for b in blocks], axis=0))
            self.cache[key] = v - self.unary
            self.contractions += 1
        return self.cache[key]

    def polarise(self, blocks: tuple[int, ...]) -> Floats:
        """F(·, blocks) of d−1 blocks."""
        count = self.order - 1
        if len({self.key[b] for b in blocks}) == 1:
            return self.contraction(blocks[:1]) / self.order
        total = np.zeros(self.tensor.shape)
        for size in range(1, count + 1):
            sign = (-1) ** (count - size)
            for part in combinations(blocks, size):
                total += sign * self.contraction(part)
        return total / (self.order * math.factorial(count))

    def gradient(self, b: int) -> Floats:
        """Slope of F_α in block b."""
        others = [c for c in range(self.blocks) if c != b]
        parts = list(combinations(others, self.order - 1))
        slope = np.sum([self.polarise(part) for part in parts], axis=0)
        # Odd order: the mean over the D sets of d blocks, of which those with b count here.
        slope = slope / (1 if self.order == self.blocks else self.blocks) + self.unary / self.blocks
        if self.alpha > 0:
            pairings = list(_pairings(others))
            for partner, pairs in pairings:
                product = math.prod(float((self.x[p] * self.x[q]).sum()) for p, q in pairs)
                slope = slope + self.alpha / len(pairings) * product * self.x[partner]
        return np.asarray(slope)

    def value(self) -> float:
        """F_α of all blocks."""
        x = self.x
        sets = list(combinations(range(self.blocks), self.order))
        value = sum(float((self.polarise(part[1:]) * x[part[0]]).sum()) for part in sets) / len(sets)
        value += sum(float((self.unary * y).sum()) for y in x) / self.blocks
        pairings = list(_pairings(list(range(1, self.blocks))))
        for partner, pairs in pairings:
            product = math.prod(float((x[p] * x[q]).sum()) for p, q in pairs)
            value += self.alpha / len(pairings) * product * float((x[0] * x[partner]).sum())
        return value


def _pairings(others: list[int]) -> Iterator[tuple[int, list[tuple[int, int]]]]:
    """All ways to pair a block with one of an odd number of others, and the rest among themselves."""
    for partner in others:
        rest = [c for c in others if c != partner]
        if not rest:
            yield partner, []
            continue
        for second, pairs in _pairings(rest[1:]):
            yield partner, [(rest[0], second), *pairs]
