"""How long a call takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of a call in seconds, after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def least_seconds(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Least time of each call in seconds, taken in turn, after a first round that is not counted.

    In turn, so that what slows the machine for a while slows all; the least, because nothing
    makes a call faster than it is.
    """
    least = [np.inf] * len(works)
    for turn in range(repeats + 1):
        for k, work in enumerate(works):
            started = time.perf_counter()
            work()
            if turn:
                least[k] = min(least[k], time.perf_counter() - started)
    return least
