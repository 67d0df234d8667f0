"""Threads of Python over compiled code that does not hold Python's lock.

A parallel loop of Numba takes two to four times as long to compile as the plain loop inside it, so what is shared among
threads here is a range of tasks, and each thread calls the same plain kernel with its part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numba


def threads_worth(tasks: int) -> int:
    """Threads for so many tasks each worth one: no more than Numba is allowed, and at least one.

    Waking threads for a few microseconds of work costs more than the work, and far more on a busy machine.
    """
    return 1 if tasks < 2 else min(tasks, int(numba.get_num_threads()))


@contextmanager
def at_most(threads: int) -> Iterator[None]:
    """No more than so many threads for what is called inside; afterwards as many as before."""
    allowed = int(numba.get_num_threads())
    numba.set_num_threads(min(threads, allowed))
    try:
        yield
    finally:
        numba.set_num_threads(allowed)


def in_threads(work: Callable[[int, int], None], count: int, threads: int, parts: int = 1) -> None:
    """Call ``work(first, last)`` for ranges that make up 0 … count, on some threads and in ``parts`` ranges for each.

    Several parts for each thread even out tasks of different lengths.
    """
    if threads == 1 or count < 2:
        work(0, count)
        return
    from concurrent.futures import ThreadPoolExecutor  # a tenth of what `import rootmatch` takes

    pieces = min(count, threads * parts)
    edges = [count * piece // pieces for piece in range(pieces + 1)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
