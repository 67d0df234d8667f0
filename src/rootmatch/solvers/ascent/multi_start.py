"""The multi-start: where ascents start, step by step, and which optima are kept."""

from __future__ import annotations

import math
from functools import cached_property
from threading import Event

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import NEVER, Deadline, Pace, checkpoint
from rootmatch.jit.threads import GROWTH, LONGEST, in_threads, threads_worth
from rootmatch.solvers.ascent.assignment_state import State, empty_state, objective
from rootmatch.solvers.ascent.local_search import climb, climb_from, scored_neighbours, state_of
from rootmatch.solvers.ascent.options import AscentOptions
from rootmatch.solvers.ascent.random_walk_start import random_walk_start
from rootmatch.solvers.ascent.start_selection import covered, forced, next_starts, packed
from rootmatch.solvers.ascent.stopping import patience, stands_out
from rootmatch.solvers.ascent.subset_index import SubsetIndex, ranked_hyperedges
from rootmatch.solvers.base import Alternatives, Solution
from rootmatch.solvers.rrwhm import ReweightedWalk

LOOKUPS_PER_SUBSET = 4.0
"""An ascent takes about so many look-ups for each C(n, d−1): a measured mean, for estimates of its cost."""
SECONDS_PER_GAIN = 1e-9
"""That a move takes for each of the n n' gains, at least; an ascent makes two moves for each match, at most, mostly."""
SECONDS_PER_LOOKUP = 1e-8
"""That an ascent to a whole assignment takes for each subset of d − 1 of it, at least."""
SHORT = 0.25
"""Part of the time left that an ascent may take, by that estimate, to be made in one piece."""


