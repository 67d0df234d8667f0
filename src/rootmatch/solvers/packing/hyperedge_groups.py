"""Groups of one motion each, grown from hyper-edges by ascents, worth what their hyper-edges say."""

from __future__ import annotations

import math
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.ascent.assignment_state import empty_state
from rootmatch.solvers.ascent.local_search import climb_from, state_of
from rootmatch.solvers.ascent.start_selection import within
from rootmatch.solvers.ascent.subset_index import SubsetIndex, build_index, index_support

Groups = NDArray[np.int64]

GATE2 = 3.5**2
"""Squared residual that a hyper-edge outside of the tensor is taken to have."""
CHANCE_AGREEMENT = 0.5 * GATE2
"""GATE2 less the squared residual of a hyper-edge that passes by chance, which is uniform below the gate: its mean."""
ROUND = 512
"""Groups grown between two looks at what they cover."""


class GrownGroups:
    """Where groups come from, and what they are worth, where hyper-edges are all that is known.

    Parameters
    ----------
    tensor : AffinityTensor
    chance : float
        Mean weight of a random hyper-edge.
    starts : int
        Most hyper-edges that grow.
    """

    def __init__(self, tensor: AffinityTensor, chance: float, starts: int) -> None:
        self.tensor, self.order, self.shape = tensor, tensor.order, tensor.shape
        self.chance, self.starts, self.made = chance, starts, 0

    @cached_property
    def index(self) -> SubsetIndex:
        """Of how well the hyper-edges agree, GATE2 less the squared residual."""
        agreement = np.maximum(GATE2 + 2.0 * np.log(np.maximum(self.tensor.weights, 1e-300)), 0.0)
        return build_index(AffinityTensor.unchecked(self.tensor.indices, agreement, self.shape))

    def groups(self) -> Groups:
        """Groups (G, n), −1 for points outside, and each without one of its members.

        From each hyper-edge, the best supported ones first, a group grows by an ascent in which every hyper-edge that
        is missing costs as much as one by chance is worth.
        """
        index = self.index
        rank = index_support(index)
        rank += index.weights
        candidates = index.indices[np.argsort(-rank, kind="stable")[: self.starts]]
        empty = empty_state(index)
        found: dict[bytes, Groups] = {}
        threads = numba.get_num_threads()
        waiting = np.arange(len(candidates))
        while len(waiting):
            now, waiting = waiting[:ROUND], waiting[ROUND:]
            bases = np.full((len(now), index.n), -1)
            source, target = np.divmod(candidates[now], index.n_target)
            bases[np.arange(len(now))[:, None], source] = target
            images, _, _ = climb_from(index, empty, bases, CHANCE_AGREEMENT, 1000, False, threads)
            self.made += len(now)
            fresh = {image.tobytes(): image for image in images if (image >= 0).sum() > self.order}
            fresh = {key: image for key, image in fresh.items() if key not in found}
            found.update(fresh)
            if fresh:
                known = np.array(list(fresh.values()))
                waiting = waiting[~within(candidates[waiting], known, index.n_target, self.order)]
        every = dict(found)
        for group in found.values():
            members = np.flatnonzero(group >= 0)
            for member in members if len(members) > self.order + 1 else []:
                less = group.copy()
                less[member] = -1
                every.setdefault(less.tobytes(), less)
        return np.array(list(every.values()), np.int64).reshape(-1, index.n)

    def worth(self, groups: Groups) -> NDArray[np.float64]:
        """What groups (G, n) are worth, the logarithm of a likelihood ratio; see `GroupPacking`."""
        sums = np.empty(len(groups))
        for number, group in enumerate(groups):
            members = np.flatnonzero(group >= 0)
            gains = state_of(self.index, group).gains
            sums[number] = float(gains[members * self.index.n_target + group[members]].sum()) / self.order
        return self._of((groups >= 0).sum(axis=1), sums)

    def with_each(self, group: Groups, pairs: Groups) -> NDArray[np.float64]:
        """What a group (n,) is worth with each of some pairs (2, P) of points and images more."""
        members = np.flatnonzero(group >= 0)
        gains = state_of(self.index, group).gains
        total = float(gains[members * self.index.n_target + group[members]].sum()) / self.order
        sums = total + gains[pairs[0] * self.index.n_target + pairs[1]]
        return self._of(np.full(pairs.shape[1], len(members) + 1), sums)

    def _of(self, m: NDArray[np.int64], sums: NDArray[np.float64]) -> NDArray[np.float64]:
        """Worth of groups of so many members whose hyper-edges agree by so much in sum."""
        hyperedges = np.array([math.comb(int(size), self.order) for size in m], np.float64)
        squared = GATE2 - sums / hyperedges
        return np.asarray((m - self.order + 1) * (-math.log(self.chance) - 0.5 * squared) - m * match_cost(self.shape))


def match_cost(shape: tuple[int, int]) -> float:
    """c: log of n'!/(n' − n)!, the ways to match all, for each point."""
    few, many = min(shape), max(shape)
    return (math.lgamma(many + 1) - math.lgamma(many - few + 1)) / few
