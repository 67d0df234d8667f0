"""Timing of calls."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Sequence

import numpy as np


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of a call in seconds, after a warm-up call."""
    return float(np.median(timeit.repeat(work, number=1, repeat=repeats + 1)[1:]))


def min_seconds(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Shortest time of each call in seconds, measured alternately, after a warm-up round.

    Alternately, so that a temporary slowdown of the machine affects all of them; the shortest, because disturbances
    only ever slow a call down.
    """
    rounds = [[timeit.timeit(work, number=1) for work in works] for _ in range(repeats + 1)]
    found: list[float] = np.min(rounds[1:], axis=0).tolist()
    return found
