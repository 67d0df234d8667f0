"""Weighted set packing, solved exactly (HiGHS): an integer program of the sets that the linear relaxation leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers

CLOSED = 1e-9
"""Loss, relative to the bound, that is rounding."""
DIGITS = 6
"""Decimals of the relaxed optimum that count when it is rounded; what is beyond is the accuracy of HiGHS."""
NODES = 500
"""Nodes of an integer program at most; nearly all take one. A round value; it bounds time."""
TINY = 1e-300
"""Minimum divisor."""


@dataclass(frozen=True, eq=False)
class Packing:
    """Sets that compete for elements, and the linear relaxation of their choice."""

    matrix: Any
    """(N + 1, G) sparse: the elements of each set; in the last row each takes one of the places."""
    limits: Floats
    """(N + 1,) how many of the sets may hold each."""
    values: Floats
    """(G,)."""
    bound: float
    """No disjoint sets have a higher total value."""
    loss: Floats
    """(G,) price (dual value) of its elements and place less value of each set, not negative."""
    part: Floats
    """(G,) of each set in the relaxed optimum."""

    @classmethod
    def of(cls, elements: Integers, values: Floats, count: int, most: int, seconds: float = math.inf) -> Packing:
        """Sets ``elements`` (G, k), −1 after the last of each, of N = ``count`` elements; at most so many are chosen.

        Where the relaxation takes longer than so many seconds the prices are rough.
        """
        from scipy.optimize import linprog  # slow to import
        from scipy.sparse import csc_array

        sets = len(values)
        member, place = np.nonzero(elements >= 0)
        rows = np.concatenate([elements[member, place], np.full(sets, count)])
        columns = np.concatenate([member, np.arange(sets)])
        matrix = csc_array((np.ones(len(rows)), (rows, columns)), shape=(count + 1, sets))
        limits = np.append(np.ones(count), most)
        options = _time_limit(seconds)
        solved = linprog(-values, A_ub=matrix, b_ub=limits, bounds=(0.0, None), method="highs-ds", options=options)
        if solved.x is None or solved.status != 0:
            # any prices are a bound: here the value of the best set of each element
            price, part = np.zeros(count + 1), values / max(float(values.max()), TINY)
            np.maximum.at(price, elements[member, place], values[member])
        else:
            price, part = np.maximum(-solved.ineqlin.marginals, 0.0), solved.x
        loss = np.maximum(matrix.T @ price - values, 0.0)
        return cls(matrix, limits, values, float(price @ limits), loss, part)

    def rounded(self) -> Bools:
        """Disjoint sets (G,), those first that the relaxation gives the largest part."""
        chosen, left = np.zeros(len(self.values), np.bool_), self.limits.copy()
        for number in np.lexsort((-self.values, -self.part.round(DIGITS))):
            held = self.matrix.indices[self.matrix.indptr[number] : self.matrix.indptr[number + 1]]
            if (left[held] > 0.0).all():
                left[held] -= 1.0
                chosen[number] = True
        return chosen

    def best_above(self, least: float, allowed: Bools | None = None, seconds: float = math.inf) -> Bools:
        """Disjoint sets (G,), of those allowed, of the largest total value; none if it is not above ``least``.

        One that loses as much as the bound is above ``least`` is in no such choice. After so many seconds, or `NODES`,
        the best that were found.
        """
        from scipy.optimize import Bounds, LinearConstraint, milp  # slow to import

        chosen, rounding = np.zeros(len(self.values), np.bool_), CLOSED * self.bound
        may_pay = self.loss < self.bound - least - rounding
        (left,) = np.nonzero(may_pay if allowed is None else may_pay & allowed)
        if not len(left):
            return chosen
        solved = milp(
            -self.values[left],
            integrality=np.ones(len(left)),
            bounds=Bounds(0.0, 1.0),
            constraints=LinearConstraint(self.matrix[:, left], ub=self.limits),
            options={"mip_rel_gap": 0.0, "node_limit": NODES, **_time_limit(seconds)},
        )
        if solved.x is not None:
            chosen[left] = solved.x > 0.5
        return chosen if self.values[chosen].sum() > least + rounding else np.zeros_like(chosen)


def _time_limit(seconds: float) -> dict[str, float]:
    """Options of HiGHS."""
    return {} if math.isinf(seconds) else {"time_limit": seconds}
