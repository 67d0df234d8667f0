"""The order of points in which each is the farthest from all before it, compiled."""

from __future__ import annotations

from rootmatch.jit.decorators import driver


@driver(nogil=True)
def farthest_first(points, begin, end, order, nearest):  # type: ignore[no-untyped-def]
    """Fill in the order (n,) of points (n, k) behind the places ``begin … end − 1``: the farthest from all before.

    ``nearest`` (n,) are squared distances to those before ``begin``: ∞ at first, when ``order[0]`` is given.
    """
    n = points.shape[0]
    for place in range(begin, end):
        choice = order[place]
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
        if place + 1 < n:
            order[place + 1] = following
