"""Threads of Python over compiled code that does not hold Python's lock.

A parallel loop of Numba takes two to four times as long to compile as the plain loop inside it, so what is shared among
threads here is a range of tasks, and each thread calls the same plain kernel with its part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Lock
from types import CodeType, FunctionType

import numba

from rootmatch.deadline import Deadline, OutOfTime, active_deadline, checkpoint

LONGEST = 0.05
"""Seconds of compiled code between two looks for signals, a tenth of what one may wait for. A round value."""
GROWTH = 8
"""Times as many tasks in a piece as in the one before, at most: their times are known by the order of magnitude."""
FORGOTTEN = 0.7
"""Part of the time of the slowest tasks that is still expected of those of the next piece. A round value."""


def worthwhile_threads(tasks: int) -> int:
    """Threads for so many tasks each worth one: no more than Numba is allowed, and at least one.

    Waking threads for a few microseconds of work costs more than the work, and far more on a busy machine.
    """
    return 1 if tasks < 2 else min(tasks, int(numba.get_num_threads()))


@contextmanager
def use_one_thread() -> Iterator[None]:
    """Use a single thread for what is called inside; afterwards as many as before."""
    allowed = int(numba.get_num_threads())
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(allowed)


_SLOWEST: dict[CodeType, float] = {}
"""Seconds of the slowest of the last tasks of each piece of code, by which its next call begins."""


class Ranges:
    """The pieces of a range of tasks, which threads take one after the other until they are done or told to stop.

    Pieces grow from a single task to what takes `LONGEST` by the pace of the slowest of the last ones, also of earlier
    calls, as tasks take different times. Between two of them Python looks for signals, and this for the deadline in
    force.

    Parameters
    ----------
    work : callable
    first, last : int
        Tasks first … last − 1.
    largest : int
        Most tasks of a piece.
    begin : int
        Tasks of the first piece.
    deadline : Deadline, optional
        In the place of the one in force.
    stopped : Event, optional
        No piece begins once it is set.
    """

    def __init__(
        self,
        work: Callable[[int, int], None],
        first: int,
        last: int,
        *,
        largest: int,
        begin: int = 1,
        deadline: Deadline | None = None,
        stopped: Event | None = None,
    ) -> None:
        self.work, self.last, self.largest = work, last, largest
        self.deadline = active_deadline() if deadline is None else deadline
        self.stopped, self.lock = stopped, Lock()
        self.next, self.size = first, min(begin, largest)
        self.slowest = _SLOWEST.get(work.__code__, 0.0) if isinstance(work, FunctionType) else 0.0

    def run(self) -> None:
        """Process pieces until none is left."""
        try:
            while (piece := self._take_piece()) is not None:
                started = self.deadline.clock()
                self.work(*piece)
                self._grow(piece[1] - piece[0], self.deadline.clock() - started)
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """Skip the pieces that have not begun."""
        with self.lock:
            self.next = self.last

    def _take_piece(self) -> tuple[int, int] | None:
        with self.lock:
            first = self.next
            if first >= self.last or (self.stopped is not None and self.stopped.is_set()):
                return None
            if self.deadline.passed():
                raise OutOfTime
            self.next = min(first + self.size, self.last)
            return first, self.next

    def _grow(self, tasks: int, seconds: float) -> None:
        longest = min(LONGEST, 0.5 * self.deadline.left())
        with self.lock:
            self.slowest = max(seconds / tasks, FORGOTTEN * self.slowest, 1e-12)
            if isinstance(self.work, FunctionType):
                _SLOWEST[self.work.__code__] = self.slowest
            self.size = max(min(int(longest / self.slowest), GROWTH * tasks, self.largest), 1)


def run_in_pieces(work: Callable[[int, int], None], count: int) -> None:
    """Call ``work(first, last)`` in this thread for ranges that make up 0 … count, each of which takes about `LONGEST`.

    Raises `OutOfTime` if the deadline in force passes before all tasks are begun.
    """
    if count == 1:
        checkpoint()
        work(0, 1)
    elif count > 1:
        Ranges(work, 0, count, largest=count).run()


def run_in_threads(
    work: Callable[[int, int], None], count: int, threads: int, parts: int = 1, stopped: Event | None = None
) -> None:
    """Call ``work(first, last)`` for ranges that make up 0 … count, on some threads and in ``parts`` ranges for each.

    Several parts for each thread even out tasks of different lengths. Results must not depend on the ranges. An
    interrupt ends it within about `LONGEST`, if no task takes longer: one that may is to look whether it is
    ``stopped``.
    """
    threads = min(threads, count)
    if threads < 2:
        run_in_pieces(work, count)
        return
    from concurrent.futures import ThreadPoolExecutor  # a tenth of what `import rootmatch` takes

    ranges = Ranges(work, 0, count, largest=-(-count // (threads * parts)))
    with ThreadPoolExecutor(threads) as pool:
        try:
            for running in [pool.submit(ranges.run) for _ in range(threads)]:
                running.result()  # which Ctrl-C ends
        except BaseException:
            if stopped is not None:
                stopped.set()
            raise
        finally:
            ranges.stop()


def run_in_chunks(work: Callable[[int, int], None], bounds: Sequence[int], threads: int, begin: int) -> None:
    """Call ``work(first, last)`` for ranges that make up ``bounds[0]`` … ``bounds[-1]``, each of about `LONGEST`.

    Tasks of one chunk, ``bounds[k]`` … ``bounds[k + 1]``, are done one after another, by one thread, so that they may
    write into what is the chunk's own. A range may be of several chunks. ``begin``: tasks of the first range, which are
    to take a few milliseconds at most.
    """
    chunks = len(bounds) - 1
    if min(threads, chunks) < 2:
        Ranges(work, bounds[0], bounds[-1], largest=bounds[-1] - bounds[0], begin=begin).run()
        return
    deadline, stopped = active_deadline(), Event()

    def some(first: int, last: int) -> None:
        start, end = bounds[first], bounds[last]
        Ranges(work, start, end, largest=end - start, begin=begin, deadline=deadline, stopped=stopped).run()

    run_in_threads(some, chunks, threads, stopped=stopped)


def chunk_bounds(first: int, last: int, chunks: int) -> list[int]:
    """Bounds of chunks of equal size of the tasks first … last − 1."""
    return [first + (last - first) * chunk // chunks for chunk in range(chunks + 1)]
