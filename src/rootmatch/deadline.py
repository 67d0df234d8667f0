"""The deadline of a match: read between blocks of work by every stage, which then hands on what it has found."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextvars import ContextVar

Clock = Callable[[], float]
GRACE, GRACE_SECONDS = 0.03, 0.001
"""Share of a match's time, and seconds, that it may take to hand on what it has: a part of the tenth and 5 ms by which
it may be late."""


class OutOfTime(Exception):  # noqa: N818
    """The deadline in force passed inside work that is done whole or not at all: a stage above hands on what it has."""


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
        self.seconds = math.inf if seconds is None else seconds
        self.ends = math.inf if seconds is None else (clock() if started is None else started) + seconds
        self._cuts: list[float] = []

    @property
    def is_set(self) -> bool:
        """Whether this deadline limits the time at all; `NEVER` does not."""
        return self.ends < math.inf

    @property
    def stopped_early(self) -> bool:
        """Whether any work was left out because of this deadline."""
        return bool(self._cuts)

    def left(self) -> float:
        """Seconds left, at least 0."""
        return max(self.ends - self.clock(), 0.0) if self.is_set else math.inf

    def passed(self) -> bool:
        """Whether the time is up. A stage with work left asks this, so a yes counts as work left out."""
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

    def affordable(self, maximum: int, seconds_each: float) -> int:
        """How many of ``maximum`` units of work end in time, at ``seconds_each``; at least one."""
        return max(min(maximum, int(min(self.left() / seconds_each, maximum))), 1)

    def cut(self, wanted: int, seconds_each: float) -> int:
        """How many of the ``wanted`` units of work end in time, as `affordable`; fewer counts as work left out."""
        if not self.is_set:
            return wanted
        count = self.affordable(wanted, seconds_each)
        if count < wanted:
            self._cuts.append(self.ends)
        return min(count, wanted)

    def record_cut(self, left_out: bool) -> None:
        """Record whether work was left out because of the deadline."""
        if left_out:
            self._cuts.append(self.ends)

    def at_most(self, seconds: float | None) -> Deadline:
        """The deadline, or an earlier one of its own if more than ``seconds`` are left; None for any."""
        return self if seconds is None or seconds >= self.left() else Deadline(seconds, clock=self.clock)

    def with_grace(self) -> Deadline:
        """The deadline a little later, so that handing on the results of a stage that ended in time is not cut off."""
        return self.later(GRACE, GRACE_SECONDS)

    def later(self, share: float, seconds: float) -> Deadline:
        """The deadline later by a share of the time allowed, if it states one, and so many seconds."""
        if self.ends == math.inf:
            return self
        late, allowed = Deadline(clock=self.clock), self.seconds if math.isfinite(self.seconds) else 0.0
        late.ends, late._cuts = self.ends + share * allowed + seconds, self._cuts
        return late

    def within(self) -> Within:
        """Run the block until the deadline; the first `checkpoint` after it ends the block without an error."""
        return Within(self)

    def enforce(self) -> Enforced:
        """Put the deadline in force for the block: a `checkpoint` inside it raises `OutOfTime` once it has passed."""
        return Enforced(self)


class Enforced:
    """A block in which a deadline is in force, see `Deadline.enforce`."""

    def __init__(self, deadline: Deadline) -> None:
        self.deadline = deadline

    def __enter__(self) -> None:
        self.token = _in_force.set(self.deadline)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        _in_force.reset(self.token)


class Within(Enforced):
    """The same block, which ends quietly, see `Deadline.within`."""

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> bool:  # type: ignore[override]
        _in_force.reset(self.token)
        return kind is not None and issubclass(kind, OutOfTime)


NEVER = Deadline()
"""No deadline."""
_in_force: ContextVar[Deadline] = ContextVar("_in_force", default=NEVER)


def active_deadline() -> Deadline:
    """The deadline of the stage that is running; `NEVER` outside of a match."""
    return _in_force.get()


def checkpoint(seconds: float = 0.0) -> None:
    """End work that cannot be handed on in part, if the deadline in force passes within so many seconds.

    Raises `OutOfTime`.
    """
    deadline = _in_force.get()
    if deadline.ends < math.inf and deadline.left() <= seconds:
        deadline.record_cut(left_out=True)
        raise OutOfTime


class Pace:
    """Sizes of the next blocks of work such that each ends in time, from how long the last one took.

    ``first``: units of work in the first block, of which nothing is known yet.
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
