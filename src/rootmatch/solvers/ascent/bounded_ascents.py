"""Ascents one after the other: within a deadline, within a number of reads, and so that an interrupt is seen."""

from __future__ import annotations

import math
from threading import Event

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, Deadline, Pace
from rootmatch.jit.threads import GROWTH, LONGEST, run_in_threads, worthwhile_threads
from rootmatch.solvers.ascent.assignment_state import State, empty_state, objective
from rootmatch.solvers.ascent.climb import Ascended, climb, climb_from, state_of
from rootmatch.solvers.ascent.options import AscentOptions
from rootmatch.solvers.ascent.subset_index import SubsetIndex

LOOKUPS_PER_SUBSET = 4.0
"""An ascent takes about so many look-ups for each C(n, d−1): a measured mean, for estimates of its cost."""
LOOKUPS_PER_THREAD = 20_000
"""Those that are worth a thread, half a millisecond to some. Changes no result."""
SECONDS_PER_GAIN = 1e-9
"""That a move takes for each of the n n' gains, at least; an ascent makes two moves for each match, at most, mostly."""
SECONDS_PER_READ = 5e-8
"""That a read of an index takes which no cache holds, about: .05 to .17 µs (benchmarks/solvers.py --large)."""
SHORT = 0.25
"""Part of the time left that an ascent may take, by that estimate, to be made in one piece."""