class MultiStart:
    """One run of `MultiStartAscent` and what it has found so far; its steps are numbered as there."""

    def __init__(self, options: AscentOptions, index: SubsetIndex, deadline: Deadline = NEVER) -> None:
        self.options, self.index = options, index
        self.deadline, self.pace = deadline, Pace(deadline)
        n, n_target, order = index.n, index.n_target, index.indices.shape[1]
        self.starts = min(options.starts, options.starts_per_correspondence * n * n_target)
        self.heaviest = index.weights.max(initial=0.0) or 1.0
        self.density = max(options.core_density * self.heaviest, options.penalty)
        self.found: dict[bytes, tuple[NDArray[np.int64], float]] = {}
        self.reached: dict[bytes, int] = {}
        self.polished: set[bytes] = set()
        self.cores, self.core_values = np.empty((0, n), np.int64), np.empty(0)
        self.state = self.empty = empty_state(index)
        self.best, self.value = self.empty.image, 0.0
        lookups = LOOKUPS_PER_SUBSET * math.comb(min(n, n_target), order - 1)
        self.effort = lookups / options.lookups_per_thread
        read = lookups * (1.0 + index.indices.size / math.comb(n * n_target, order - 1))
        self.patience = patience(options.stopping, n * n_target, read)
        self.made, self.moves, self.cut = 0, 0, 0

    def ascents(
        self, root: State, bases: NDArray[np.int64], penalty: float, exchanges: bool = False
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Ascents from assignments near a state: the optima (B, n) and their objectives (B,); fewer at a deadline."""
        images, values = np.empty((0, self.index.n), np.int64), np.empty(0)
        while len(images) < len(bases):
            # one ascent at least is made whatever the time
            size = self.pace.block(len(bases) - len(images)) or int(self.made == 0)
            if size == 0:
                break
            some = bases[len(images) : len(images) + size]
            threads = threads_worth(int(size * self.effort))
            if self.shortest_ascent > SHORT * self.deadline.left():
                size = 1
                optima, objectives, moves = self.ascent_in_steps(some[0], penalty, exchanges)
            elif self.shortest_ascent > LONGEST:
                optima, objectives, moves = self.ascents_in_steps(some, penalty, exchanges, threads)
            else:
                optima, objectives, moves = climb_from(
                    self.index, root, some, penalty=penalty, limit=self.options.limit, exchanges=exchanges,
                    threads=threads,
                )  # fmt: skip
            self.made += size
            self.moves += int(moves.sum())
            self.cut += int(np.sum(moves >= self.options.limit))
            images, values = (optima, objectives) if size == len(bases) else (
                np.concatenate([images, optima]), np.concatenate([values, objectives])
            )  # fmt: skip
        return images, values

    @property
    def shortest_ascent(self) -> float:
        """Seconds that an ascent to a whole assignment takes, at least."""
        n, n_target = self.index.n, self.index.n_target
        subsets = math.comb(min(n, n_target), self.index.indices.shape[1] - 1)
        return max(2.0 * min(n, n_target) * n * n_target * SECONDS_PER_GAIN, subsets * SECONDS_PER_LOOKUP)

    def ascents_in_steps(
        self, bases: NDArray[np.int64], penalty: float, exchanges: bool, threads: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """Ascents as of `climb_from`, between whose steps an interrupt is seen."""
        images, values, moves = np.empty_like(bases), np.empty(len(bases)), np.empty(len(bases), np.int64)
        stopped = Event()

        def ascend(first: int, last: int) -> None:
            for k in range(first, last):
                found = self.ascent_in_steps(bases[k], penalty, exchanges, stopped)
                (images[k],), (values[k],), (moves[k],) = found

        in_threads(ascend, len(bases), threads, stopped=stopped)
        return images, values, moves

    def ascent_in_steps(
        self, base: NDArray[np.int64], penalty: float, exchanges: bool, stopped: Event | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """One ascent as of `climb_from`, a few moves at a time: it ends where it is at the deadline, or if stopped."""
        state, moves, size, begins = state_of(self.index, base), 0, 1, np.ones(1, np.int64)
        while True:
            began = self.deadline.clock()
            made = climb(self.index, state, begins, penalty=penalty, limit=size, exchanges=exchanges)
            moves += made
            if made < size or moves >= self.options.limit:
                optima, objectives, _ = climb_from(self.index, state, state.image[None], penalty=penalty, limit=0)
                return optima, objectives, np.array([moves])
            if self.deadline.passed() or (stopped and stopped.is_set()):
                break
            each = max((self.deadline.clock() - began) / made, 1e-9)
            longest = min(LONGEST, 0.5 * self.deadline.left())
            size = max(1, min(int(longest / each), GROWTH * size, self.options.limit - moves))
        if stopped is None:
            self.state = state  # which is needed again if it is the best
        return state.image[None].copy(), np.array([objective(self.index, state, penalty)]), np.array([moves])

    def climb(self, root: State, bases: NDArray[np.int64], exchanges: bool = False) -> None:
        """Ascents of the objective itself; the optima are kept."""
        images, values = self.ascents(root, bases, self.options.penalty, exchanges)
        for image, value in zip(images, values.tolist(), strict=True):
            key = image.tobytes()
            self.found[key] = (image, value)
            self.reached[key] = self.reached.get(key, 0) + 1
            if exchanges:
                self.polished.add(key)
            if value > self.value:
                self.best, self.value = image, value

    @cached_property
    def ranked(self) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Candidates, (P, d), and their ranks."""
        return _candidates(self.index, self.options.pool * self.starts)

    @property
    def candidates(self) -> NDArray[np.int32]:
        """Hyper-edges to start from, (P, d), the best supported first."""
        return self.ranked[0]

    @cached_property
    def promise(self) -> NDArray[np.float64]:
        """The score of each candidate with all those that support it, were they one group of usual weights."""
        order, usual = self.index.indices.shape[1], self.options.usual_weight * self.heaviest
        return usual * _choose(order + self.ranked[1] / (order * usual), order)

    def dominates(self) -> bool:
        """Whether the best assignment so far holds so much of all weight that no other can score much more."""
        index, options = self.index, self.options
        return options.penalty == 0.0 and not index.unary.any() and self.value >= options.dominant * index.weights.sum()

    def alone(self, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
        """Assignments (B, n) of some candidates alone."""
        source, target = np.divmod(self.candidates[chosen], self.index.n_target)
        bases = np.full((len(chosen), self.index.n), -1)
        bases[np.arange(len(chosen))[:, None], source] = target
        return bases

    def known(self) -> NDArray[np.int64]:
        """Assignments found, (F, n)."""
        return np.array([image for image, _ in self.found.values()], np.int64).reshape(-1, self.index.n)

    def from_walk(self) -> None:
        """Step 1; without a walk from nothing, of which unary weights alone may make something."""
        steps = self.options.walk
        balancing = ReweightedWalk().balancing * SECONDS_PER_GAIN
        checkpoint(2.0 * steps * balancing * self.index.n * self.index.n_target)
        start = random_walk_start(self.index, steps, self.options.walk_start) if steps else self.empty.image
        self.climb(self.empty, start[None])

    def from_cores(self) -> None:
        """Steps 2 and 3, in rounds: cores are grown, and ascents made from them."""
        options = self.options
        after_walk = min(options.stopping.patience_after_walk, self.patience)
        open_ = self.promise >= options.hopeless * self.value
        grown: dict[bytes, tuple[NDArray[np.int64], float]] = {}
        shared = max(2, self.candidates.shape[1] - 1)
        tried, size, idle, walked = 0, options.first_round, 0, self.value
        images = np.empty((0, self.index.n), np.int64)
        while tried < self.starts and not self.settled():
            if idle >= (self.patience if self.value > walked else after_walk):
                break
            most = min(size, self.starts - tried)
            chosen = next_starts(self.candidates, open_, images, self.index.n_target, least=shared, count=most)
            if chosen.size == 0:
                break
            images, values = self.ascents(self.empty, self.alone(chosen), self.density)
            # The empty one is no core: its candidate was too light for its own penalty.
            new = {image.tobytes(): (image, v) for image, v in zip(images, values.tolist(), strict=True) if v > 0}
            cores, core_values = self.as_cores([pair for key, pair in new.items() if key not in grown])
            grown.update(new)
            before = self.value
            useful = (core_values > options.hopeless * before) & ~covered(cores, self.known())
            if useful.any():
                self.climb(self.empty, cores[useful])
            idle = 0 if self.value > before else idle + len(chosen)
            tried += len(chosen)
            size = min(2 * size, options.largest_round)
        self.cores, self.core_values = self.as_cores(_ranked(grown))

    def as_cores(self, grown: Alternatives) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Assignments (C, n) that were grown, and their objectives (C,)."""
        cores = np.array([image for image, _ in grown], np.int64).reshape(-1, self.index.n)
        sizes = [math.comb(size, self.candidates.shape[1]) for size in (cores >= 0).sum(axis=1).tolist()]
        extra = (self.density - self.options.penalty) * np.array(sizes, np.float64)
        return cores, np.array([value for _, value in grown]) + extra

    def settled(self) -> bool:
        """Whether enough ascents reached the best assignment, or it stands far out among enough others."""
        if self.reached.get(self.best.tobytes(), 0) >= self.options.agreement:
            return True
        values = [value for _, value in self.found.values()]
        return stands_out(self.options.stopping, values, sum(self.reached.values()))

    def from_rivals(self) -> None:
        """The rest of step 3, whether or not the best assignment is settled: its rivals."""
        order = self.candidates.shape[1]
        open_ = self.promise >= self.options.hopeless * self.value
        # Fewer, down to a quarter, where an ascent is expensive.
        most = self.options.rivals
        count = int(min(most, max(most / 4, most / 2 / self.effort)))
        rivals = next_starts(self.candidates, open_, self.known(), self.index.n_target, least=order, count=count)
        if rivals.size:
            self.climb(self.empty, self.alone(rivals))

    def from_packed_cores(self) -> None:
        """The first half of step 4: the cores that contradict none that scores better."""
        self.climb(self.empty, packed(self.cores, self.index.n, self.index.n_target)[None])

    def from_best(self) -> None:
        """The second half of step 4."""
        first = 0
        while first < len(self.cores):
            root = self.state_of_best()
            bases, first = forced(
                root, self.cores, self.core_values, first,
                forced_gain=self.options.forced_gain, count=self.options.largest_round,
            )  # fmt: skip
            if len(bases):
                self.climb(root, bases)

    def polish(self) -> None:
        """Step 5, until the best assignment itself has been through it."""
        while self.best.tobytes() not in self.polished:
            least = self.options.polished_score * self.value
            near = [image for image, value in _ranked(self.found) if value >= least]
            waiting = [image for image in near if image.tobytes() not in self.polished][: self.options.polished]
            if not waiting:  # a deadline came before any ascent
                return
            self.polished.update(image.tobytes() for image in waiting)
            self.climb(self.state_of_best(), np.array(waiting), exchanges=True)

    def state_of_best(self) -> State:
        """The state of the best assignment, kept while it is the best."""
        if not np.array_equal(self.state.image, self.best):
            self.state = state_of(self.index, self.best)
        return self.state

    def solution(self) -> Solution:
        """The best assignment found, its alternatives and statistics."""
        index, best = self.index, self.best
        gains = np.maximum(self.state_of_best().gains + index.unary, 0.0).reshape(index.n, index.n_target)
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
        wanted = matched.size > 0 and self.options.keep > 0
        alternatives = self._alternatives(own >= self.options.claimed * np.median(own[matched])) if wanted else []
        return Solution(
            soft,
            best,
            self.value,
            alternatives,
            converged=self.cut == 0 and not self.deadline.stopped_early,
            iterations=self.moves,
            statistics=statistics,
        )

    def _alternatives(self, claimed: NDArray[np.bool_]) -> Alternatives:
        """The best other assignments; most places go to those that move a claimed point, not only a doubtful one."""
        keep = self.options.keep
        count = self.options.neighbours_per_kept * keep
        images, values = scored_neighbours(self.index, self.state_of_best(), self.options.penalty, count)
        for image, value in zip(images, values, strict=True):
            self.found.setdefault(image.tobytes(), (image, float(value)))
        # Cores are assignments too, which stopped short of being drawn into the best one.
        for core, value in zip(self.cores, self.core_values.tolist(), strict=True):
            self.found.setdefault(core.tobytes(), (core, value))
        ranked = _ranked(self.found)
        images = np.array([image for image, _ in ranked])
        moved = (images >= 0) & (images != self.best)
        matters = (moved & (self.best >= 0) & claimed).any(axis=1)
        similar = np.flatnonzero(moved.any(axis=1) & ~matters)
        doubtful = int(self.options.doubtful_part * keep)
        chosen = np.flatnonzero(matters)[: keep - min(doubtful, len(similar))]
        chosen = np.sort(np.append(chosen, similar[: keep - len(chosen)]))
        return [ranked[number] for number in chosen.tolist()]


def _ranked(kept: dict[bytes, tuple[NDArray[np.int64], float]]) -> Alternatives:
    """Assignments and values, best first; equal ones in an order of their own."""
    return [kept[key] for key in sorted(kept, key=lambda key: (-kept[key][1], key))]


def _candidates(index: SubsetIndex, count: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Hyper-edges to start from, (P, d), and their rank (support and own weight), best first."""
    rank, each = ranked_hyperedges(index)
    count = min(count, rank.size)
    best = np.argpartition(rank, rank.size - count)[rank.size - count :] if count else np.empty(0, np.int64)
    chosen = np.union1d(best, each[each >= 0])
    chosen = chosen[index.weights[chosen] > 0]
    chosen = chosen[np.argsort(-rank[chosen], kind="stable")]
    return index.indices[chosen], rank[chosen]


def _choose(m: NDArray[np.float64], r: int) -> NDArray[np.float64]:
    """Binomial coefficient of real m ≥ r."""
    return np.asarray(np.prod([(m - q) / (q + 1) for q in range(r)], axis=0))
