"""Triangles of one point set that are alike to those of another one, up to noise, looked up by their sides."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import active_deadline, checkpoint
from rootmatch.problems.points import distances
from rootmatch.samplers.point_sets.shape_table import MAXIMUM, NARROWEST, ShapeTable

GATE = 3.7
"""Deviation in σ up to which distances within a triple agree (of 10,000 right ones two are lost)."""
PAIRS = 100_000
"""Most pairs of points that are tried for the first side of a triangle; a seeded selection of more."""
ENTRIES = 500_000
"""Pairs and third points that are compared at once, so that a block of them takes some ten milliseconds."""
TURNED = np.array([[0, 1, 2], [1, 2, 0], [0, 2, 1]])
"""Corners of a triangle in the order in which a side comes first: ab, bc or ac."""
SHAPES = 32
"""Triples whose shapes are looked up at once. A round value."""
SECONDS_PER_PAIR, SECONDS_PER_SHAPE, SECONDS_PER_SIDE = 3e-7, 8e-7, 4e-7
"""Time to sort a pair of points by distance, twice, and a triangle by its shape; to compare a pair with a side."""
PATIENCE = 0.25
"""Part of the time for a table of shapes that comparing sides takes before there is one. A round value."""
RESERVE = 4.0
"""How many times as much time has to be left to sort them: a search takes most of it. A round value."""


class Alike(NamedTuple):
    """What was found for some triples."""

    number: Integers
    """(H,) which of the triples."""
    corners: Integers
    """(H, 3) points of the set that was searched, in the order of the triple's."""
    share: Floats
    """(T,) share of its pairs that each triple was compared with."""
    compared: int