class BoundedAscents:
    """Makes the ascents of one run of `MultiStartAscent`, and counts what they take."""

    def __init__(self, options: AscentOptions, index: SubsetIndex, deadline: Deadline = NEVER) -> None:
        self.options, self.index = options, index
        self.deadline, self.pace = deadline, Pace(deadline)
        n, n_target, order = index.n, index.n_target, index.indices.shape[1]
        maximum = min(n, n_target)
        subsets = math.comb(maximum, order - 1)
        usual = 1.0 + index.indices.size / math.comb(n * n_target, order - 1)
        self.effort = LOOKUPS_PER_SUBSET * subsets / LOOKUPS_PER_THREAD
        self.usual_reads = LOOKUPS_PER_SUBSET * subsets * usual
        self.moving = 2.0 * maximum * n * n_target * SECONDS_PER_GAIN
        # Until an ascent was made: that it ends with all of the hyper-edges that there can be.
        self.dearest = subsets * usual + (order - 1) * min(len(index.indices), math.comb(maximum, order))
        self.mean_reads: dict[str, float] = {}
        self.made, self.moves, self.cut, self.reads, self.left_out = 0, 0, 0, 0, 0
        self.state = empty_state(index)

    @property
    def whole_ascent(self) -> float:
        """Seconds that an ascent to a whole assignment takes, about."""
        return float(max(self.moving, self.dearest * SECONDS_PER_READ))

    @property
    def is_expensive(self) -> bool:
        """Whether an ascent takes so long that it is made in steps."""
        return self.whole_ascent > LONGEST

    def state_at(self, image: Integers) -> State:
        """The state of an assignment; the last one is kept."""
        if self.state.image.tobytes() != image.tobytes():
            # What most of it has in common with the last one need not be looked up again.
            near = self.is_expensive and self._is_near(image)
            self.state = state_of(self.index, image, self.state if near else None, at_once=not self.is_expensive)
        return self.state

    def _is_near(self, image: Integers) -> bool:
        """Whether an assignment has most in common with that of the state."""
        shared = np.sum((image >= 0) & (image == self.state.image))
        return bool(2 * shared > max((image >= 0).sum(), (self.state.image >= 0).sum()))

    def affordable(self, wanted: int, stage: str) -> int:
        """How many ascents of a stage may follow, by what those of it have read, or else the dearest one."""
        left, each = self.options.max_reads - self.reads, self.mean_reads.get(stage)
        count = int(max(left / max(self.dearest if each is None else each, 1.0), 0.0))
        if each is None and left > 0:
            # one tells what more would take
            count = max(count, 1)
        return min(count, wanted)

    def ascend(
        self, root: State, bases: Integers, penalty: float, *, stage: str, exchanges: bool = False, due: int = 0
    ) -> tuple[Integers, Floats]:
        """Ascents from assignments near a state: the optima (B, n) and their objectives (B,).

        Fewer at a deadline, or when as much was read as may be; but ``due`` of them whatever was read, and one at least
        of all. Those of a ``stage`` are expected to read about as much each.
        """
        images, values = np.empty((0, self.index.n), np.int64), np.empty(0)
        while len(images) < len(bases):
            waiting = len(bases) - len(images)
            first = int(self.made == 0)
            size = max(self.affordable(waiting, stage), min(max(due, first) - len(images), 1))
            if size == 0:
                self.left_out += waiting
                break
            # one ascent at least is made whatever the time
            size = self.pace.block(size) or first
            if size == 0:
                break
            some = bases[len(images) : len(images) + size]
            threads = worthwhile_threads(int(size * self.effort))
            if self.whole_ascent > SHORT * self.deadline.left():
                size = 1
            if size == 1 and (self.is_expensive or self.whole_ascent > SHORT * self.deadline.left()):
                found = self.ascend_one_in_steps(root, some[0], penalty, exchanges=exchanges)
            elif self.is_expensive:
                found = self.ascend_in_steps(root, some, penalty, exchanges=exchanges, threads=threads)
            else:
                found = climb_from(
                    self.index, root, some, penalty=penalty, limit=self.options.limit, exchanges=exchanges,
                    threads=threads,
                )  # fmt: skip
            self.count(found, stage)
            images, values = (found.images, found.values) if size == len(bases) else (
                np.concatenate([images, found.images]), np.concatenate([values, found.values])
            )  # fmt: skip
        return images, values

    def count(self, found: Ascended, stage: str) -> None:
        """Take note of what some ascents of a stage took."""
        reads, moves = found.reads.tolist(), found.moves.tolist()  # few numbers, which NumPy adds up no quicker
        self.dearest = float(max(*reads, self.dearest) if self.made else max(reads))
        self.mean_reads[stage] = sum(reads) / len(reads)
        self.made += len(reads)
        self.reads += sum(reads)
        self.moves += sum(moves)
        self.cut += sum(one >= self.options.limit for one in moves)

    def ascend_in_steps(
        self, root: State, bases: Integers, penalty: float, *, exchanges: bool, threads: int
    ) -> Ascended:
        """Ascents as of `climb_from`, between whose steps an interrupt is seen."""
        found = Ascended(np.empty_like(bases), np.empty(len(bases)), *np.empty((2, len(bases)), np.int64))
        stopped = Event()

        def ascend(first: int, last: int) -> None:
            for k in range(first, last):
                one = self.ascend_one_in_steps(root, bases[k], penalty, exchanges=exchanges, stopped=stopped)
                for each, (value,) in zip(found, one, strict=True):
                    each[k] = value

        run_in_threads(ascend, len(bases), threads, stopped=stopped)
        return found

    def ascend_one_in_steps(
        self, root: State, base: Integers, penalty: float, *, exchanges: bool, stopped: Event | None = None
    ) -> Ascended:
        """One ascent as of `climb_from`, a few moves at a time: it ends where it is at the deadline, or if stopped."""
        state, moves, size, begins = state_of(self.index, base, root), 0, 1, np.ones(1, np.int64)
        while True:
            began = self.deadline.clock()
            made = climb(self.index, state, begins, penalty=penalty, limit=size, exchanges=exchanges)
            moves += made
            if made < size or moves >= self.options.limit:
                ended = climb_from(self.index, state, state.image[None], penalty=penalty, limit=0)
                image, value = ended.images[0], float(ended.values[0])
                break
            if self.deadline.passed() or (stopped and stopped.is_set()):
                image, value = state.image, objective(self.index, state, penalty)
                break
            each = max((self.deadline.clock() - began) / made, 1e-9)
            longest = min(LONGEST, 0.5 * self.deadline.left())
            size = max(1, min(int(longest / each), GROWTH * size, self.options.limit - moves))
        if stopped is None:
            self.state = state  # which is needed again if it is the best
        return Ascended(image[None].copy(), np.array([value]), np.array([moves]), state.reads.copy())
