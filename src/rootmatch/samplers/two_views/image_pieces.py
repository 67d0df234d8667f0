"""The images of minimal sets between two views, a piece at a time, so that a deadline is met."""

from __future__ import annotations

from collections.abc import Callable

from rootmatch.arrays import Integers
from rootmatch.deadline import active_deadline, checkpoint
from rootmatch.jit.threads import GROWTH, LONGEST


def run_image_pieces(work: Callable[[int, int], None], ranges: Integers, largest: int) -> None:
    """Call ``work`` for pieces of ranges, from one task to what takes `LONGEST`, as `rootmatch.jit.threads.Ranges`.

    None is larger than a given one: images that no pose has tell nothing of the cost of those that some have.

    Raises `OutOfTime` if the deadline in force passes before all is begun.
    """
    deadline, size = active_deadline(), 1
    for begin, end in ranges.tolist():
        while begin < end:
            checkpoint()
            stop, started = min(begin + size, end), deadline.clock()
            work(begin, stop)
            each = max((deadline.clock() - started) / (stop - begin), 1e-9)
            longest = min(LONGEST, 0.5 * deadline.left())
            size = max(1, min(int(longest / each), GROWTH * (stop - begin), largest))
            begin = stop
