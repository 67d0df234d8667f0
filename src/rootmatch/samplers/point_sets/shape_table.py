"""The triangles of a point set by their shapes, where the size tells nothing: those like another one are looked up.

A shape is the lengths of two sides over that of the third, which is the longest or may be by its noise. Small triangles
have vague shapes; so there is a class for each size, with cells as wide as its noise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.hypergraph.enumeration import subsets
from rootmatch.samplers.point_sets.kernels import list_alike

FINER = math.sqrt(2.0)
"""Ratio of sizes from one class to the next."""
VAGUEST = 0.5
"""Deviation of a ratio of sides from which shapes tell nothing, and one cell has all. A round value."""
NARROWEST = 10.0
"""Part of the size of a point set that the longest side of a triple has at least. A round value."""
MAXIMUM = 2_000_000
"""Most triangles that are listed, those of 228 points: their table takes two seconds and .4 GB."""
SIDES = np.array([[0, 1, 2], [1, 0, 2], [0, 2, 1], [2, 0, 1], [1, 2, 0], [2, 1, 0]])
"""Corners of a triangle, those of its first side first."""


class ShapeTable:
    """The triangles of points, by shape.

    Parameters
    ----------
    far : (n, n) array
        Distances of the points.
    widest : float
        Largest variance of a coordinate of theirs.
    other : float
        That of the triangles that are looked up, over the square of the size of their point set.
    gate : float
        Deviation in σ up to which distances agree.
    """

    def __init__(self, far: Floats, widest: float, other: float, gate: float) -> None:
        every = subsets(len(far), 3).astype(np.int16)
        sides = np.stack([far[every[:, p], every[:, q]] for p, q in ((0, 1), (0, 2), (1, 2))])
        longest, found = sides.max(axis=0), list[tuple[Integers, Integers]]()
        self.far, self.gate, steepest = far, gate, 1.0
        for order in SIDES:
            first = sides[sum(order[:2]) - 1]
            own = longest <= first + 2.0 * gate * np.sqrt(widest + other * (NARROWEST * first) ** 2)
            found.append((order, np.flatnonzero(own & (first > 0.0)).astype(np.int32)))
            steepest = max(steepest, float((longest[found[-1][1]] / first[found[-1][1]]).max(initial=1.0)))
        largest = float(longest.max(initial=1e-300))
        smallest = 2.0 * gate * math.sqrt(widest) / VAGUEST
        count = max(math.ceil(math.log(max(largest / max(smallest, 1e-6 * largest), 1.0), FINER)), 0)
        self.shortest = largest * FINER ** -(np.arange(count + 1.0) + 1.0)
        """(classes,) least length of a first side."""
        self.width = np.maximum(2.0 * gate * np.sqrt(widest / self.shortest**2 + other), 1e-9)
        self.shortest[-1], self.width[-1] = max(1e-6 * math.sqrt(widest), 1e-100), 1e6  # all of them in one cell
        """(classes,) width of the cells of a ratio."""
        self.lift = 2.0 * steepest + 1.0
        self.cells = np.floor(steepest / self.width).astype(np.int64) + 1
        self.begin = np.cumsum(self.cells) - self.cells
        # one order of corners after the other: all of them at once take three times the memory
        keys, corners = list[Floats](), list[NDArray[np.int16]]()
        for order, own in found:
            checkpoint()
            first, second, third = (sides[sum(pair) - 1, own] for pair in (order[:2], order[::2], order[1:]))
            size = np.minimum((np.log(largest / first) / math.log(FINER)).astype(np.int64), count)
            keys.append(self.lift * (self.begin[size] + np.floor(second / first / self.width[size])) + third / first)
            corners.append(every[own][:, order])
        key = np.concatenate(keys)
        order = np.argsort(key, kind="stable")
        self.rising, self.corners = key[order], np.ascontiguousarray(np.concatenate(corners)[order].T.astype(np.int32))

    def alike(self, sides: Floats, own: Floats, variance: Floats) -> tuple[Integers, Integers, int]:
        """The triangles like triples of sides (T, 3) ab, ac and bc, the first the longest, and variances (T, 3).

        The number (H,) of the triple and the corners (H, 3) of each, and how many were compared. ``variance``: (n,) of
        the points listed.
        """
        table = self.rising, self.corners, self.begin, self.cells, self.width, self.shortest, self.lift
        room = 64 * len(sides)
        while True:
            number, corners = np.empty(room, np.int64), np.empty((room, 3), np.int64)
            count, compared = list_alike((sides, own), table, (self.far, variance), self.gate, (number, corners))
            if count <= room:
                return number[:count], corners[:count], compared
            room = count
