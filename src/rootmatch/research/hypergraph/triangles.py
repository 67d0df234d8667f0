"""Triangles of point sets of a plane, their signed sines, and the most alike of another set."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Integers
from rootmatch.jit.decorators import driver

ORDERS = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)])
"""All orders of a triangle's points; the last three turn it over."""


@driver(error_model="numpy")
def all_triangles(points: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Increasing triples (T, 3) of n points (n, 2) and the sines (T, 3) of the angles at their points.

    Sines are positive where the three turn one way and negative where they turn the other.
    """
    n = len(points)
    index = np.empty((n * (n - 1) * (n - 2) // 6, 3), np.int32)
    sines = np.empty((len(index), 3))
    t = 0
    for i in range(n):
        for j in range(i + 1, n):
            ax, ay = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            c = math.sqrt(ax * ax + ay * ay)
            for k in range(j + 1, n):
                bx, by = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
                b = math.sqrt(bx * bx + by * by)
                a = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
                area = ax * by - ay * bx
                index[t, 0], index[t, 1], index[t, 2] = i, j, k
                sines[t, 0], sines[t, 1], sines[t, 2] = area / (b * c), area / (a * c), area / (a * b)
                t += 1
    return index, sines


def nearest_triangles(
    asked: NDArray[Any], sines: NDArray[Any], norm: NDArray[Any], count: int
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """The triangles, in any order of their points, whose sines are nearest to each of those asked for.

    A tree over all orders would hold 9 million entries at 210 points. Here the lengths of the vectors of sines, which
    no order changes, narrow the search: |‖f‖ − ‖g‖| ≤ ‖f − g‖.

    Parameters
    ----------
    asked : (S, 3) array
        Sines of the triangles asked for.
    sines : (T, 3) array
        Of all triangles, each in one order, sorted by their norms.
    norm : (T,) array
        ‖sines‖, ascending.
    count : int
        Neighbours of each, at most 6 T.

    Returns
    -------
    triangle, order : (S, count) arrays
        Row of ``sines`` and row of ``ORDERS``, in no particular order.
    distance : (S, count) array
    """
    count = min(count, 6 * norm.size)
    triangle, order = np.empty((len(asked), count), np.int32), np.empty((len(asked), count), np.int8)
    distance = np.empty((len(asked), count))
    code, square = np.empty(0, np.int64), np.empty(0)
    radius = 0.02
    for row, sought in enumerate(np.ascontiguousarray(asked)):
        length = float(np.linalg.norm(sought))
        while True:
            low = int(norm.searchsorted(length - radius))
            high = int(norm.searchsorted(length + radius, side="right"))
            if 6 * (high - low) >= code.size:
                code, square = np.empty(12 * (high - low) + 6, np.int64), np.empty(12 * (high - low) + 6)
            found = _find_near(sought, sines, np.array([low, high]), radius * radius, code, square)
            if found >= count:
                break
            radius *= 1.4
        codes, squares = code[:found], square[:found]
        limit = np.partition(squares, count - 1)[count - 1]
        # those nearer than the last one, then as many as near as it that there is room for
        kept = np.concatenate([np.flatnonzero(squares < limit), np.flatnonzero(squares == limit)])[:count]
        triangle[row], order[row] = np.divmod(codes[kept], 6)
        distance[row] = np.sqrt(squares[kept])
        if found > 2 * count:
            # the found grow with the square of the radius
            radius *= math.sqrt(1.3 * count / found)
    return triangle, order, distance


@driver(error_model="numpy")
def _find_near(
    asked: NDArray[Any], sines: NDArray[Any], rows: Integers, limit: float, code: Integers, square: NDArray[Any]
) -> int:
    """How many of the orders of triangles rows[0] … rows[1] − 1 are within √limit: 6 · row + order, and the square."""
    x, y, z = asked[0], asked[1], asked[2]
    found = 0
    for t in range(rows[0], rows[1]):
        a, b, c = sines[t, 0], sines[t, 1], sines[t, 2]
        # as in ORDERS; each is written and kept only if near, which has no branch
        code[found], square[found] = 6 * t, (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2
        found += square[found] <= limit
        code[found], square[found] = 6 * t + 1, (b - x) ** 2 + (c - y) ** 2 + (a - z) ** 2
        found += square[found] <= limit
        code[found], square[found] = 6 * t + 2, (c - x) ** 2 + (a - y) ** 2 + (b - z) ** 2
        found += square[found] <= limit
        code[found], square[found] = 6 * t + 3, (a + x) ** 2 + (c + y) ** 2 + (b + z) ** 2
        found += square[found] <= limit
        code[found], square[found] = 6 * t + 4, (c + x) ** 2 + (b + y) ** 2 + (a + z) ** 2
        found += square[found] <= limit
        code[found], square[found] = 6 * t + 5, (b + x) ** 2 + (a + y) ** 2 + (c + z) ** 2
        found += square[found] <= limit
    return found