class Triangles:
    """The triangles of a point set, by the lengths of their sides.

    Parameters
    ----------
    points : (n, k) array
    variance : (n,) array
        Of a coordinate.
    scaled : bool
        Whether triangles of another size are alike.
    gate : float
        Deviation in σ up to which distances agree.
    """

    def __init__(self, points: Floats, variance: Floats, scaled: bool, gate: float = GATE) -> None:
        checkpoint(SECONDS_PER_PAIR * len(points) ** 2)
        self.variance, self.scaled, self.gate = variance, scaled, gate
        self.far = distances(points)
        self.widest = float(variance.max())
        n = len(points)
        first, second = np.triu_indices(n, 1)
        order = np.argsort(self.far[first, second], kind="stable")
        self.first, self.second = first[order], second[order]
        self.lengths = self.far[self.first, self.second]
        # the distances from each point in ascending order, in one list: those of a row are lifted above the row before
        self.lift = 2.0 * float(self.far.max()) + 1e-300
        beside = np.argsort(self.far, axis=1, kind="stable")
        rising = np.take_along_axis(self.far, beside, axis=1) + self.lift * np.arange(n)[:, None]
        self.beside, self.rising = beside.ravel(), rising.ravel()
        self._shapes: ShapeTable | None = None
        self._compared = 0

    def alike(
        self, triples: Integers, near: Floats, variance: Floats, allowed: Bools | None, rng: np.random.Generator
    ) -> Alike:
        """All triangles alike to triples (T, 3) of points with distances ``near`` and variances; see `Alike`.

        ``allowed`` (m, n): which of the other points may be which of these. ``rng``: selects pairs where they are too
        many.
        """
        side, low, count = self._first_sides(triples, near, variance)
        turned = np.take_along_axis(triples, TURNED[side], axis=1)
        share, found, compared = np.minimum(PAIRS / np.maximum(count, 1), 1.0), list[tuple[Integers, Integers]](), 0
        if self._lists_shapes(near):
            wide = NARROWEST * near[turned[:, 0], turned[:, 1]] >= near.max()
            listed = self._look_up_shapes(np.flatnonzero(wide), turned, near, variance)
            found, compared, count = [listed[0]], listed[1], np.where(wide, 0, count)
            share = np.where(wide, 1.0, share)
        row, place = expand_ranges(low, np.minimum(count, PAIRS))
        if (count > PAIRS).any():
            many = count[row] > PAIRS
            place[many] = low[row[many]] + rng.integers(0, count[row[many]])
        # a pair may be the first two corners in either order
        row, pair = np.concatenate([row, row]), np.stack([self.first[place], self.second[place]], axis=1)
        pair = np.concatenate([pair, pair[:, ::-1]])
        if allowed is not None:
            possible = allowed[turned[row, 0], pair[:, 0]] & allowed[turned[row, 1], pair[:, 1]]
            row, pair = row[possible], pair[possible]
        found.append((row[:0], np.empty((0, 3), np.int64)))
        compared += len(row)
        self._compared += len(row)
        step = max(1, ENTRIES // len(self.variance))
        for start in range(0, len(row), step):
            checkpoint()
            rows = row[start : start + step]
            some, corners, seen = self._find_third_corners(turned[rows], pair[start : start + step], near, variance)
            compared += seen
            found.append((rows[some], corners))
        number, corners = (np.concatenate(part) for part in zip(*found, strict=True))
        if allowed is not None:
            possible = allowed[turned[number], corners].all(axis=1)
            number, corners = number[possible], corners[possible]
        back = np.empty_like(corners)
        np.put_along_axis(back, TURNED[side[number]], corners, axis=1)
        return Alike(number, back, share, compared)

    def _lists_shapes(self, near: Floats) -> bool:
        """Whether shapes are looked up in a table, which is the same and quicker, but takes time to make.

        It is made once comparing sides has taken a part of that: of large sets most motions are met before.
        """
        number = math.comb(len(self.variance), 3)
        if not self.scaled or number > MAXIMUM or near.max() <= 0.0:
            return False
        takes = SECONDS_PER_SHAPE * number
        return self._shapes is not None or (
            SECONDS_PER_SIDE * self._compared >= PATIENCE * takes and active_deadline().left() > RESERVE * takes
        )

    def _look_up_shapes(
        self, which: Integers, triples: Integers, near: Floats, variance: Floats
    ) -> tuple[tuple[Integers, Integers], int]:
        """The triangles (H, 3) like some of the triples (T, 3), the longest side first, by number; those compared."""
        if self._shapes is None:
            other = float(variance.max()) / float(near.max()) ** 2
            self._shapes = ShapeTable(self.far, self.widest, other, self.gate)
        (a, b, c), found, compared = triples[which].T, list[tuple[Integers, Integers]](), 0
        sides, own = np.stack([near[a, b], near[a, c], near[b, c]], axis=1), variance[triples[which]]
        for start in range(0, max(len(which), 1), SHAPES):
            checkpoint()
            some = slice(start, start + SHAPES)
            number, corners, seen = self._shapes.alike(sides[some], own[some], self.variance)
            found.append((which[some][number], corners))
            compared += seen
        number, corners = (np.concatenate(part) for part in zip(*found, strict=True))
        return (number, corners), compared

    def _first_sides(self, triples: Integers, near: Floats, variance: Floats) -> tuple[Integers, Integers, Integers]:
        """The side (T,) of each triple that is compared first, and the first and the number of the pairs like it.

        It is the one that fewest pairs are like; of another size all are, and a scale is best known from the longest.
        """
        corners = triples[:, TURNED[:, :2]]
        length = near[corners[..., 0], corners[..., 1]]
        if self.scaled:
            side = length.argmax(axis=1)
            return side, np.zeros(len(side), np.int64), np.full(len(side), len(self.lengths))
        window = self.gate * np.sqrt(2.0 * self.widest + variance[corners].sum(axis=2))
        low = np.searchsorted(self.lengths, length - window)
        count = np.searchsorted(self.lengths, length + window) - low
        side = count.argmin(axis=1)
        every = np.arange(len(side))
        return side, low[every, side], count[every, side]

    def _find_third_corners(
        self, triples: Integers, pair: Integers, near: Floats, variance: Floats
    ) -> tuple[Integers, Integers, int]:
        """Which of the triples (P, 3), whose first two corners may be pairs (P, 2), have which triangles (H, 3)."""
        (a, b, c), (k, l) = triples.T, pair.T  # noqa: E741
        z, w = self.variance, variance
        ab, length = near[a, b], self.far[k, l]
        scale = length / np.maximum(ab, 1e-300) if self.scaled else np.ones(len(length))
        own = z[k] + z[l] + scale**2 * (w[a] + w[b])
        # an unknown scale has the noise of the side that it is taken from
        of_scale = own / np.maximum(ab, 1e-300) ** 2 if self.scaled else np.zeros(len(own))
        alike = np.flatnonzero((np.abs(length - scale * ab) <= self.gate * np.sqrt(own)) & (ab > 0.0))
        a, b, c, k, l = (one[alike] for one in (a, b, c, k, l))  # noqa: E741
        scale, of_scale = scale[alike], of_scale[alike]
        side = scale * near[a, c]
        noise = z[k] + scale**2 * (w[a] + w[c]) + of_scale * near[a, c] ** 2
        window = self.gate * np.sqrt(noise + self.widest)
        low = np.searchsorted(self.rising, self.lift * k + np.maximum(side - window, 0.0))
        high = np.searchsorted(self.rising, self.lift * k + np.minimum(side + window, 0.75 * self.lift), "right")
        row, place = expand_ranges(low, np.maximum(high - low, 0))
        m = self.beside[place]
        right = (self.far[k[row], m] - side[row]) ** 2 <= self.gate**2 * (noise[row] + z[m])
        row, m = row[right], m[right]
        side = scale * near[b, c]
        noise = z[l] + scale**2 * (w[b] + w[c]) + of_scale * near[b, c] ** 2
        right = (self.far[l[row], m] - side[row]) ** 2 <= self.gate**2 * (noise[row] + z[m])
        right &= (m != k[row]) & (m != l[row])
        seen, row, m = len(row), row[right], m[right]
        return alike[row], np.stack([k[row], l[row], m], axis=1), seen


def expand_ranges(low: Integers, count: Integers) -> tuple[Integers, Integers]:
    """Each row with each of so many (R,) numbers from ``low`` (R,) on: rows and numbers (sum of the counts,)."""
    row = np.repeat(np.arange(len(low)), count)
    begin = np.cumsum(count) - count
    return row, np.arange(len(row)) - begin[row] + low[row]
