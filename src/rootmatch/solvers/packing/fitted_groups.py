"""Groups of one motion each, grown from cliques of hyper-edges; their evidence is that of a fit of all their points."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, Deadline, Pace
from rootmatch.hypergraph.rows import are_one_to_one, first_rows, row_keys
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems import base
from rootmatch.solvers.packing.hyperedge_groups import (
    Groups,
    HyperedgeGroups,
    distinct_groups,
    drop_each_member,
    group_sizes,
    match_cost,
)

SECONDS_PER_GROUP = 1e-4
"""Time to extend a group in all ways and to evaluate these, at most (benchmarks/matches.py --only motions)."""
MAX_CLIQUES = 2_000_000
"""Cliques beyond which groups grow from single hyper-edges."""
AT_ONCE = 1 << 20
"""Pairs of hyper-edges that are looked at together; it bounds memory. A round value."""
LARGE = 7
"""Members beyond the order from which chance makes no group, so that its parts need not compete."""
SAMPLED, PER_ROUND = 4_096, 512
"""Cliques that grow to large groups, of which each has hundreds; and those that grow before those within large groups
are skipped."""
LEADING = 64
"""Large groups, those of the highest evidence, whose parts are skipped and which are separated from each other."""
PER_SIZE = 30_000
"""Groups of one size that grow further, those of the highest evidence."""
MIN_REST = 0.5
"""Fraction of a group that must remain without another one's points for the rest to compete."""


class GroupFit(NamedTuple):
    """Fits of whole groups, each to one motion."""

    motions: base.Groups
    chance_weight: float
    """Mean of exp(−χ²/2) of a detection anywhere about a position that is known exactly."""


class FittedGroups:
    """Source of groups, and their evidence, where whole groups can be fitted.

    Parameters
    ----------
    tensor : AffinityTensor
    fit : GroupFit
    fallback : HyperedgeGroups
        Source of the groups to be fitted where there are too many cliques.
    deadline : Deadline
        Of the growth.
    """

    def __init__(
        self, tensor: AffinityTensor, fit: GroupFit, fallback: HyperedgeGroups, deadline: Deadline = NEVER
    ) -> None:
        self.deadline = deadline
        self.tensor, self.fit, self.fallback = tensor, fit, fallback
        self.made = 0

    def groups(self) -> Groups:
        """Groups (G, n) with positive evidence, −1 for points outside.

        Growth starts from each clique of d + 1 correspondences. A group that grows at once takes the nearest detection
        to each prediction, which with few points may be the wrong one; so small groups grow in every way that they
        can, one member at a time, as long as their evidence is positive.
        """
        found = cliques(self.tensor.indices, self.tensor.shape, MAX_CLIQUES)
        if found is None:
            groups = self.fallback.groups()
            self.made = self.fallback.made
            grown = self.fit.motions.grown(groups)
            return distinct_groups(np.concatenate([groups, grown[group_sizes(grown) > self.tensor.order]]))
        self.made = len(found)
        groups = groups_from_indices(found, *self.tensor.shape)
        groups = groups[self.evidence(groups) > 0.0]
        large = self._grow_large_groups(groups)
        separated = separate_groups(large[:LEADING])
        return distinct_groups(
            np.concatenate([large, drop_each_member(large), separated, *self._grow_small_groups(groups, large)])
        )

    def _grow_large_groups(self, groups: Groups) -> Groups:
        """Groups so large that chance makes none, those of the highest evidence first, from a sample of the cliques."""
        # in another order than the points', in which neighbours share what grows from them
        waiting = groups[np.random.default_rng(0).permutation(len(groups))[:SAMPLED]]
        large = np.empty((0, groups.shape[1]), np.int64)
        pace = Pace(self.deadline.part(0.5), 8)
        while len(waiting) and (few := pace.block(min(PER_ROUND, len(waiting)))):
            grown = self.fit.motions.grown(waiting[:few])
            grown = grown[group_sizes(grown) >= self.tensor.order + LARGE]
            large = distinct_groups(np.concatenate([large, grown]))
            large = large[np.argsort(-self.evidence(large), kind="stable")]
            waiting = waiting[few:]
            waiting = waiting[shared_counts(waiting, large[:LEADING]) < self.tensor.order]
        return large

    def _grow_small_groups(self, level: Groups, large: Groups) -> list[Groups]:
        """Groups of each size from cliques on, as large as chance makes them."""
        levels = []
        for _ in range(LARGE):
            # one that shares a hyper-edge with a large group is of its motion, with something wrong at the most
            level = level[shared_counts(level, large[:LEADING]) < self.tensor.order]
            levels.append(level)
            if self.deadline.passed():
                break
            level = level[: self.deadline.part(0.3).cut(len(level), SECONDS_PER_GROUP)]
            level = distinct_groups(self.fit.motions.extended(level))
            evidence = self.evidence(level)
            best = np.argsort(-evidence, kind="stable")[:PER_SIZE]
            level = level[best[evidence[best] > 0.0]]
        return levels

    def evidence(self, groups: Groups) -> Floats:
        """Evidence of groups (G, n), the logarithm of a likelihood ratio; see `GroupPacking`."""
        m = group_sizes(groups)
        minimal = self.tensor.order - 1
        # the pose of all points is more certain than that of a minimal set: the last term but one
        spread = minimal * np.log(np.maximum(m, 1) / minimal)
        gain = (m - minimal) * -math.log(self.fit.chance_weight) - 0.5 * self.fit.motions.chi2(groups)
        return np.asarray(gain - spread - m * match_cost(self.tensor.shape))

    def evidence_with_each(self, group: Groups, pairs: Groups) -> Floats:
        """Evidence of a group (n,) with each of some pairs (2, P) of points and images added."""
        more = np.repeat(group[None], pairs.shape[1], axis=0)
        more[np.arange(pairs.shape[1]), pairs[0]] = pairs[1]
        return self.evidence(more)


