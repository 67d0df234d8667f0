"""Multi-start discrete ascent: the default solver."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.kernels.contraction import threads_for
from rootmatch.solvers.discrete_state import State, state_of
from rootmatch.solvers.local_search import climb_from, modifications
from rootmatch.solvers.reweighted_walk import ReweightedWalk
from rootmatch.solvers.solution import Alternatives, Solution, is_empty, nothing
from rootmatch.solvers.subset_index import SubsetIndex, build_index, index_support
from rootmatch.tensor import AffinityTensor

POOL = 4
"""Best supported hyper-edges that are considered, for each start that is made."""

FIRST_ROUND, LARGEST_ROUND = 2, 32
"""Starts made at once. The first few often find the answer, and those inside it are then not made again."""

POLISHED = 12
"""Best optima from which an ascent goes on with exchanges, which would cost most of the time if every ascent did."""

LOOKUPS = 20_000
"""Looked-up subsets that are worth a thread, half a millisecond to some; an ascent takes about 4 C(n, d−1) of them."""

CLAIMED = 0.2
"""A point is claimed by an answer when it gains this fraction of the median."""


@dataclass(frozen=True)
class MultiStartAscent:
    """Ascent of the discrete score from the best supported hyper-edges.

    The objective of an assignment X is the sum of the weights of the hyper-edges inside it and of its unary weights,
    less ``penalty · C(|X|, d)``. The true assignment is its optimum long after power iteration has ceased to find it.

    1. Support of each hyper-edge: the weights of those that share d−1 correspondences with it. Candidates are the best
       supported hyper-edges of all, and the best one of each correspondence.
    2. From a candidate alone, best supported first, the best move (see `local_search`) until none is left. Candidates
       inside an assignment that was found already are passed over, so the starts are different ones. This ends when
       `agreement` of them have come to the best assignment.
       One more ascent starts from a few steps of a reweighted random walk, which sees all hyper-edges at once: the
       better start where every hyper-edge is a little right.
    3. From the best few optima so far, on with exchanges of two points.
    4. From the best assignment with a candidate put in by force, when that could pay: several independent groups of
       points, as moving objects give, are put together in this way. Then step 3 again.

    A point to which no hyper-edge speaks stays unmatched. Strictly monotone, without chance, and the same for any
    number of threads; runs on `numba.get_num_threads()` threads.

    Memory beside the tensor: 8 bytes a hyper-edge for support, and 6 d to 8 d for the index (see `subset_index`); 32 to
    40 at order 4.

    Parameters
    ----------
    starts : int
        Ascents of step 2, and likewise of step 4, at most.
    walk : int
        Steps of the random walk (`ReweightedWalk`), each a pass over the hyper-edges; 0 for none.
    agreement : int
        Ascents to the best assignment, all from different starts, that are enough.
    penalty : float
        Weight that the hyper-edges of a matched point must exceed on average for it to stay matched: the points without
        image are then left out. 0: the plain score of the paper. Meaningful when all hyper-edges are in the tensor.
    keep : int
        Alternatives to report: other optima and single changes of the answer.
    limit : int
        Moves of one ascent.
    """

    starts: int = 200
    walk: int = 15
    agreement: int = 12
    penalty: float = 0.0
    keep: int = 16
    limit: int = 10_000

    def __post_init__(self) -> None:
        if min(self.starts, self.agreement, self.limit) < 1 or min(self.walk, self.keep) < 0:
            raise InputError("MultiStartAscent: expected starts, agreement, limit ≥ 1 and walk, keep ≥ 0")
        if not 0 <= self.penalty < np.inf:
            raise InputError(f"penalty: got {self.penalty}; expected a finite weight ≥ 0")

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return nothing(tensor)
        return self.solve(build_index(tensor))

    def solve(self, index: SubsetIndex) -> Solution:
        """Solve with an index that was built before."""
        search = _Search(self, index)
        search.from_walk()
        search.from_candidates()
        search.polish()
        search.from_best()
        search.polish()
        return search.solution()


class _Search:
    """What one call of the solver has found so far."""

    def __init__(self, options: MultiStartAscent, index: SubsetIndex) -> None:
        self.options, self.index = options, index
        self.candidates, self.rank = _candidates(index, POOL * options.starts)
        self.source, self.target = np.divmod(self.candidates, index.n_target)
        self.found: dict[bytes, tuple[NDArray[np.int64], float]] = {}
        self.reached: dict[bytes, int] = {}
        self.polished: set[bytes] = set()
        self.empty = state_of(index, np.full(index.n, -1, np.int64))
        self.best, self.value = self.empty.image, 0.0
        n = min(index.n, index.n_target)
        self.effort = 4.0 * math.comb(n, index.indices.shape[1] - 1) / LOOKUPS
        self.made, self.moves, self.cut = 0, 0, 0

    def climb(
        self, root: State, bases: NDArray[np.int64], starts: NDArray[np.int32], exchanges: bool = False
    ) -> NDArray[np.int64]:
        """Ascents from bases with starts put in; keeps what is found and returns it, (B, n)."""
        options = self.options
        with threads_for(int(len(starts) * self.effort)):
            images, values, moves = climb_from(
                self.index, root, bases, starts, options.penalty, options.limit, exchanges
            )
        for image, value in zip(images, values, strict=True):
            key = image.tobytes()
            self.found[key] = (image, float(value))
            self.reached[key] = self.reached.get(key, 0) + 1
            if exchanges:
                self.polished.add(key)
            if value > self.value:
                self.best, self.value = image, float(value)
        self.moves += int(moves.sum())
        self.cut += int(np.sum(moves >= options.limit))
        return images

    def from_root(self, root: State, starts: NDArray[np.int32]) -> NDArray[np.int64]:
        """Ascents from the assignment of a state with starts put in."""
        self.made += len(starts)
        return self.climb(root, np.repeat(root.image[None], len(starts), axis=0), starts)

    def inside(self, images: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which candidates lie inside one of some assignments."""
        return np.asarray((images[:, self.source] == self.target).all(axis=2).any(axis=0))

    def from_walk(self) -> None:
        """The single ascent from a random walk, or from nothing, which unary weights alone may make something of."""
        base = self.empty.image
        if self.options.walk > 0:
            index = self.index
            unary = index.unary.reshape(index.n, index.n_target)
            tensor = AffinityTensor.unchecked(index.indices, index.weights, unary.shape, unary)
            base = ReweightedWalk(iterations=self.options.walk, keep=0)(tensor).assignment
        self.made += 1
        self.climb(self.empty, base[None], np.empty((1, 0), np.int32))

    def from_candidates(self) -> None:
        """Step 2."""
        open_ = ~self.inside(np.array([image for image, _ in self.found.values()]))
        size, most = FIRST_ROUND, self.made + self.options.starts
        while open_.any() and self.made < most and self.reached[self.best.tobytes()] < self.options.agreement:
            chosen = _different(self.candidates, np.flatnonzero(open_), min(size, most - self.made))
            open_[chosen] = False
            open_ &= ~self.inside(self.from_root(self.empty, self.candidates[chosen]))
            size = min(2 * size, LARGEST_ROUND)

    def polish(self) -> None:
        """Step 3, until the best assignment itself has been through it."""
        while self.best.tobytes() not in self.polished:
            optima = sorted(self.found.values(), key=lambda pair: (-pair[1], pair[0].tolist()))
            waiting = [image for image, _ in optima if image.tobytes() not in self.polished][:POLISHED]
            self.polished.update(image.tobytes() for image in waiting)
            root = state_of(self.index, self.best)
            self.climb(root, np.array(waiting), np.empty((len(waiting), 0), np.int32), exchanges=True)

    def from_best(self) -> None:
        """Step 4."""
        order = self.candidates.shape[1]
        heaviest = self.index.weights.max(initial=0.0)
        # What a candidate would score with all those that support it, were they one group of points of usual weights.
        usual = heaviest / 2 if heaviest > 0 else 1.0
        promise = usual * _choose(order + self.rank / (order * usual), order)
        untried = np.ones(len(self.candidates), np.bool_)
        most = self.made + self.options.starts
        base = None
        while self.made < most:
            if base is not self.best:
                base = self.best
                root = state_of(self.index, base)
                loss = self._loss(root)
                worth = (promise > loss) & ~self.inside(base[None])
            waiting = np.flatnonzero(untried & worth)
            if waiting.size == 0:
                break
            chosen = _different(self.candidates, waiting, min(LARGEST_ROUND // 2, most - self.made))
            untried[chosen] = False
            self.from_root(root, self.candidates[chosen])

    def _loss(self, state: State) -> NDArray[np.float64]:
        """What each candidate pushes out of an assignment: the gains of the members in its way."""
        of_source, of_target = np.zeros(self.index.n), np.zeros(self.index.n_target)
        matched = np.flatnonzero(state.image >= 0)
        gains = state.gains.reshape(self.index.n, self.index.n_target)
        of_source[matched] = of_target[state.image[matched]] = gains[matched, state.image[matched]]
        stays = state.image[self.source] == self.target
        return np.asarray(np.where(stays, 0.0, of_source[self.source] + of_target[self.target]).sum(axis=1))

    def solution(self) -> Solution:
        """The best assignment found, and how it came about."""
        index, best = self.index, self.best
        gains = np.maximum(state_of(index, best).gains + index.unary, 0.0).reshape(index.n, index.n_target)
        total = gains.sum(axis=1, keepdims=True)
        soft = gains / np.where(total > 0, total, 1.0)
        matched = np.flatnonzero(best >= 0)
        own = np.zeros(index.n)
        own[matched] = gains[matched, best[matched]]
        statistics = {
            "starts": float(self.made),
            "optima": float(len(self.found)),
            "moves": float(self.moves),
            "matched": float(matched.size),
        }
        alternatives = self._alternatives(own >= CLAIMED * np.median(own[matched])) if matched.size else []
        return Solution(soft, best, self.value, alternatives, self.cut == 0, self.moves, statistics)

    def _alternatives(self, claimed: NDArray[np.bool_]) -> Alternatives:
        """The best other assignments; most places go to those that move a claimed point, not only a doubtful one."""
        images, values = modifications(self.index, self.best, self.options.penalty, 4 * self.options.keep)
        for image, value in zip(images, values, strict=True):
            self.found.setdefault(image.tobytes(), (image, float(value)))
        others = [(image, value) for image, value in self.found.values() if (image >= 0).any()]
        others = sorted(others, key=lambda pair: (-pair[1], pair[0].tolist()))
        different: Alternatives = []
        similar: Alternatives = []
        for image, value in others:
            moved = (image >= 0) & (image != self.best)
            if (moved & (self.best >= 0) & claimed).any():
                different.append((image, value))
            elif moved.any():
                similar.append((image, value))
        few = self.options.keep // 4
        chosen = different[: self.options.keep - min(few, len(similar))]
        chosen += similar[: self.options.keep - len(chosen)]
        return sorted(chosen, key=lambda pair: -pair[1])


@njit(cache=True)
def _best_of_each(index, rank):  # type: ignore[no-untyped-def]
    """The hyper-edge of the highest rank that contains each correspondence, −1 for none."""
    best = np.full(index.keys.size, -1, np.int64)
    for e in range(rank.size):
        for p in range(index.indices.shape[1]):
            a = index.indices[e, p]
            if best[a] < 0 or rank[e] > rank[best[a]]:
                best[a] = e
    return best


def _candidates(index: SubsetIndex, count: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Hyper-edges to start from, (P, d), and their rank (support and own weight), best first."""
    rank = index_support(index)
    rank += index.weights
    count = min(count, rank.size)
    best = np.argpartition(-rank, count - 1)[:count] if count else np.empty(0, np.int64)
    each = _best_of_each(index, rank)
    chosen = np.union1d(best, each[each >= 0])
    chosen = chosen[index.weights[chosen] > 0]
    chosen = chosen[np.argsort(-rank[chosen], kind="stable")]
    return index.indices[chosen], rank[chosen]


def _different(candidates: NDArray[np.int32], waiting: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Up to `count` of the waiting candidates, in their order, no two with more than one correspondence in common."""
    chosen: list[int] = []
    taken: list[set[int]] = []
    for number, edge in zip(waiting[: 4 * count].tolist(), candidates[waiting[: 4 * count]].tolist(), strict=True):
        if all(len(other.intersection(edge)) <= 1 for other in taken):
            chosen.append(number)
            taken.append(set(edge))
            if len(chosen) == count:
                break
    return np.array(chosen, np.intp)


def _choose(m: NDArray[np.float64], r: int) -> NDArray[np.float64]:
    """Binomial coefficient of real m ≥ r."""
    return np.asarray(np.prod([(m - q) / (q + 1) for q in range(r)], axis=0))
