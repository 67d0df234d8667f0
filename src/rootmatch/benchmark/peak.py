"""The most floating-point operations a second that this machine reaches, by fused products that stay in registers."""

from __future__ import annotations

import numba
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from rootmatch.benchmark.timing import seconds

CHAIN = 32
"""Fused products one after the other on each number, between its load and its store."""
NUMBERS = 512
"""Numbers of a thread: four kilobytes, which the nearest cache holds."""


@njit(parallel=True, cache=True, fastmath={"contract"}, error_model="numpy")
def _fused(numbers, factor, term, repeats):  # type: ignore[no-untyped-def]
    """Apply x ← factor · x + term to the numbers (threads, NUMBERS), CHAIN times each and all ``repeats`` times."""
    for thread in prange(numbers.shape[0]):
        line = numbers[thread]
        for _ in range(repeats):
            for k in range(line.shape[0]):
                x = line[k]
                for _ in range(CHAIN):
                    x = factor * x + term
                line[k] = x


def peak(rounds: int, repeats: int) -> float:
    """Operations a second of all threads in float64; a fused product is two."""
    numbers: NDArray[np.float64] = np.ones((numba.get_num_threads(), NUMBERS))
    spent = seconds(lambda: _fused(numbers, 0.999, 0.001, rounds), repeats)
    return 2.0 * CHAIN * numbers.size * rounds / spent
