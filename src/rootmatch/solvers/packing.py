"""Several groups of points that go together: dense groups found one by one, and the best set of them chosen at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.solvers.discrete_state import empty_state
from rootmatch.solvers.group_choice import GroupChoice
from rootmatch.solvers.local_search import climb_from, state_of
from rootmatch.solvers.selection import within
from rootmatch.solvers.solution import Solution, is_empty, nothing
from rootmatch.solvers.subset_index import SubsetIndex, build_index, index_support
from rootmatch.tensor import AffinityTensor

GATE2 = 3.5**2
"""Squared residual that a hyper-edge outside of the tensor is taken to have."""
CHANCE_AGREEMENT = 0.5 * GATE2
"""GATE2 less the squared residual of a hyper-edge that passes by chance, which is uniform below the gate: its mean."""
ROUND = 512
"""Groups grown between two looks at what they cover."""


class Fit(NamedTuple):
    """How well whole groups fit one motion."""

    chi2: Callable[[NDArray[np.int64]], NDArray[np.float64]]
    """χ² (G,) of groups (G, n)."""
    grown: Callable[[NDArray[np.int64]], NDArray[np.int64]]
    """Groups (G, n) with what their common motion predicts."""
    chance: float
    """Mean of exp(−χ²/2) of a detection anywhere about a point that is known exactly."""


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

    1. From each hyper-edge, the best supported ones first, a group grows by an ascent in which every hyper-edge that is
       missing costs as much as one by chance is worth.
    2. The groups, and each without one of its members, compete (set packing: every point and every image once, at most
       `motions` groups); see `group_choice`.

    Parameters
    ----------
    motions : int or "auto"
        Most groups; "auto": as many as are worth it.
    chance : float
        w̄, the mean weight of a random hyper-edge.
    fit : Fit, optional
        What is known of whole groups. Then ½ mean r² and log 1/w̄ give way to their χ² and to the weight of a detection
        that is as sure as they are: chance agrees in each hyper-edge for itself, but not in all at once.
    starts : int
        Most hyper-edges that grow.
    columns : int
        Most groups that compete, the most valuable.
    patience : int
        Steps without success after which the set is taken for the best.
    """

    motions: int | Literal["auto"] = "auto"
    chance: float = 1e-3
    fit: Fit | None = None
    starts: int = 20_000
    columns: int = 6_000
    patience: int = 3000

    def __post_init__(self) -> None:
        if min(self.starts, self.columns, self.patience) < 1 or not self.chance > 0.0:
            raise InputError("GroupPacking: expected starts, columns, patience ≥ 1 and chance > 0")

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor) or tensor.size == 0:
            return nothing(tensor)
        agreement = np.maximum(GATE2 + 2.0 * np.log(np.maximum(tensor.weights, 1e-300)), 0.0)
        index = build_index(AffinityTensor.unchecked(tensor.indices, agreement, tensor.shape))
        grown, made = self._grown(index)
        groups, values = self._valued(grown, index)
        packing = GroupChoice(groups, values, tensor.shape, self.motions, self.patience)
        chosen = packing.best(tensor.order + 2)
        alternatives, lead = packing.without_each(chosen)
        assignment, labels = self._enlarged(*packing.answer(chosen), index)
        soft = np.zeros(tensor.shape)
        for group, value in zip(groups, values / max(values.max(initial=0.0), 1e-300), strict=True):
            members = np.flatnonzero(group >= 0)
            soft[members, group[members]] = np.maximum(soft[members, group[members]], value)
        ranked = [(other, inside_groups(tensor, other, others)) for other, others in alternatives]
        ranked.sort(key=lambda pair: -pair[1])
        statistics = {
            "starts": float(made), "columns": float(len(groups)), "evidence": float(values[chosen].sum()), "lead": lead,
        }  # fmt: skip
        return Solution(
            soft, assignment, inside_groups(tensor, assignment, labels), ranked, True, made, statistics, labels
        )

    def _grown(self, index: SubsetIndex) -> tuple[NDArray[np.int64], int]:
        """Distinct groups (G, n), −1 for points outside, and how many ascents it took."""
        rank = index_support(index)
        rank += index.weights
        candidates = index.indices[np.argsort(-rank, kind="stable")[: self.starts]]
        order = candidates.shape[1]
        empty = empty_state(index)
        found: dict[bytes, NDArray[np.int64]] = {}
        threads = numba.get_num_threads()
        waiting, made = np.arange(len(candidates)), 0
        while len(waiting):
            now, waiting = waiting[:ROUND], waiting[ROUND:]
            bases = np.full((len(now), index.n), -1)
            source, target = np.divmod(candidates[now], index.n_target)
            bases[np.arange(len(now))[:, None], source] = target
            images, _, _ = climb_from(index, empty, bases, CHANCE_AGREEMENT, 1000, False, threads)
            made += len(now)
            fresh = {image.tobytes(): image for image in images if (image >= 0).sum() > order}
            fresh = {key: image for key, image in fresh.items() if key not in found}
            found.update(fresh)
            if fresh:
                known = np.array(list(fresh.values()))
                waiting = waiting[~within(candidates[waiting], known, index.n_target, order)]
        groups = np.array(list(found.values()), np.int64).reshape(-1, index.n)
        if self.fit is not None and len(groups):
            # a true member may be in few hyper-edges: where it lies beside another one, or on one line with two
            grown = self.fit.grown(groups)
            grown = grown[(grown >= 0).sum(axis=1) > order]
            groups = np.unique(np.concatenate([groups, grown]), axis=0)
        return groups, made

    def _valued(self, groups: NDArray[np.int64], index: SubsetIndex) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Groups and each without one of its members, and what they are worth; only what is worth something."""
        order = index.indices.shape[1]
        sums: dict[bytes, float] = {}
        for group in groups:
            members = np.flatnonzero(group >= 0)
            gains, total = np.zeros(len(members)), 0.0
            if self.fit is None:
                gains = state_of(index, group).gains[members * index.n_target + group[members]]
                total = float(gains.sum()) / order
            sums[group.tobytes()] = total
            if len(members) > order + 1:
                for member, gain in zip(members, gains.tolist(), strict=True):
                    less = group.copy()
                    less[member] = -1
                    sums[less.tobytes()] = total - gain
        images = np.array([np.frombuffer(key, np.int64) for key in sums], np.int64).reshape(-1, index.n)
        values = self._worth(images, np.array(list(sums.values())), index)
        worth = np.flatnonzero(values > 0.0)
        worth = worth[np.argsort(-values[worth], kind="stable")][: self.columns]
        return images[worth], values[worth]

    def _worth(self, images: NDArray[np.int64], sums: NDArray[np.float64], index: SubsetIndex) -> NDArray[np.float64]:
        """What groups (G, n) are worth whose hyper-edges agree by so much in sum."""
        order = index.indices.shape[1]
        m = (images >= 0).sum(axis=1)
        cost = m * match_cost((index.n, index.n_target))
        if self.fit is None:
            squared = GATE2 - sums / binomials(m, order)
            return np.asarray((m - order + 1) * (-math.log(self.chance) - 0.5 * squared) - cost)
        # the pose from all points is surer than from a minimal set, which is worth the last term less
        spread = (order - 1) * np.log(m / (order - 1))
        return np.asarray((m - order + 1) * -math.log(self.fit.chance) - 0.5 * self.fit.chi2(images) - spread - cost)

    def _enlarged(
        self, assignment: NDArray[np.int64], labels: NDArray[np.int64], index: SubsetIndex
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Groups after points that are left have joined where it pays, the most valuable first.

        A true point may be in few hyper-edges: where it lies beside another one, or on one line with two.
        """
        assignment, labels = assignment.copy(), labels.copy()
        order = index.indices.shape[1]
        groups = [np.where(labels == label, assignment, -1) for label in range(int(labels.max(initial=-1)) + 1)]
        while True:
            points = np.flatnonzero(assignment < 0)
            pixels = np.setdiff1d(np.arange(index.n_target), assignment)
            if not groups or len(points) * len(pixels) == 0:
                return assignment, labels
            best = (0.0, 0, -1, -1)
            pairs = np.array(np.meshgrid(points, pixels, indexing="ij")).reshape(2, -1)
            for label, group in enumerate(groups):
                state = state_of(index, group)
                members = np.flatnonzero(group >= 0)
                total = float(state.gains[members * index.n_target + group[members]].sum()) / order
                more = np.repeat(group[None], pairs.shape[1], axis=0)
                more[np.arange(pairs.shape[1]), pairs[0]] = pairs[1]
                now = self._worth(group[None], np.array([total]), index)[0]
                gain = self._worth(more, total + state.gains[pairs[0] * index.n_target + pairs[1]], index) - now
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


def binomials(m: NDArray[np.int64], order: int) -> NDArray[np.float64]:
    """C(m, order) of each m."""
    return np.array([math.comb(int(size), order) for size in m], np.float64)


def match_cost(shape: tuple[int, int]) -> float:
    """c: log of n'!/(n' − n)!, the ways to match all, for each point."""
    few, many = min(shape), max(shape)
    return (math.lgamma(many + 1) - math.lgamma(many - few + 1)) / few
