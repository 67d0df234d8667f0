"""The solver for several motions: groups of correspondences, and the best disjoint set of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.options import Options, option
from rootmatch.solvers.base import Solution, empty_solution, is_empty
from rootmatch.solvers.packing.fitted_groups import FittedGroups, GroupFit
from rootmatch.solvers.packing.group_selection import GroupSelection
from rootmatch.solvers.packing.hyperedge_groups import HyperedgeGroups

GROWN = 0.5
"""Share of a deadline for the growth of groups, and of what is left then for the selection among them."""
SECONDS_PER_GROUP = 1e-5
"""Time for a group that competes, at most (benchmarks/matches.py --only motions)."""
COLUMNS = 6_000
"""Maximum number of groups that compete, those of the highest evidence. Accuracy: benchmarks/accuracy.py."""
LARGE = 2
"""Members beyond the order of a large group, which are selected before all compete."""


@dataclass(frozen=True)
class GroupPacking(Options):
    """Disjoint groups of correspondences, each of one motion, that together are the best evidence.

    The sum of all weights, which the other solvers climb, lets weights across the groups count, and with many small
    groups there are more of those by chance than true ones within. Here the evidence of a group of m correspondences is

        (m − d + 1) (log 1/w̄ − ½ mean r²) − m c,

    the log-likelihood of its motion against chance: a minimal set of d − 1 fixes the motion, and each
    further correspondence agrees within the noise (r² over all C(m, d) hyper-edges; those not in the tensor have the
    gate's) where by chance a hyper-edge has the mean weight w̄; c, the logarithm of the number of images that a point
    may have, is the cost of a correspondence.

    1. Groups grow from single hyper-edges by ascents (`hyperedge_groups`); where whole groups can be fitted, from
       cliques of hyper-edges in every way that their motion allows (`fitted_groups`).
    2. They compete: every point and every image once, at most `motions` groups (set packing; `exact_packing`).

    Parameters
    ----------
    motions : int or "auto"
        Most groups; "auto": as many as have positive evidence.
    chance_weight : float
        w̄, the mean weight of a random hyper-edge.
    fit : GroupFit, optional
        Fits of whole groups, where the problem has them. Then ½ mean r² and log 1/w̄ are replaced by their χ² and by
        the weight of a detection at random: chance agrees in single hyper-edges, but not in all at once.
    """

    motions: Literal["auto"] | int = "auto"
    chance_weight: float = option(1e-3, above=0.0)
    fit: GroupFit | None = None

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0, deadline: Deadline = NEVER) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor) or tensor.size == 0:
            return empty_solution(tensor)
        growing = deadline.part(GROWN)
        by_hyperedges = HyperedgeGroups(tensor, self.chance_weight, growing)
        source: HyperedgeGroups | FittedGroups = by_hyperedges
        if self.fit is not None:
            source = FittedGroups(tensor, self.fit, by_hyperedges, growing)
        groups, values = self._select_competing(source)
        few = deadline.part(GROWN).cut(len(groups), SECONDS_PER_GROUP)
        groups, values = groups[:few], values[:few]
        packing = GroupSelection(groups, values, tensor.shape, self.motions, deadline)
        chosen = packing.best(tensor.order + LARGE)
        alternatives, lead = packing.solutions_without_each(chosen)
        assignment, labels = self._enlarge(*packing.solution(chosen), source, deadline)
        soft = np.zeros(tensor.shape)
        for group, value in zip(groups, values / max(values.max(initial=0.0), 1e-300), strict=True):
            members = np.flatnonzero(group >= 0)
            soft[members, group[members]] = np.maximum(soft[members, group[members]], value)
        ranked = [(other, weight_inside_groups(tensor, other, others)) for other, others in alternatives]
        ranked.sort(key=lambda pair: -pair[1])
        statistics = {
            "starts": float(source.made), "columns": float(len(groups)),
            "evidence": float(values[chosen].sum()), "lead": lead,
        }  # fmt: skip
        score = weight_inside_groups(tensor, assignment, labels)
        return Solution(
            soft, assignment, score, ranked, converged=True, iterations=source.made, statistics=statistics,
            groups=labels,
        )  # fmt: skip

    def _select_competing(self, source: HyperedgeGroups | FittedGroups) -> tuple[Integers, Floats]:
        """The groups that compete, those of the highest evidence first, and their evidence."""
        groups = source.groups()
        values = source.evidence(groups)
        positive = np.flatnonzero(values > 0.0)
        best = positive[np.argsort(-values[positive], kind="stable")][:COLUMNS]
        return groups[best], values[best]

    def _enlarge(
        self, assignment: Integers, labels: Integers, source: HyperedgeGroups | FittedGroups, deadline: Deadline
    ) -> tuple[Integers, Integers]:
        """Groups with the unmatched points added that raise their evidence, those that raise it most first.

        A true point may be in few hyper-edges: where it lies beside another one, or on one line with two.
        """
        assignment, labels = assignment.copy(), labels.copy()
        groups = [np.where(labels == label, assignment, -1) for label in range(int(labels.max(initial=-1)) + 1)]
        while True:
            points = np.flatnonzero(assignment < 0)
            pixels = np.setdiff1d(np.arange(source.tensor.shape[1]), assignment)
            if not groups or len(points) * len(pixels) == 0 or deadline.passed():
                return assignment, labels
            best = (0.0, 0, -1, -1)
            pairs = np.array(np.meshgrid(points, pixels, indexing="ij")).reshape(2, -1)
            for label, group in enumerate(groups):
                gain = source.evidence_with_each(group, pairs) - source.evidence(group[None])[0]
                which = int(np.argmax(gain))
                if gain[which] > best[0]:
                    best = (float(gain[which]), label, int(pairs[0, which]), int(pairs[1, which]))
            if best[2] < 0:
                return assignment, labels
            _, label, point, pixel = best
            groups[label][point] = assignment[point] = pixel
            labels[point] = label


def weight_inside_groups(tensor: AffinityTensor, assignment: Integers, labels: Integers) -> float:
    """Weight of the hyper-edges that lie inside one of the groups of an assignment, and its unary weight."""
    source, target = np.divmod(tensor.indices, np.int32(tensor.shape[1]))
    first = labels[source]
    within_one = (assignment[source] == target).all(axis=1) & (first == first[:, :1]).all(axis=1)
    matched = np.flatnonzero(assignment >= 0)
    unary = 0.0 if tensor.unary is None else float(tensor.unary[matched, assignment[matched]].sum())
    return float(tensor.weights[within_one].sum()) + unary
