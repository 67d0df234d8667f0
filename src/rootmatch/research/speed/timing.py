"""Timing of calls."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of a call in seconds, after a warm-up call."""
    work()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def least_seconds(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Shortest time of each call in seconds, measured alternately, after a warm-up round.

    Alternately, so that a temporary slowdown of the machine affects all of them; the shortest, because disturbances
    only ever slow a call down.
    """
    least = [np.inf] * len(works)
    for turn in range(repeats + 1):
        for k, work in enumerate(works):
            started = time.perf_counter()
            work()
            if turn:
                least[k] = min(least[k], time.perf_counter() - started)
    return least
