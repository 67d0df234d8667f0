"""Selection among many groups: disjoint ones of the highest total evidence."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import NEVER, Deadline
from rootmatch.solvers.packing.branch_and_bound import branch_and_bound_packing
from rootmatch.solvers.packing.tabu_search import search_packing

RELAXED = 0.5
"""Share of the time left at a deadline that each step of the selection may take."""
SECONDS_PER_NODE = 2e-5
"""Time of a node of branch and bound, at most."""
NODES_OF_LARGE, NODES, NODES_OF_RIVALS = 400_000, 50_000, 5_000
"""Nodes for the best large groups, of which some thousand are usual, with the small groups too, and for the replacement
of one group."""
RIVAL_OVERLAP = 0.5
"""Fraction of the smaller of two groups in common from which they are the same one."""
RIVAL_VALUE = 0.5
"""Fraction of a group's evidence below which nothing that could take its place is looked for."""

CLOSED = 1e-9
"""Loss, relative to the bound, that is rounding."""
DIGITS = 6
"""Decimals of the relaxed optimum that count when it is rounded; what is beyond is the accuracy of HiGHS."""
PATIENCE = 150
"""Steps without success after which the tabu search that branch and bound begins with ends: without that search the
best packing was missed in 5 of 60 selections among 32 to 40 points and clutter, whose nodes ran out."""
TINY = 1e-300
"""Minimum divisor."""


class GroupSelection:
    """Groups that compete, and the disjoint sets of them."""

    def __init__(
        self,
        groups: Integers,
        values: Floats,
        shape: tuple[int, int],
        motions: int | Literal["auto"],
        deadline: Deadline = NEVER,
    ) -> None:
        self.deadline = deadline
        self.groups, self.values, self.shape = groups, values, shape
        self.sizes = (groups >= 0).sum(axis=1)
        self.most = len(groups) if motions == "auto" else int(motions)
        self.elements = np.full((len(groups), 2 * int(self.sizes.max(initial=1))), -1)
        for row, group in zip(self.elements, groups, strict=True):
            points = np.flatnonzero(group >= 0)
            row[: 2 * len(points)] = np.concatenate([points, shape[0] + group[points]])

    def best(self, least: int) -> Bools:
        """The selected groups.

        Chance makes so many of the smallest groups that the search would begin poorly among them. So the best groups of
        at least so many points are selected first, and all compete with those.
        """
        chosen = np.zeros(len(self.groups), np.bool_)
        large, every = np.flatnonzero(self.sizes >= least), np.arange(len(self.groups))
        for allowed, nodes in ((large, NODES_OF_LARGE), (every, NODES)):
            if len(allowed) == 0:
                continue
            elements, values = self.elements[allowed], self.values[allowed]
            self.relaxed = relaxation(elements, values, sum(self.shape), self.most, self.deadline.part(RELAXED).left())
            start = round_relaxation(elements, values, self.relaxed, self.most)
            if values[start].sum() < self.values[chosen].sum():
                start = chosen[allowed]
            nodes = self.deadline.part(RELAXED).affordable(nodes, SECONDS_PER_NODE)
            found = best_packing(elements, values, self.relaxed, self.most, start=start, nodes=nodes)
            chosen = np.zeros(len(self.groups), np.bool_)
            chosen[allowed[found]] = True
        return chosen

    def solution(self, chosen: Bools) -> tuple[Integers, Integers]:
        """Assignment and labels of selected groups, the largest first."""
        assignment, labels = np.full(self.shape[0], -1, np.int64), np.full(self.shape[0], -1, np.int64)
        numbers = np.flatnonzero(chosen)
        for label, number in enumerate(numbers[np.argsort(-self.sizes[numbers], kind="stable")]):
            members = self.groups[number] >= 0
            assignment[members], labels[members] = self.groups[number][members], label
        return assignment, labels

    def solutions_without_each(self, chosen: Bools) -> tuple[list[tuple[Integers, Integers]], float]:
        """The best solutions without each of the selected groups, and the least lead.

        A group that has half of the smaller of both in common with the selected one counts as the same. The lead is
        over what takes its place: 1 less the evidence of the new groups over that of those gone. What has less than
        half of the group's evidence is not looked for.
        """
        others: list[tuple[Integers, Integers]] = []
        lead = 1.0
        best, _ = self.solution(chosen)
        for number in np.flatnonzero(chosen):
            if self.deadline.passed():
                return others, 0.0  # what could take its place is not known
            nodes = self.deadline.part(RELAXED).affordable(NODES_OF_RIVALS, SECONDS_PER_NODE)
            shared = ((self.groups == self.groups[number]) & (self.groups >= 0)).sum(axis=1)
            same = RIVAL_OVERLAP * np.minimum(self.sizes, self.sizes[number])
            allowed = np.flatnonzero(shared < same)
            least = self.values[chosen].sum() - RIVAL_VALUE * self.values[number]
            found = np.zeros(len(chosen), np.bool_)
            found[allowed] = find_packing_above(
                least, self.elements[allowed], self.relaxed.of(allowed), self.most, nodes
            )  # fmt: skip
            other, labels = self.solution(found)
            if ((other >= 0) & (other != best)).any():
                others.append((other, labels))
                lead = min(lead, 1.0 - self.values[found & ~chosen].sum() / self.values[chosen & ~found].sum())
        return others, max(0.0, float(lead))


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


def relaxation(elements: Integers, values: Floats, count: int, most: int, seconds: float = math.inf) -> Relaxation:
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
    limits = np.append(np.ones(count), most)
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


def best_packing(elements: Integers, values: Floats, relaxed: Relaxation, most: int, start: Bools, nodes: int) -> Bools:
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
    chosen: Bools = search_packing(elements, values, len(relaxed.price), most, start, PATIENCE)
    better = find_packing_above(float(values[chosen].sum()), elements, relaxed, most, nodes)
    return better if better.any() else chosen


def find_packing_above(least: float, elements: Integers, relaxed: Relaxation, most: int, nodes: int) -> Bools:
    """Disjoint sets (G,) of the largest total value found within a number of nodes; none if it is not above `least`."""
    chosen = np.zeros(len(relaxed.loss), np.bool_)
    budget = relaxed.bound - least - CLOSED * relaxed.bound
    left = np.flatnonzero(relaxed.loss < budget)
    if len(left) == 0:
        return chosen
    found, _, _ = branch_and_bound_packing(
        elements[left], relaxed.loss[left], relaxed.price, relaxed.slot_price, most, budget, nodes
    )
    chosen[left[found]] = True
    return chosen


def round_relaxation(elements: Integers, values: Floats, relaxed: Relaxation, most: int) -> Bools:
    """Disjoint sets (G,), those first that the relaxation gives the largest part."""
    chosen = np.zeros(len(values), np.bool_)
    used, held = np.zeros(len(relaxed.price), np.bool_), 0
    for number in np.lexsort((-values, -relaxed.part.round(DIGITS))):
        mine = elements[number][elements[number] >= 0]
        if held < most and not used[mine].any():
            used[mine] = True
            held += 1
            chosen[number] = True
    return chosen
