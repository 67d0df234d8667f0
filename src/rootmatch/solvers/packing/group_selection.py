"""Selection among many groups: disjoint ones of the highest total evidence."""

from __future__ import annotations

from typing import Literal

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import NEVER, Deadline
from rootmatch.solvers.packing.exact_packing import best_packing, find_packing_above, relaxation, round_relaxation

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
        self.maximum = len(groups) if motions == "auto" else int(motions)
        self.elements = np.full((len(groups), 2 * int(self.sizes.max(initial=1))), -1)
        for row, group in zip(self.elements, groups, strict=True):
            points = np.flatnonzero(group >= 0)
            row[: 2 * len(points)] = np.concatenate([points, shape[0] + group[points]])

    def best(self, minimum: int) -> Bools:
        """The selected groups.

        Chance makes so many of the smallest groups that the search would begin poorly among them. So the best groups of
        at least so many points are selected first, and all compete with those.
        """
        chosen = np.zeros(len(self.groups), np.bool_)
        large, every = np.flatnonzero(self.sizes >= minimum), np.arange(len(self.groups))
        for allowed, nodes in ((large, NODES_OF_LARGE), (every, NODES)):
            if len(allowed) == 0:
                continue
            elements, values = self.elements[allowed], self.values[allowed]
            self.relaxed = relaxation(
                elements, values, sum(self.shape), self.maximum, self.deadline.part(RELAXED).left()
            )
            start = round_relaxation(elements, values, self.relaxed, self.maximum)
            if values[start].sum() < self.values[chosen].sum():
                start = chosen[allowed]
            nodes = self.deadline.part(RELAXED).affordable(nodes, SECONDS_PER_NODE)
            found = best_packing(elements, values, self.relaxed, self.maximum, start=start, nodes=nodes)
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
            minimum = self.values[chosen].sum() - RIVAL_VALUE * self.values[number]
            found = np.zeros(len(chosen), np.bool_)
            found[allowed] = find_packing_above(
                minimum, self.elements[allowed], self.relaxed.of(allowed), self.maximum, nodes
            )  # fmt: skip
            other, labels = self.solution(found)
            if ((other >= 0) & (other != best)).any():
                others.append((other, labels))
                lead = min(lead, 1.0 - self.values[found & ~chosen].sum() / self.values[chosen & ~found].sum())
        return others, max(0.0, float(lead))
