"""Checks of a derived polynomial on exact instances: correctness, shared variable, number of constraints."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.derivation.instances import Instance
from rootmatch.errors import RootmatchError
from rootmatch.problems.derived.evaluator import Evaluator
from rootmatch.problems.derived.text import root_order

Order = tuple[int, ...]
TOLERANCE = 1e-6
"""Value at the true root, relative to the sum of the terms' sizes, that counts as zero."""
INDEPENDENT = 1e-4
"""Singular value of the constraints' unit gradients above which they count as independent."""
TIE = 1.0 - 1e-6
"""Share of the greatest one from which another is as good."""


class Judge:
    """Looks at exact hyper-edges through a derived polynomial."""

    def __init__(self, evaluator: Evaluator, cases: Sequence[Instance]) -> None:
        self.evaluator = evaluator
        self.cases = cases
        self.source = np.array([case.source for case in cases])
        self.target = np.array([case.target for case in cases])
        self.m = int(evaluator.plan["minimal"])
        self.first: Order = tuple(range(self.m))
        self.swept: Order = (*range(self.m - 1), self.m)
        self.truth = [self._true_root(case) for case in cases]

    def polynomial(self, case: Instance, order: Order) -> Floats:
        """Coefficients of the minimal set in that order."""
        places = list(order)
        return np.asarray(self.evaluator.coefficients(case.source[None, places], case.target[None, places])[0])

    def relative_size_at(self, coefficients: Floats, x: float) -> float:
        """Value at x over the sum of the terms' sizes."""
        powers = x ** np.arange(len(coefficients) - 1, -1, -1)
        return float(abs(coefficients @ powers) / max(np.abs(coefficients) @ np.abs(powers), 1e-300))

    def _true_root(self, case: Instance) -> float:
        if case.shared is not None:
            return case.shared
        return self._partner(case, self.first, self.swept)

    def vanishes(self, order: Order) -> bool:
        """Whether the set in that order has the true root, in nearly all cases (one may be degenerate)."""
        values = [
            self.relative_size_at(self.polynomial(c, order), x) for c, x in zip(self.cases, self.truth, strict=True)
        ]
        return bool(np.mean(np.nan_to_num(values, nan=1.0) < TOLERANCE) >= 0.8)

    def shared_count(self) -> int:
        """How many of the first correspondences the variable belongs to; 0 where it belongs to all.

        Raises `RootmatchError` if the polynomial does not vanish at the truth, or two minimal sets do not share it.
        """
        if not self.vanishes(self.first):
            raise RootmatchError(
                "check: the polynomial does not vanish on exact instances; the equations and the sampler (or the "
                "unknowns named) do not describe the same problem"
            )
        if not self.vanishes(self.swept):
            raise RootmatchError(
                "check: two minimal sets with all but the last correspondence in common have no root in common; choose "
                "a shared variable that belongs to the first correspondences, or to all"
            )
        for kept in range(self.m):
            rest = list(range(kept, self.m + 1))[::-1]
            if self.vanishes((*range(kept), *rest[: self.m - kept])):
                return kept
        return self.m - 1

    def check_wrong_sets(self, rng: np.random.Generator, surplus: int | None) -> None:
        """Refuse a polynomial whose resultant vanishes for any points.

        ``surplus``: constraints of a minimal set beyond those that determine its unknowns, where they are known.
        """
        values, at_truth = [], []
        for case, x in zip(self.cases, self.truth, strict=True):
            target = case.target.copy()
            target[-1] = self.evaluator.target.sample(rng, 1)[0]
            wrong = Instance(case.source, target, None)
            p, q = self.polynomial(wrong, self.first), self.polynomial(wrong, self.swept)
            values.append(min((self.relative_size_at(q, root) for root in np.roots(p)), default=1.0))
            at_truth.append(self.relative_size_at(q, x))
        if np.median(at_truth) < TOLERANCE and surplus:
            raise RootmatchError(
                f"minimal: {self.m} correspondences over-determine the unknowns (constraints left over: {surplus}), "
                f"and the polynomial does not depend on the last one; give minimal={self.m - 1}"
            )
        if np.median(values) < TOLERANCE:
            raise RootmatchError(
                "check: minimal sets with a wrong correspondence share a root too, one that elimination brought in; "
                "state the equations otherwise, or eliminate in another order"
            )

    def gradients(self, order: Order, shared: int) -> list[Floats]:
        """Unit derivative of a constraint in all noise, for each case; the root of its own minimal set moves."""
        base = root_order(order) if shared else self.first
        roots = np.array(self.truth)
        if base != self.first:
            roots = np.array([self._partner(case, base, order) for case in self.cases])
        (slope_p, row_p), (slope_q, row_q) = (self._noise_rows(places, roots) for places in (base, order))
        with np.errstate(all="ignore"):
            moved = (slope_q / slope_p)[:, None] * row_p
            total = row_q - moved
            norm = np.linalg.norm(total, axis=1)
            # what cancels to rounding is the same constraint over again
            size = np.linalg.norm(row_q, axis=1) + np.linalg.norm(moved, axis=1)
            usable = np.isfinite(size) & (norm > 1e-7 * size)
            return list(np.where(usable[:, None], total / norm[:, None], 0.0))

    def _noise_rows(self, places: Order, roots: Floats) -> tuple[Floats, Floats]:
        """Slope at a root of each case and derivatives in the noise of all correspondences, flat."""
        index = list(places)
        _, slope, partial = self.evaluator.partials(roots, self.source[:, index], self.target[:, index])
        rows = np.zeros((len(roots), self.m + 1, partial.shape[-1]))
        rows[:, index] = partial
        return slope, rows.reshape(len(roots), -1)

    def _partner(self, case: Instance, base: Order, order: Order) -> float:
        """The real root of one order that is the nearest to one of another."""
        roots = np.roots(self.polynomial(case, base))
        other = self.polynomial(case, order)
        real = [float(r.real) for r in roots if abs(r.imag) < 1e-6 * (1.0 + abs(r))]
        return min(real, key=lambda x: self.relative_size_at(other, x), default=float("nan"))

    def constraints(self, shared: int, maximum: int | None) -> tuple[Order, ...]:
        """Orders of minimal sets whose polynomials are independent constraints of a hyper-edge, the first one given.

        Sets that bind the first correspondences alone come before others: they are computed once for many hyper-edges.
        """
        heads = list(permutations(range(self.m), self.m - 1))
        swept = [(*head, self.m) for head in heads]
        bound = [] if shared else [order for order in permutations(range(self.m)) if order != self.first]
        chosen: list[Order] = [self.swept]
        rows = [self.gradients(self.swept, shared)]
        for group in (bound, swept):
            candidates = {order: self.gradients(order, shared) for order in group if order not in chosen}
            while candidates and (maximum is None or len(chosen) < maximum):
                scores = {order: self._independence([*rows, new]) for order, new in candidates.items()}
                greatest = max(scores.values())
                if greatest < INDEPENDENT:
                    break
                # orders that say the same differ by rounding alone, which must not choose among them
                best = next(order for order, score in scores.items() if score >= TIE * greatest)
                chosen.append(best)
                rows.append(candidates.pop(best))
        return tuple(sorted(chosen, key=lambda order: self.m in order))

    def _independence(self, rows: list[list[Floats]]) -> float:
        minimum = []
        for stacked in zip(*rows, strict=True):
            matrix = np.array(stacked)
            usable = np.all(np.isfinite(matrix)) and matrix.shape[0] <= matrix.shape[1]
            minimum.append(np.linalg.svd(matrix, compute_uv=False)[-1] if usable else 0.0)
        return float(np.median(minimum))
