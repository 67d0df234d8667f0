"""Selection among many groups: disjoint ones of the highest total evidence."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import NEVER, Deadline
from rootmatch.solvers.packing.exact_packing import Packing

RELAXED = 0.5
"""Share of the time left at a deadline that each step of the selection may take."""
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
        self.most = len(groups) if motions == "auto" else int(motions)

    @cached_property
    def packing(self) -> Packing:
        """The groups as sets of points and images."""
        elements = np.full((len(self.groups), 2 * int(self.sizes.max(initial=1))), -1)
        for row, group in zip(elements, self.groups, strict=True):
            points = np.flatnonzero(group >= 0)
            row[: 2 * len(points)] = np.concatenate([points, self.shape[0] + group[points]])
        return Packing.of(elements, self.values, sum(self.shape), self.most, self.deadline.part(RELAXED).left())

    def best(self) -> Bools:
        """The selected groups."""
        if not len(self.groups):
            return np.zeros(0, np.bool_)
        start = self.packing.rounded()
        better = self.packing.best_above(float(self.values[start].sum()), seconds=self.deadline.part(RELAXED).left())
        return better if better.any() else start

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
            shared = ((self.groups == self.groups[number]) & (self.groups >= 0)).sum(axis=1)
            others_than = shared < RIVAL_OVERLAP * np.minimum(self.sizes, self.sizes[number])
            least = float(self.values[chosen].sum() - RIVAL_VALUE * self.values[number])
            found = self.packing.best_above(least, others_than, self.deadline.part(RELAXED).left())
            other, labels = self.solution(found)
            if ((other >= 0) & (other != best)).any():
                others.append((other, labels))
                lead = min(lead, 1.0 - self.values[found & ~chosen].sum() / self.values[chosen & ~found].sum())
        return others, max(0.0, float(lead))
