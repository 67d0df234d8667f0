"""Several groups of points that go together: dense groups found one by one, and the best set of them chosen at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.base import Solution, is_empty, nothing
from rootmatch.solvers.packing.fitted_groups import FittedGroups, GroupFit
from rootmatch.solvers.packing.group_selection import GroupChoice
from rootmatch.solvers.packing.hyperedge_groups import GrownGroups


@dataclass(frozen=True)
class GroupPacking:
    """Disjoint groups of correspondences, each of one motion, that together are the best evidence.

    The sum of all weights, which the other solvers climb, lets weights across the groups count, and with many small
    groups there are more of those by chance than true ones within. Here a group of m correspondences is worth

        (m − d + 1) (log 1/w̄ − ½ mean r²) − m c,

    the logarithm of the likelihood of its motion against chance: a minimal set of d − 1 fixes the motion, and each
    further correspondence agrees within the noise (r² over all C(m, d) hyper-edges; those not in the tensor have the
    gate's) where by chance a hyper-edge has the mean weight w̄; c, the logarithm of the number of images that a point
    may have, is what a correspondence must explain.

    1. Groups grow from single hyper-edges by ascents (`hyperedge_groups`); where whole groups can be fitted, from
       cliques of hyper-edges in every way that their motion allows (`fitted_groups`).
    2. They compete: every point and every image once, at most `motions` groups (set packing; `exact_packing`).

    Parameters
    ----------
    motions : int or "auto"
        Most groups; "auto": as many as are worth it.
    chance : float
        w̄, the mean weight of a random hyper-edge.
    fit : GroupFit, optional
        What is known of whole groups. Then ½ mean r² and log 1/w̄ give way to their χ² and to the weight of a detection
        that is as sure as they are: chance agrees in each hyper-edge for itself, but not in all at once.
    starts : int
        Most hyper-edges that grow.
    columns : int
        Most groups that compete, the most valuable.
    """

    motions: int | Literal["auto"] = "auto"
    chance: float = 1e-3
    fit: GroupFit | None = None
    starts: int = 20_000
    columns: int = 6_000

    def __post_init__(self) -> None:
        if min(self.starts, self.columns) < 1 or not self.chance > 0.0:
            raise InputError("GroupPacking: expected starts, columns ≥ 1 and chance > 0")

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor) or tensor.size == 0:
            return nothing(tensor)
        by_hyperedges = GrownGroups(tensor, self.chance, self.starts)
        source = by_hyperedges if self.fit is None else FittedGroups(tensor, self.fit, by_hyperedges)
        groups, values = self._choose(source)
        packing = GroupChoice(groups, values, tensor.shape, self.motions)
        chosen = packing.best(tensor.order + 2)
        alternatives, lead = packing.without_each(chosen)
        assignment, labels = self._enlarged(*packing.answer(chosen), source, tensor.shape)
        soft = np.zeros(tensor.shape)
        for group, value in zip(groups, values / max(values.max(initial=0.0), 1e-300), strict=True):
            members = np.flatnonzero(group >= 0)
            soft[members, group[members]] = np.maximum(soft[members, group[members]], value)
        ranked = [(other, inside_groups(tensor, other, others)) for other, others in alternatives]
        ranked.sort(key=lambda pair: -pair[1])
        statistics = {
            "starts": float(source.made), "columns": float(len(groups)),
            "evidence": float(values[chosen].sum()), "lead": lead,
        }  # fmt: skip
        return Solution(
            soft, assignment, inside_groups(tensor, assignment, labels), ranked, True, source.made, statistics, labels
        )

    def _choose(self, source: GrownGroups | FittedGroups) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The groups that compete, the most valuable first, and what they are worth."""
        groups = source.groups()
        values = source.worth(groups)
        worth = np.flatnonzero(values > 0.0)
        worth = worth[np.argsort(-values[worth], kind="stable")][: self.columns]
        return groups[worth], values[worth]

    def _enlarged(
        self,
        assignment: NDArray[np.int64],
        labels: NDArray[np.int64],
        source: GrownGroups | FittedGroups,
        shape: tuple[int, int],
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Groups after points that are left have joined where it pays, the most valuable first.

        A true point may be in few hyper-edges: where it lies beside another one, or on one line with two.
        """
        assignment, labels = assignment.copy(), labels.copy()
        groups = [np.where(labels == label, assignment, -1) for label in range(int(labels.max(initial=-1)) + 1)]
        while True:
            points = np.flatnonzero(assignment < 0)
            pixels = np.setdiff1d(np.arange(shape[1]), assignment)
            if not groups or len(points) * len(pixels) == 0:
                return assignment, labels
            best = (0.0, 0, -1, -1)
            pairs = np.array(np.meshgrid(points, pixels, indexing="ij")).reshape(2, -1)
            for label, group in enumerate(groups):
                gain = source.with_each(group, pairs) - source.worth(group[None])[0]
                which = int(np.argmax(gain))
                if gain[which] > best[0]:
                    best = (float(gain[which]), label, int(pairs[0, which]), int(pairs[1, which]))
            if best[2] < 0:
                return assignment, labels
            _, label, point, pixel = best
            groups[label][point] = assignment[point] = pixel
            labels[point] = label


def inside_groups(tensor: AffinityTensor, assignment: NDArray[np.int64], labels: NDArray[np.int64]) -> float:
    """Weight of the hyper-edges that lie inside one of the groups of an assignment, and its unary weight."""
    source, target = np.divmod(tensor.indices, np.int32(tensor.shape[1]))
    first = labels[source]
    within_one = (assignment[source] == target).all(axis=1) & (first == first[:, :1]).all(axis=1)
    matched = np.flatnonzero(assignment >= 0)
    unary = 0.0 if tensor.unary is None else float(tensor.unary[matched, assignment[matched]].sum())
    return float(tensor.weights[within_one].sum()) + unary
