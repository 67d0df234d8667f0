"""Minimal sets of the points of the first image, in an order that covers what the second image may show of them.

A set leads to a pose only if the second image shows all its points. The widest sets tell a pose best, but they share
the few points at the border, and none of them leads anywhere if one of those is not shown. So sets are ordered by width
times what they cover that those before them do not. What was covered tells how well a pose that explains so many points
may have been missed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.hypergraph.enumeration import subsets
from rootmatch.hypergraph.random_tuples import distinct_sets
from rootmatch.samplers.guided.minimal_sets import width

ORDERS = 128
"""Orders of the points that stand for all: what may be shown are the first points of one. A round value."""
BESIDE = 4.0
"""Most that a place along some direction counts against chance in an order: what a second image does not show lies
beyond one of its borders, or anywhere. A round value."""
LISTED = 512
"""Sets among which the next one is chosen: all, or the wider half of so many. A round value."""
WIDER_PART = 0.5
LOST = 0.25
"""Probability that a set leads to nothing though all of it is shown: .02 to .21 in the twelve kinds of scenes of
benchmarks/two_views.py up to 20 + 20 (seeds 1000 to 1011, four sets each). On the safe side."""
HALF_LOST = math.radians(0.9)
"""σ of the common direction of one view against the other's with which half of the sets lead to nothing though all of
them is shown, of 28 at each: .25 at an axis noise of .2°, .32 at .5°, .64 at 1°, nearly all at 2° (seeds from 1000)."""


def lost_with_tilt(tilt2: float) -> float:
    """`LOST` where the common direction is one of a variance, radians²."""
    return max(LOST, math.sqrt(tilt2) / (math.sqrt(tilt2) + HALF_LOST))


class CoveringSets:
    """The order of sets, and which ones were tried.

    Parameters
    ----------
    positions : (n, 3) array
    points : (m,) int64 array
        Those of the points that may be shown at all.
    size : int
        Points of a set.
    rng : Generator
    """

    def __init__(self, positions: Floats, points: Integers, size: int, rng: np.random.Generator) -> None:
        self.positions, self.points, self.size, self.rng = positions, points, size, rng
        self._rank = np.zeros((ORDERS, len(positions)), np.int32)
        """Place of each of the points in each order."""
        place = positions[points] @ rng.standard_normal((3, ORDERS))
        place = (place - place.mean(axis=0)) / np.maximum(place.std(axis=0), 1e-300)
        late = rng.uniform(0.0, BESIDE, ORDERS) * place + rng.standard_normal(place.shape)
        self._rank[:, points] = late.argsort(axis=0).argsort(axis=0).T
        self._tried: list[NDArray[np.int32]] = []
        """Place (ORDERS,) of the last point of each set that was tried."""

    def waves(self, first: int, further: int) -> Iterator[Integers]:
        """Sets (W, size): so many at first and then, until all were yielded."""
        count = len(self.points)
        if count < self.size:
            return
        if math.comb(count, self.size) <= LISTED:
            sets = self.points[subsets(count, self.size)]
            wide = width(self.positions, sets)
        else:
            sets = self.points[np.unique(distinct_sets(self.rng, LISTED, count, self.size), axis=0)]
            wide = width(self.positions, sets)
            used = np.argsort(-wide, kind="stable")[: int(WIDER_PART * len(sets))]
            sets, wide = sets[used], wide[used]
        worth = wide / max(float(wide.max()), 1e-300)
        # how many points are shown is not known
        shown = self.rng.integers(self.size, count, ORDERS, endpoint=True)
        covers = (self._last(sets) < shown[:, None]).astype(np.float32)
        needed = np.ones(ORDERS, np.float32)
        wave: list[int] = []
        for number in range(len(sets)):
            best = int((worth * (needed @ covers)).argmax())
            wave.append(best)
            needed *= 1.0 - np.float32(1.0 - LOST) * covers[:, best]
            worth[best] = -1.0
            if len(wave) == first or number == len(sets) - 1:
                yield np.ascontiguousarray(sets[wave])
                wave, first = [], further

    def add(self, sets: Integers) -> None:
        """Record that sets (S, size) were tried with all their images."""
        self._tried.extend(self._last(sets).T)

    def missed(self, matched: int, lost: float = LOST) -> float:
        """Probability that none of the sets tried led to a pose with so many matches, whichever points those are.

        ``lost``: probability that a set does not though all of it is shown.
        """
        if not self._tried:
            return 1.0
        met = (np.array(self._tried) < matched).sum(axis=0)
        return float((lost**met).mean())

    def _last(self, sets: Integers) -> NDArray[np.int32]:
        """Place (ORDERS, S) of the last point of sets (S, size) in each order."""
        return np.asarray(self._rank[:, sets].max(axis=2))
