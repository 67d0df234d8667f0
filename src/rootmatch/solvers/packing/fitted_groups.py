"""Groups of one motion each, from cliques of hyper-edges, worth what the fit of all their points says."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.packing.cliques import cliques
from rootmatch.solvers.packing.hyperedge_groups import GrownGroups, match_cost

Groups = NDArray[np.int64]

MOST_CLIQUES = 2_000_000
"""Cliques beyond which groups are sought otherwise."""
MANY = 7
"""Members beyond the order from which chance makes no group: its parts need not be looked at for themselves."""
SAMPLED, AT_ONCE = 4096, 512
"""Cliques that grow to large groups, each of which has hundreds, and between two looks at what those cover."""
LEADING = 64
"""Large groups, the most valuable ones, whose parts are not looked at, and which are told apart."""
LEVEL = 30_000
"""Groups of one size that grow, those that fit best."""


class GroupFit(NamedTuple):
    """How well whole groups fit one motion."""

    chi2: Callable[[Groups], NDArray[np.float64]]
    """χ² (G,) of groups (G, n)."""
    grown: Callable[[Groups], Groups]
    """Groups (G, n) with all that their common motion predicts."""
    extended: Callable[[Groups], Groups]
    """Groups (E, n), each with one of the correspondences more that its common motion may predict."""
    chance: float
    """Mean of exp(−χ²/2) of a detection anywhere about a point that is known exactly."""


class FittedGroups:
    """Where groups come from, and what they are worth, where whole groups can be fitted.

    Parameters
    ----------
    tensor : AffinityTensor
    fit : GroupFit
    otherwise : GrownGroups
        Groups to be fitted where there are too many cliques to look at.
    """

    def __init__(self, tensor: AffinityTensor, fit: GroupFit, otherwise: GrownGroups) -> None:
        self.tensor, self.fit, self.otherwise = tensor, fit, otherwise
        self.made = 0

    def groups(self) -> Groups:
        """Groups (G, n) that are worth something, −1 for points outside.

        Each clique of d + 1 correspondences is a beginning. What grows from one takes the nearest detection to each
        prediction, which with few points may be the wrong one; so small groups grow in every way that they can, one
        member at a time, as long as they are worth something.
        """
        found = cliques(self.tensor.indices, self.tensor.shape, MOST_CLIQUES)
        if found is None:
            groups = self.otherwise.groups()
            self.made = self.otherwise.made
            grown = self.fit.grown(groups)
            return distinct(np.concatenate([groups, grown[sizes(grown) > self.tensor.order]]))
        self.made = len(found)
        groups = as_groups(found, *self.tensor.shape)
        groups = groups[self.worth(groups) > 0.0]
        large = self._large(groups)
        return distinct(
            np.concatenate([large, without_one(large), apart(large[:LEADING]), *self._small(groups, large)])
        )

    def _large(self, groups: Groups) -> Groups:
        """Groups so large that chance makes none, the most valuable first, from a sample of the cliques."""
        # in another order than the points', in which neighbours share what grows from them
        waiting = groups[np.random.default_rng(0).permutation(len(groups))[:SAMPLED]]
        large = np.empty((0, groups.shape[1]), np.int64)
        while len(waiting):
            grown = self.fit.grown(waiting[:AT_ONCE])
            grown = grown[sizes(grown) >= self.tensor.order + MANY]
            large = distinct(np.concatenate([large, grown]))
            large = large[np.argsort(-self.worth(large), kind="stable")]
            waiting = waiting[AT_ONCE:]
            waiting = waiting[shared(waiting, large[:LEADING]) < self.tensor.order]
        return large

    def _small(self, level: Groups, large: Groups) -> list[Groups]:
        """Groups of each size from cliques on, as large as chance makes them."""
        levels = []
        for _ in range(MANY):
            # one that shares a hyper-edge with a large group is of its motion, with something wrong at the most
            level = level[shared(level, large[:LEADING]) < self.tensor.order]
            levels.append(level)
            level = distinct(self.fit.extended(level))
            worths = self.worth(level)
            best = np.argsort(-worths, kind="stable")[:LEVEL]
            level = level[best[worths[best] > 0.0]]
        return levels

    def worth(self, groups: Groups) -> NDArray[np.float64]:
        """What groups (G, n) are worth, the logarithm of a likelihood ratio; see `GroupPacking`."""
        m = sizes(groups)
        minimal = self.tensor.order - 1
        # the pose from all points is surer than from a minimal set, which is worth the last but one term less
        spread = minimal * np.log(np.maximum(m, 1) / minimal)
        gain = (m - minimal) * -math.log(self.fit.chance) - 0.5 * self.fit.chi2(groups)
        return np.asarray(gain - spread - m * match_cost(self.tensor.shape))

    def with_each(self, group: Groups, pairs: Groups) -> NDArray[np.float64]:
        """What a group (n,) is worth with each of some pairs (2, P) of points and images more."""
        more = np.repeat(group[None], pairs.shape[1], axis=0)
        more[np.arange(pairs.shape[1]), pairs[0]] = pairs[1]
        return self.worth(more)


def as_groups(flat: NDArray[np.int32], n: int, n_target: int) -> Groups:
    """Sets (G, m) of flat correspondences as images (G, n) of the points, −1 for none."""
    groups = np.full((len(flat), n), -1, np.int64)
    source, target = np.divmod(flat.astype(np.int64), n_target)
    np.put_along_axis(groups, source, target, axis=1)
    return groups


def sizes(groups: Groups) -> NDArray[np.int64]:
    """Members of each group."""
    return np.asarray((groups >= 0).sum(axis=1))


def distinct(groups: Groups) -> Groups:
    """Each group once, in the order in which they come."""
    groups = np.ascontiguousarray(groups)
    first: dict[bytes, int] = {}
    for number, group in enumerate(groups):
        first.setdefault(group.tobytes(), number)
    return groups[list(first.values())]


def without_one(groups: Groups) -> Groups:
    """Each group without each of its members."""
    number, member = np.nonzero(groups >= 0)
    less = groups[number]
    less[np.arange(len(less)), member] = -1
    return less


def shared(groups: Groups, others: Groups) -> NDArray[np.int64]:
    """Most correspondences that each group (G, n) has in common with one of some others (H, n)."""
    most = np.zeros(len(groups), np.int64)
    for other in others:
        members = np.flatnonzero(other >= 0)
        np.maximum(most, (groups[:, members] == other[members]).sum(axis=1), out=most)
    return most


def apart(groups: Groups) -> Groups:
    """Each group without what it takes from each of the others: a few points or images of two motions may fit both."""
    less = []
    for number, group in enumerate(groups):
        others = np.delete(groups, number, axis=0)
        taken = (others >= 0) | (group[None, :, None] == others[:, None, :]).any(axis=2)
        remain = np.where(taken, -1, group[None])
        less.append(remain[(remain >= 0).sum(axis=1) * 2 > (group >= 0).sum()])
    return np.concatenate([*less, groups[:0]])
