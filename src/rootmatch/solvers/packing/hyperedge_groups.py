"""Groups of one motion each, grown from hyper-edges by ascents; their evidence is that of their hyper-edges."""

from __future__ import annotations

import math
from functools import cached_property

import numba
import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, Deadline, Pace
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.limits import GATE
from rootmatch.solvers.ascent.assignment_state import empty_state
from rootmatch.solvers.ascent.climb import climb_from, state_of
from rootmatch.solvers.ascent.start_selection import lies_within_assignments
from rootmatch.solvers.ascent.subset_index import SubsetIndex, build_index, ranked_hyperedges

Groups = Integers

GATE2 = GATE**2
"""Squared residual that a hyper-edge outside of the tensor is taken to have: that of the gate."""
STARTS = 20_000
"""Maximum number of hyper-edges that grow."""
PER_ROUND = 512
"""Groups grown before those within them are skipped."""
LIMIT = 1_000
"""Moves of one ascent, at most: a safeguard, far above what any takes."""


class HyperedgeGroups:
    """Source of groups, and their evidence, where hyper-edges are all that is known.

    Parameters
    ----------
    tensor : AffinityTensor
    chance_weight : float
        Mean weight of a random hyper-edge.
    deadline : Deadline
        Of the growth.
    """

    def __init__(self, tensor: AffinityTensor, chance_weight: float, deadline: Deadline = NEVER) -> None:
        self.deadline = deadline
        self.tensor, self.order, self.shape = tensor, tensor.order, tensor.shape
        self.chance_weight, self.made = chance_weight, 0

    @cached_property
    def index(self) -> SubsetIndex:
        """Index of the agreement of the hyper-edges, the squared gate less the squared residual."""
        agreement = np.maximum(GATE2 + 2.0 * np.log(np.maximum(self.tensor.weights, 1e-300)), 0.0)
        return build_index(AffinityTensor.unchecked(self.tensor.indices, agreement, self.shape))

    def groups(self) -> Groups:
        """Groups (G, n), −1 for points outside, and each without one of its members.

        From each hyper-edge, the best supported ones first, a group grows by an ascent in which every missing
        hyper-edge costs the mean agreement of one that passes the gate by chance.
        """
        index = self.index
        rank, _ = ranked_hyperedges(index)
        candidates = index.indices[np.argsort(-rank, kind="stable")[:STARTS]]
        empty = empty_state(index)
        found: dict[bytes, Groups] = {}
        threads = numba.get_num_threads()
        waiting = np.arange(len(candidates))
        pace = Pace(self.deadline)
        while len(waiting) and (few := pace.block(min(PER_ROUND, len(waiting)))):
            now, waiting = waiting[:few], waiting[few:]
            bases = np.full((len(now), index.n), -1)
            source, target = np.divmod(candidates[now], index.n_target)
            bases[np.arange(len(now))[:, None], source] = target
            # squared residuals that pass by chance are uniform below the squared gate
            by_chance = 0.5 * GATE2
            ends = climb_from(index, empty, bases, penalty=by_chance, limit=LIMIT, threads=threads)
            self.made += len(now)
            fresh = {image.tobytes(): image for image in ends.images if (image >= 0).sum() > self.order}
            fresh = {key: image for key, image in fresh.items() if key not in found}
            found.update(fresh)
            if fresh:
                known = np.array(list(fresh.values()))
                waiting = waiting[~lies_within_assignments(candidates[waiting], known, index.n_target, self.order)]
        every = np.array(list(found.values()), np.int64).reshape(-1, index.n)
        return distinct_groups(np.concatenate([every, drop_each_member(every[group_sizes(every) > self.order + 1])]))

    def evidence(self, groups: Groups) -> Floats:
        """Evidence of groups (G, n), the logarithm of a likelihood ratio; see `GroupPacking`."""
        return self._evidence(
            group_sizes(groups), np.array([self._agreement(group)[0] for group in groups], np.float64)
        )

    def evidence_with_each(self, group: Groups, pairs: Groups) -> Floats:
        """Evidence of a group (n,) with each of some pairs (2, P) of points and images added."""
        total, gains = self._agreement(group)
        sums = total + gains[pairs[0] * self.index.n_target + pairs[1]]
        return self._evidence(np.full(pairs.shape[1], int((group >= 0).sum()) + 1), sums)

    def _agreement(self, group: Groups) -> tuple[float, Floats]:
        """Summed agreement of the hyper-edges of a group (n,), and what each correspondence (n n',) adds to it."""
        members, gains = np.flatnonzero(group >= 0), state_of(self.index, group).gains
        return float(gains[members * self.index.n_target + group[members]].sum()) / self.order, gains

    def _evidence(self, m: Integers, sums: Floats) -> Floats:
        """Evidence of groups by their number of members and the summed agreement of their hyper-edges."""
        hyperedges = np.array([math.comb(int(size), self.order) for size in m], np.float64)
        squared = GATE2 - sums / hyperedges
        return np.asarray(
            (m - self.order + 1) * (-math.log(self.chance_weight) - 0.5 * squared) - m * match_cost(self.shape)
        )


def match_cost(shape: tuple[int, int]) -> float:
    """Cost c of a correspondence: log of n'!/(n' − n)!, the ways to match all points, for each of them."""
    few, many = min(shape), max(shape)
    return (math.lgamma(many + 1) - math.lgamma(many - few + 1)) / few


def group_sizes(groups: Groups) -> Integers:
    """Members of each group."""
    return np.asarray((groups >= 0).sum(axis=1))


def distinct_groups(groups: Groups) -> Groups:
    """Each group once, in the order in which they come."""
    groups = np.ascontiguousarray(groups)
    first: dict[bytes, int] = {}
    for number, group in enumerate(groups):
        first.setdefault(group.tobytes(), number)
    return groups[list(first.values())]


def drop_each_member(groups: Groups) -> Groups:
    """Each group without each of its members."""
    number, member = np.nonzero(groups >= 0)
    less = groups[number]
    less[np.arange(len(less)), member] = -1
    return less
