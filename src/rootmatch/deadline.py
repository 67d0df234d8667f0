"""The deadline of a match: read between blocks of work by every stage, which then hands on what it has found."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

Clock = Callable[[], float]


class Deadline:
    """A time by which a match ends.

    A stage asks `passed` before it begins another block of its work, so a deadline that cut work short knows that it
    did. Parts of a deadline, one for each stage, share that knowledge.

    Parameters
    ----------
    seconds : float, optional
        Time allowed; None for any.
    started : float, optional
        When it began, by the clock; now by default.
    clock : callable
        Seconds since some moment.
    """

    def __init__(
        self, seconds: float | None = None, *, started: float | None = None, clock: Clock = time.perf_counter
    ) -> None:
        self.clock = clock
        self.ends = math.inf if seconds is None else (clock() if started is None else started) + seconds
        self._cuts: list[float] = []

    @property
    def is_set(self) -> bool:
        """Whether there is one at all."""
        return self.ends < math.inf

    @property
    def stopped_early(self) -> bool:
        """Whether any work was left out because of it."""
        return bool(self._cuts)

    def left(self) -> float:
        """Seconds left, at least 0."""
        return max(self.ends - self.clock(), 0.0) if self.is_set else math.inf

    def passed(self) -> bool:
        """Whether the time is up, asked by a stage that has more to do."""
        if self.left() > 0.0:
            return False
        self._cuts.append(self.ends)
        return True

    def part(self, share: float, reserve: float = math.inf) -> Deadline:
        """The deadline of a stage that may take this share of the time left, or all but a reserve in seconds."""
        if not self.is_set:
            return self
        stage, left = Deadline(clock=self.clock), self.left()
        stage.ends, stage._cuts = self.ends - min((1.0 - share) * left, reserve), self._cuts
        return stage

    def affordable(self, most: int, seconds_each: float) -> int:
        """How many of at most so many units of work, at so many seconds each, end in time; at least one."""
        return max(min(most, int(min(self.left() / seconds_each, most))), 1)

    def cut(self, wanted: int, seconds_each: float) -> int:
        """The same for work that is all wanted: what is left out is known to be."""
        count = self.affordable(wanted, seconds_each)
        if count < wanted:
            self._cuts.append(self.ends)
        return min(count, wanted)

    def cuts(self, left_out: bool) -> None:
        """Take down that work was left out because of the deadline, if it was."""
        if left_out:
            self._cuts.append(self.ends)


NEVER = Deadline()
"""No deadline."""


class Pace:
    """Sizes of the next blocks of work such that each ends in time, from how long the last one took.

    Parameters
    ----------
    deadline : Deadline
    first : int
        Units of work in the first block, of which nothing is known yet.
    """

    def __init__(self, deadline: Deadline, first: int = 1) -> None:
        self.deadline, self.first = deadline, first
        self.given, self.at = 0, 0.0

    def block(self, wanted: int) -> int:
        """Units of the next block: those wanted, fewer as the deadline comes near, 0 when it has passed."""
        deadline = self.deadline
        if not deadline.is_set:
            return wanted
        if deadline.passed():
            return 0
        now, size = deadline.clock(), self.first
        if self.given:
            # half of what is left: the next block may be slower than the last
            each = max((now - self.at) / self.given, 1e-12)
            size = int(min(0.5 * deadline.left() / each, wanted))
        self.given, self.at = max(min(size, wanted), 1), now
        return self.given
