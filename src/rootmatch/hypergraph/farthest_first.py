"""The order of points in which each is the farthest from all before it, compiled."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.decorators import driver


@driver(nogil=True)
def farthest_first(points, first, order):  # type: ignore[no-untyped-def]
    """Fill in the order (n,) of points (n, k) that begins with ``first``: always the one farthest from those before."""
    n = points.shape[0]
    nearest = np.empty(n)
    for i in range(n):
        nearest[i] = np.inf
    choice = first
    for place in range(n):
        order[place] = choice
        nearest[choice] = -1.0
        following = 0
        for i in range(n):
            if nearest[i] >= 0.0:
                squared = 0.0
                for axis in range(points.shape[1]):
                    squared += (points[i, axis] - points[choice, axis]) ** 2
                if squared < nearest[i]:
                    nearest[i] = squared
            if nearest[i] > nearest[following]:
                following = i
        choice = following