def cliques(indices: NDArray[np.int32], shape: tuple[int, int], maximum: int) -> NDArray[np.int32] | None:
    """Sets (C, d + 1) of correspondences, ascending, all of whose d-subsets are among the hyper-edges (E, d), d ≥ 2.

    Hyper-edges that differ in their last correspondence alone are joined in pairs, and the other d − 1 subsets of what
    comes of it are looked up (the candidates of frequent item sets; Agrawal & Srikant 1994).

    Returns
    -------
    (C, d + 1) int32 array
        In lexicographic order; None where there are more than ``maximum``, or where a row is no 64-bit number.
    """
    base, d = math.prod(shape), indices.shape[1]
    if float(base) ** d >= 2.0**63:
        return None
    ordered = np.sort(indices, axis=1)
    ordered = ordered[first_rows(ordered, base)]
    keys = row_keys(ordered, base)
    # how many rows after each have its first d − 1 correspondences
    after = np.searchsorted(keys // base, keys // base, side="right") - np.arange(len(keys)) - 1
    ends, total = np.cumsum(after), int(after.sum())
    found, count = [np.empty((0, d + 1), np.int32)], 0
    for begin in range(0, total, AT_ONCE):
        number = np.arange(begin, min(begin + AT_ONCE, total))
        first = np.searchsorted(ends, number, side="right")
        second = first + 1 + number - (ends - after)[first]
        joined = np.column_stack([ordered[first], ordered[second, d - 1]])
        joined = joined[are_one_to_one(joined, shape[1])]
        for left_out in range(d - 1):
            wanted = row_keys(np.delete(joined, left_out, axis=1), base)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            joined = joined[keys[place] == wanted]
        found.append(joined)
        count += len(joined)
        if count > maximum:
            return None
    return np.concatenate(found)


def groups_from_indices(flat: NDArray[np.int32], n: int, n_target: int) -> Groups:
    """Sets (G, m) of flat correspondences as images (G, n) of the points, −1 for none."""
    groups = np.full((len(flat), n), -1, np.int64)
    source, target = np.divmod(flat.astype(np.int64), n_target)
    np.put_along_axis(groups, source, target, axis=1)
    return groups


def shared_counts(groups: Groups, others: Groups) -> Integers:
    """Maximum number of correspondences that each group (G, n) has in common with one of some others (H, n)."""
    maximum = np.zeros(len(groups), np.int64)
    for other in others:
        members = np.flatnonzero(other >= 0)
        np.maximum(maximum, (groups[:, members] == other[members]).sum(axis=1), out=maximum)
    return maximum


def separate_groups(groups: Groups) -> Groups:
    """Each group without what it shares with each of the others: a few points or images of two motions may fit both.

    Where less than `MIN_REST` of the group would be left, it is left out.
    """
    less = []
    for number, group in enumerate(groups):
        others = np.delete(groups, number, axis=0)
        taken = (others >= 0) | (group[None, :, None] == others[:, None, :]).any(axis=2)
        remain = np.where(taken, -1, group[None])
        less.append(remain[(remain >= 0).sum(axis=1) > MIN_REST * (group >= 0).sum()])
    return np.concatenate([*less, groups[:0]])
