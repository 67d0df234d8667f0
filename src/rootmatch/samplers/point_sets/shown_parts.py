"""Triples of points, drawn from the parts of a set that the other set may show, and what was missed by those tried.

A triple leads to the motion only if the other set shows all of it. What it shows may be any of the points or those near
one place: a part of a large model, an object among others. So a place is drawn or none, a number of points, and the
triple is a wide one among so many points nearest to the place: it is as wide as the part allows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.hypergraph.enumeration import subsets

ANYWHERE = 0.5
"""Share of the parts whose points may be anywhere. A round value."""
SHARPEST = 30.0
"""Most that the distance from its place, in standard deviations, counts against chance in a part. A round value: of a
hundred points the nearest ten are then a part but for one or two."""
FEWEST = 6
"""Fewest points of the parts that triples are drawn from, so that one is not all in a corner of what is shown."""
DRAWS = 4
"""Random triples of which the widest is tried: fewer are flat, more are all at the rim."""
ORDERS = 128
"""Orders of the points that stand for all: what is shown are the first points of one. A round value."""
LISTED = 600
"""Triples of a set up to which all are tried, each once."""
LOST = 0.05
"""Probability that a triple leads to nothing though all of it is shown: its images are gated at 3.7 σ, and its motion
may be too vague for the rest. On the safe side."""


class ShownParts:
    """Triples of a point set in the order in which they are tried.

    Parameters
    ----------
    points : (n, k) array
    near : (n, n) array
        Their distances.
    rng : Generator
    """

    def __init__(self, points: Floats, near: Floats, rng: np.random.Generator) -> None:
        self.points, self.near, self.rng = points, near, rng
        self.count = len(points)
        self._order = self._draw_places(ORDERS)[1].argsort(axis=1).argsort(axis=1).astype(np.int32)
        """(ORDERS, n) place of each point in each order."""
        self._last: list[NDArray[np.int32]] = []
        self._odds: list[Floats] = []
        self._waiting: Integers | None = None
        if math.comb(self.count, 3) <= LISTED:
            self._waiting = subsets(self.count, 3)[rng.permutation(math.comb(self.count, 3))]

    @property
    def is_exhausted(self) -> bool:
        """Whether every triple was yielded."""
        return self._waiting is not None and not len(self._waiting)

    def triples(self, count: int) -> Integers:
        """The next so many triples (T, 3), or fewer."""
        if self._waiting is not None:
            # the widest of the next few, so that wide ones come first but none of the parts waits for long
            wide = np.argsort(-squared_areas(self.near, self._waiting[: DRAWS * count]), kind="stable")[:count]
            taken = self._waiting[wide]
            self._waiting = np.delete(self._waiting, wide, axis=0)
            return taken
        shown = np.exp(self.rng.uniform(math.log(min(FEWEST, self.count)), math.log(self.count + 1.0), count))
        anywhere, drawn = self._draw_places(count)
        shown = np.where(anywhere, self.count, shown.astype(np.int64))
        order = drawn.argsort(axis=1)
        place = _distinct_below(self.rng, np.repeat(shown, DRAWS)).reshape(count, -1)
        chosen = np.take_along_axis(order, place, axis=1).reshape(count * DRAWS, 3)
        best = squared_areas(self.near, chosen).reshape(count, DRAWS).argmax(axis=1)
        return np.asarray(chosen.reshape(count, DRAWS, 3)[np.arange(count), best])

    def add(self, triples: Integers, share: Floats) -> None:
        """Record that triples (T, 3) were tried, each with a share (T,) of its possible images; with none it waits."""
        tried = share > 0.0
        if self._waiting is not None:
            self._waiting = np.concatenate([self._waiting, triples[~tried]])
        triples, share = triples[tried], share[tried]
        self._last.append(self._order[:, triples].max(axis=2))
        self._odds.append(np.log1p(-(1.0 - LOST) * share))

    def missed(self, matched: int) -> float:
        """Probability that none of the triples tried led to a motion with so many matches, whichever points."""
        if not self._last:
            return 1.0
        if self.is_exhausted and all((odds < math.log(2.0 * LOST)).all() for odds in self._odds):
            return 0.0
        met = np.concatenate(self._last, axis=1) < matched
        return float(np.exp(met @ np.concatenate(self._odds)).mean())

    def _draw_places(self, count: int) -> tuple[NDArray[np.bool_], Floats]:
        """Whether parts (count,) have no place; numbers (count, n), the lowest of the points that are shown first."""
        anywhere = self.rng.random(count) < ANYWHERE
        place = self.near[self.rng.integers(0, self.count, count)]
        place = (place - place.mean(axis=1, keepdims=True)) / np.maximum(place.std(axis=1, keepdims=True), 1e-300)
        sharp = np.where(anywhere, 0.0, SHARPEST ** self.rng.random(count))
        return anywhere, sharp[:, None] * place + self.rng.standard_normal(place.shape)


def _distinct_below(rng: np.random.Generator, below: Integers) -> Integers:
    """Three distinct indices (T, 3) below each of (T,) numbers, which are 3 or more."""
    first, second, third = (rng.random((3, len(below))) * (below - np.arange(3)[:, None])).astype(np.int64)
    second += second >= first
    low, high = np.minimum(first, second), np.maximum(first, second)
    third += third >= low
    third += third >= high
    return np.stack([first, second, third], axis=1)


def squared_areas(near: Floats, triples: Integers) -> Floats:
    """16 times the squared areas (T,) of triples (T, 3) of points with such distances (Heron), 0 on a line."""
    a, b, c = triples.T
    low, middle, high = np.sort(np.stack([near[a, b], near[b, c], near[a, c]]), axis=0)
    part = (low + middle - high) * (high + low - middle) * (high + middle - low)
    return np.asarray((low + middle + high) * np.maximum(part, 0.0))
