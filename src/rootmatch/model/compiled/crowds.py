"""Shares of clutter that crowds, compiled: see `rootmatch.model.clutter`."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def shares_of_crowds(densities, prior, steps, shares):  # type: ignore[no-untyped-def]
    """Most probable shares (S,) of components with densities (S, n'), by expectation and maximisation, in place.

    ``prior`` (S,): pseudo-counts; ``steps``: how many; ``shares``: those to start from.
    """
    densities, prior, shares = borrowed((densities, prior, shares))
    count = shares.shape[0]
    total = np.empty(count)
    for _ in range(steps):
        for s in range(count):
            total[s] = prior[s]
        for j in range(densities.shape[1]):
            whole = 0.0
            for s in range(count):
                whole += shares[s] * densities[s, j]
            for s in range(count):
                total[s] += shares[s] * densities[s, j] / whole
        every = 0.0
        for s in range(count):
            every += total[s]
        for s in range(count):
            shares[s] = total[s] / every
