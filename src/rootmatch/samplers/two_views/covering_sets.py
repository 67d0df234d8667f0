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
NEAR = math.radians(1.25)
"""σ of how far off the tilts that a set takes may be: it leads to nothing the more often, as a Gaussian falls. Of 40
sets whose points are all shown, at a tilt off by 0, 1 and 2°, 34, 25 and 7 led to the pose (axis noise 2°)."""
TILTS = 32
"""Tilts among which that of the next set is chosen, beside none. A round value."""


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
    tilt : float
        Standard deviation of both tilts of the common direction.
    """

    def __init__(
        self, positions: Floats, points: Integers, size: int, rng: np.random.Generator, *, tilt: float = 0.0
    ) -> None:
        self.positions, self.points, self.size, self.rng = positions, points, size, rng
        self._rank = np.zeros((ORDERS, len(positions)), np.int32)
        """Place of each of the points in each order."""
        place = positions[points] @ rng.standard_normal((3, ORDERS))
        place = (place - place.mean(axis=0)) / np.maximum(place.std(axis=0), 1e-300)
        late = rng.uniform(0.0, BESIDE, ORDERS) * place + rng.standard_normal(place.shape)
        self._rank[:, points] = late.argsort(axis=0).argsort(axis=0).T
        self._tilts = tilt * rng.standard_normal((ORDERS, 2)) if tilt > 0.0 else np.zeros((1, 2))
        """What the tilts may be, of each order where they are not known."""
        self._tried: list[tuple[NDArray[np.int32], Floats]] = []
        """Place (ORDERS,) of the last point of each set that was tried, and its tilts (2,)."""

    def waves(self, first: int, further: int) -> Iterator[tuple[Integers, Floats]]:
        """Sets (W, size) and the tilts (W, 2) of each: so many at first and then, until all were yielded."""
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
        # how many points are shown is not known
        shown = self.rng.integers(self.size, count, ORDERS, endpoint=True)
        covers = (self._last(sets) < shown[:, None]).astype(np.float32)
        needed = np.ones(ORDERS, np.float32)
        worth = wide / max(float(wide.max()), 1e-300)
        taken: list[tuple[Floats, int]] = []
        while True:
            known = self._tilts
            tilts = np.concatenate([np.zeros((1, 2)), known[:TILTS]]) if len(known) > 1 else known
            met, each = 1.0 - self._lost(tilts), np.tile(worth, (len(tilts), 1))
            relative = met / np.float32(1.0 - LOST)
            needed = np.ones(ORDERS, np.float32)
            for tilt, best in taken:
                needed *= 1.0 - (1.0 - self._lost(tilt[None])[0]) * covers[:, best]
            wave: list[tuple[int, int]] = []
            for number in range(len(sets)):
                gain = np.array([(needed * own) @ covers for own in relative])
                which, best = divmod(int((each * gain).argmax()), len(sets))
                wave.append((which, best))
                needed *= 1.0 - met[which] * covers[:, best]
                each[:, best] = -1.0
                if len(wave) == first or number == len(sets) - 1:
                    chosen = np.array(wave)
                    taken += [(tilts[which], best) for which, best in wave]
                    wave, first = [], further
                    yield np.ascontiguousarray(sets[chosen[:, 1]]), tilts[chosen[:, 0]]
                    if known is not self._tilts:
                        break  # all sets once more, with the tilts that were told
            else:
                return

    def tell(self, tilt: Floats) -> None:
        """Take tilts (2,) for known, those of a pose that is no accident."""
        self._tilts = tilt[None]

    def add(self, sets: Integers, tilts: Floats) -> None:
        """Record that sets (S, size) with tilts (S, 2) were tried with all their images."""
        self._tried.extend(zip(self._last(sets).T, tilts, strict=True))

    def missed(self, matched: int) -> float:
        """Probability that none of the sets tried led to a pose with so many matches, whichever points those are."""
        if not self._tried:
            return 1.0
        last, tilts = (np.array(part) for part in zip(*self._tried, strict=True))
        return float(np.where(last < matched, self._lost(tilts), 1.0).prod(axis=0, dtype=np.float64).mean())

    def _last(self, sets: Integers) -> NDArray[np.int32]:
        """Place (ORDERS, S) of the last point of sets (S, size) in each order."""
        return np.asarray(self._rank[:, sets].max(axis=2))

    def _lost(self, tilts: Floats) -> NDArray[np.float32]:
        """Probability (S, ORDERS) that a set with tilts (S, 2) leads to nothing though all of it is shown."""
        off2 = ((tilts[:, None] - self._tilts) ** 2).sum(axis=2)
        met = np.broadcast_to(np.exp(-0.5 * off2 / NEAR**2), (len(tilts), ORDERS))
        return np.asarray(1.0 - (1.0 - LOST) * met, np.float32)
