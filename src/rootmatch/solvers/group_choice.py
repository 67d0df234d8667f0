"""Which of many groups go together: disjoint ones of the largest total value."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rootmatch.solvers.set_packing import pack


class GroupChoice:
    """Groups that compete, and the disjoint sets of them."""

    def __init__(
        self,
        groups: NDArray[np.int64],
        values: NDArray[np.float64],
        shape: tuple[int, int],
        motions: int | Literal["auto"],
        patience: int,
    ) -> None:
        self.groups, self.values, self.shape, self.patience = groups, values, shape, patience
        self.sizes = (groups >= 0).sum(axis=1)
        self.most = len(groups) if motions == "auto" else int(motions)
        self.elements = np.full((len(groups), 2 * int(self.sizes.max(initial=1))), -1)
        for row, group in zip(self.elements, groups, strict=True):
            points = np.flatnonzero(group >= 0)
            row[: 2 * len(points)] = np.concatenate([points, shape[0] + group[points]])

    def best(self, least: int) -> NDArray[np.bool_]:
        """The chosen groups, by tabu search from two beginnings.

        Chance makes so many of the smallest groups that the search would lose its way among them. One beginning is
        therefore the best set of groups of at least so many points; the other is what the linear relaxation prefers.
        """
        every = np.ones(len(self.groups), np.bool_)
        few = self.sizes >= least
        beginnings = []
        for allowed in (few, every):
            start = self._rounded(allowed)
            if allowed is few:
                nothing_yet = np.zeros(int(few.sum()), np.bool_)
                found = [self._from(few, begin, self.patience) for begin in (nothing_yet, start[few])]
                start = np.zeros(len(self.groups), np.bool_)
                start[few] = max(found, key=lambda one: float(self.values[few][one].sum()))
            beginnings.append(start)
        answers = [self._from(every, start, self.patience // 5) for start in beginnings]
        return max(answers, key=lambda one: float(self.values[one].sum()))

    def _rounded(self, allowed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Disjoint groups, those first that the linear relaxation (by HiGHS) gives the largest part."""
        from scipy.optimize import linprog  # slow to import
        from scipy.sparse import csr_array

        chosen = np.zeros(len(self.groups), np.bool_)
        numbers = np.flatnonzero(allowed)
        if len(numbers) == 0:
            return chosen
        elements = self.elements[numbers]
        group, place = np.nonzero(elements >= 0)
        count = sum(self.shape)
        rows = np.concatenate([elements[group, place], np.full(len(numbers), count)])
        columns = np.concatenate([group, np.arange(len(numbers))])
        matrix = csr_array((np.ones(len(rows)), (rows, columns)), shape=(count + 1, len(numbers)))
        most = np.append(np.ones(count), self.most)
        solved = linprog(-self.values[numbers], A_ub=matrix, b_ub=most, bounds=(0.0, 1.0), method="highs")
        part = np.zeros(len(numbers)) if solved.x is None else solved.x
        used, held = np.zeros(count + 1, np.bool_), 0
        for number in np.lexsort((-self.values[numbers], -part.round(6))):
            mine = elements[number][elements[number] >= 0]
            if held < self.most and not used[mine].any():
                used[mine] = True
                held += 1
                chosen[numbers[number]] = True
        return chosen

    def _from(self, allowed: NDArray[np.bool_], start: NDArray[np.bool_], patience: int) -> NDArray[np.bool_]:
        chosen: NDArray[np.bool_] = pack(
            self.elements[allowed], self.values[allowed], sum(self.shape), self.most, start, patience
        )
        return chosen

    def answer(self, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Assignment and labels of chosen groups, the largest first."""
        assignment, labels = np.full(self.shape[0], -1, np.int64), np.full(self.shape[0], -1, np.int64)
        numbers = np.flatnonzero(chosen)
        for label, number in enumerate(numbers[np.argsort(-self.sizes[numbers], kind="stable")]):
            members = self.groups[number] >= 0
            assignment[members], labels[members] = self.groups[number][members], label
        return assignment, labels

    def without_each(
        self, chosen: NDArray[np.bool_]
    ) -> tuple[list[tuple[NDArray[np.int64], NDArray[np.int64]]], float]:
        """The best answers without each of the chosen groups, nor any that shares half of it, and the least lead.

        The lead is over what takes its place: 1 less the value of the groups that are new over that of those gone.
        """
        others, lead = [], 1.0
        best, _ = self.answer(chosen)
        for number in np.flatnonzero(chosen):
            shared = ((self.groups == self.groups[number]) & (self.groups >= 0)).sum(axis=1)
            allowed = 2 * shared < self.sizes[number]
            start = (chosen & allowed)[allowed]
            found = np.zeros(len(chosen), np.bool_)
            found[allowed] = self._from(allowed, start, self.patience // 20)
            other, labels = self.answer(found)
            if ((other >= 0) & (other != best)).any():
                others.append((other, labels))
                lead = min(lead, 1.0 - self.values[found & ~chosen].sum() / self.values[chosen & ~found].sum())
        return others, max(0.0, float(lead))
