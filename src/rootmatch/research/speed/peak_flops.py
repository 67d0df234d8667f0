"""Peak floating-point rate of this machine, measured with fused multiply-adds that stay in registers."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from rootmatch.jit.decorators import driver
from rootmatch.jit.threads import run_in_threads
from rootmatch.research.speed.timing import min_seconds

CHAIN = 16
"""Consecutive multiply-adds on each number between its load and its store."""
ROWS, NUMBERS = 8, 64
"""Numbers per thread: four kilobytes, which fit in the L1 cache."""


@driver(nogil=True, fastmath={"contract"}, error_model="numpy")
def _fused(line, factor, term, repeats):  # type: ignore[no-untyped-def]
    """Apply x ← factor · x + term to the numbers (ROWS, NUMBERS), CHAIN times each and all ``repeats`` times."""
    for _ in range(repeats):
        for k in range(line.shape[1]):
            # eight independent chains, since each multiply-add waits for its predecessor
            a, b, c, d = line[0, k], line[1, k], line[2, k], line[3, k]
            e, f, g, h = line[4, k], line[5, k], line[6, k], line[7, k]
            for _ in range(CHAIN):
                a, b, c, d = factor * a + term, factor * b + term, factor * c + term, factor * d + term
                e, f, g, h = factor * e + term, factor * f + term, factor * g + term, factor * h + term
            line[0, k], line[1, k], line[2, k], line[3, k] = a, b, c, d
            line[4, k], line[5, k], line[6, k], line[7, k] = e, f, g, h


def peak(rounds: int, repeats: int) -> float:
    """Operations per second of all threads in float64; a multiply-add counts as two."""
    threads = numba.get_num_threads()
    numbers: NDArray[np.float64] = np.ones((threads, ROWS, NUMBERS))

    def work(first: int, last: int) -> None:
        for line in numbers[first:last]:
            _fused(line, 0.999, 0.001, rounds)

    (spent,) = min_seconds([lambda: run_in_threads(work, threads, threads)], repeats)
    return 2.0 * CHAIN * numbers.size * rounds / spent
