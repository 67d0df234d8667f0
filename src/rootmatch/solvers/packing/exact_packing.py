"""Weighted set packing, solved exactly: prices of the linear relaxation, then branch and bound."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.solvers.packing.branch_and_bound import branch_and_bound_packing
from rootmatch.solvers.packing.tabu_search import search_packing

CLOSED = 1e-9
"""Loss, relative to the bound, that is rounding."""
DIGITS = 6
"""Decimals of the relaxed optimum that count when it is rounded; what is beyond is the accuracy of HiGHS."""
PATIENCE = 150
"""Steps without success after which the tabu search that branch and bound begins with ends: without that search the
best packing was missed in 5 of 60 selections among 32 to 40 points and clutter, whose nodes ran out."""
TINY = 1e-300
"""Minimum divisor."""


class Relaxation(NamedTuple):
    """Prices (dual values) of the linear relaxation; no disjoint sets have a higher total value than `bound`."""

    bound: float
    price: Floats
    """(N,) of the elements, not negative."""
    slot_price: float
    """Price of one of the places."""
    loss: Floats
    """(G,) price less value of each set, not negative."""
    part: Floats
    """(G,) of each set in the relaxed optimum."""

    def of(self, some: Integers) -> Relaxation:
        """These prices, for some of the sets."""
        return self._replace(loss=self.loss[some], part=self.part[some])


def relaxation(elements: Integers, values: Floats, count: int, maximum: int, seconds: float = math.inf) -> Relaxation:
    """Prices (by HiGHS) of sets `elements` (G, k), −1 after the last of each, of N = `count` elements.

    Where it takes longer than so many seconds they are rough.
    """
    from scipy.optimize import linprog  # slow to import
    from scipy.sparse import csc_array

    sets = len(values)
    member, place = np.nonzero(elements >= 0)
    rows = np.concatenate([elements[member, place], np.full(sets, count)])
    columns = np.concatenate([member, np.arange(sets)])
    matrix = csc_array((np.ones(len(rows)), (rows, columns)), shape=(count + 1, sets))
    limits = np.append(np.ones(count), maximum)
    solved = linprog(-values, A_ub=matrix, b_ub=limits, bounds=(0.0, None), method="highs-ds",
                     options={} if math.isinf(seconds) else {"time_limit": seconds})  # fmt: skip
    if solved.x is None or solved.status != 0:
        # any prices are a bound: here the value of the best set of each element
        price, part = np.zeros(count + 1), values / max(float(values.max()), TINY)
        np.maximum.at(price, elements[member, place], values[member])
    else:
        price, part = np.maximum(-solved.ineqlin.marginals, 0.0), solved.x
    loss = np.maximum(matrix.T @ price - values, 0.0)
    return Relaxation(float(price @ limits), price[:-1], float(price[-1]), loss, part)


def best_packing(
    elements: Integers, values: Floats, relaxed: Relaxation, maximum: int, start: Bools, nodes: int
) -> Bools:
    """Disjoint sets (G,) of the largest total value, limited in number.

    A set that loses more against the prices than the best packing known cannot be in a better one, so that few sets
    remain to branch on.

    Parameters
    ----------
    elements, values, most
        As in `relaxation`.
    relaxed : Relaxation
        Of these sets or of more.
    start : (G,) bool array
        Disjoint sets to begin with.
    nodes : int
        Most nodes of branch and bound, after which the best packing found so far is returned.
    """
    # the better the start, the quicker is branch and bound
    chosen: Bools = search_packing(elements, values, len(relaxed.price), maximum, start, PATIENCE)
    better = find_packing_above(float(values[chosen].sum()), elements, relaxed, maximum, nodes)
    return better if better.any() else chosen


def find_packing_above(minimum: float, elements: Integers, relaxed: Relaxation, maximum: int, nodes: int) -> Bools:
    """Disjoint sets (G,) of the largest total value found within a number of nodes; none if not above `minimum`."""
    chosen = np.zeros(len(relaxed.loss), np.bool_)
    budget = relaxed.bound - minimum - CLOSED * relaxed.bound
    left = np.flatnonzero(relaxed.loss < budget)
    if len(left) == 0:
        return chosen
    found, _, _ = branch_and_bound_packing(
        elements[left], relaxed.loss[left], relaxed.price, relaxed.slot_price, maximum, budget, nodes
    )
    chosen[left[found]] = True
    return chosen


def round_relaxation(elements: Integers, values: Floats, relaxed: Relaxation, maximum: int) -> Bools:
    """Disjoint sets (G,), those first that the relaxation gives the largest part."""
    chosen = np.zeros(len(values), np.bool_)
    used, held = np.zeros(len(relaxed.price), np.bool_), 0
    for number in np.lexsort((-values, -relaxed.part.round(DIGITS))):
        mine = elements[number][elements[number] >= 0]
        if held < maximum and not used[mine].any():
            used[mine] = True
            held += 1
            chosen[number] = True
    return chosen
