"""Which source points are visible together, by their normals: the order of minimal sets, and what a search has missed.

From any direction a third to a half of the points of a closed surface show their front. A wide minimal set is then
hardly ever visible as a whole, so sets are ordered by how many views they cover that those before them do not. A view
is a direction to the camera with the points that face it, less some that go undetected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.deadline import checkpoint
from rootmatch.hypergraph.random_tuples import distinct_sets
from rootmatch.samplers.guided.minimal_sets import EVENNESS, FIRST_WAVE, LARGEST_WAVE, LISTED, distances2, width

VIEWS = 512
"""Directions that stand for all."""
PARTS = 128
"""Views of an object without normals that stand for all. A round value."""
FACING = 0.25
"""Cosine between normal and direction to the camera above which a point counts as visible here: beyond 75° little light
comes back. An order and a probability follow from it; no point is taken to be hidden."""
DETECTED = 0.75
"""Fraction of the facing points that is detected in the views that the order is to cover."""
FAILURE = 0.5
"""Probability that a set leads to nothing though all of it is detected: noise, or clutter in its place. On the safe
side on the development seeds of benchmarks/constellations.py."""
ORDERED = 400
"""Sets ordered by what they cover; the rest follow by width and number of views. Takes a fifth of a second once for
each object."""
MISSED = 0.005
"""Probability of having missed a pose that explains as many points, below which a search ends. By construction."""
MISSED_OF_NOTHING = 0.05
"""The same where no pose is beyond chance and one that shows enough was hardly left unmet: as much may be missed beside
a match that is trusted."""
LOST = 0.25
"""Probability that a set leads to nothing though all of it is detected, where that is known: of triples listed by
shape, and without normals. In 180 development scenes of benchmarks/constellations.py (sim-15-20, sim-0-0, sim-5-0-near)
it was 0.06 to 0.08, in one scene of twenty above 0.25; in 62 of drones 0.13 where five points of six are seen."""
LOST_OF_ALL = 0.05
"""`LOST` where all points are detected, so that no hidden one ends a test: 0.001 in 200 scenes of drones."""
KNOWN = 2.0
"""Sets that such a probability is worth, before those of the object at hand tell another. A round value."""


def sphere(count: int) -> Floats:
    """Unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.arange(count) * (math.pi * (3.0 - math.sqrt(5.0)))
    radius = np.sqrt(1.0 - z * z)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])


def facing_points(normals: Floats, view_cosine: Floats | None = None) -> Bools:
    """Which points face the camera from each direction, (VIEWS, n); those without a normal always do.

    ``view_cosine`` (n,): cosines of the view angles, where they are given.
    """
    return np.asarray(_cosines(normals) > (FACING if view_cosine is None else view_cosine))


def _cosines(normals: Floats) -> Floats:
    """Cosines (VIEWS, n) between normals (n, 3) and the directions to the camera; those of no normal are beyond 1."""
    length = np.linalg.norm(normals, axis=1)
    cosine = sphere(VIEWS) @ (normals / np.where(length > 0.0, length, 1.0)[:, None]).T
    return np.where(length > 0.0, cosine, 2.0)


@cache_by_values(64)
def covisible_share(normals: Floats, view_cosine: Floats | None = None) -> float:
    """Share of all triples of points that a view shows, of those views that show three: 1 on one side of a plate.

    Parameters as for `facing_points`.
    """
    count = facing_points(normals, view_cosine).sum(axis=1).astype(np.float64)
    triples = (count * (count - 1.0) * (count - 2.0))[count >= 3.0]
    n = len(normals)
    return float(triples.mean()) / (n * (n - 1) * (n - 2)) if len(triples) else 0.0


@cache_by_values(64)
def detected_views(matched: int, normals: Floats, view_cosine: Floats | None = None) -> Bools:
    """Points (V, n) that may be detected together where ``matched`` are, in each view that can show so many.

    They are taken at random from those that face the camera and, where these do not suffice, from those that are seen
    edge-on. What shows fewer points from behind than a pose matches, such as a plate, is not seen from there.
    """
    cosine, rng = _cosines(normals), np.random.default_rng([matched, len(normals)])
    facing = facing_points(normals, view_cosine)
    shown = cosine > (0.0 if view_cosine is None else view_cosine)
    order = np.where(facing, rng.random(facing.shape), np.where(shown, 3.0 - cosine, 4.0))
    rank = np.argsort(np.argsort(order, axis=1), axis=1)
    count = shown.sum(axis=1)
    possible = count >= min(matched, int(count.max()))
    views = np.asarray((shown & (rank < matched))[possible])
    views.setflags(write=False)
    return views


@cache_by_values(64)
def views_of_parts(matched: int, positions: Floats) -> Bools:
    """Points (PARTS, n) that may be detected together where ``matched`` are and no normals tell which.

    In every second view they are any of the points (n, 3), in the others those nearest to some place: an image may show
    a part of an object.
    """
    rng = np.random.default_rng([matched, len(positions)])
    order = rng.random((PARTS, len(positions)))
    order[::2] = distances2(positions, PARTS // 2, rng)
    views = np.asarray(order.argsort(axis=1).argsort(axis=1) < matched)
    views.setflags(write=False)
    return views


def sets_within_views(sets: Integers, views: Bools) -> Bools:
    """Which sets (S, m) are wholly visible in which views (V, n): (V, S)."""
    inside = views[:, sets[:, 0]]
    for p in range(1, sets.shape[1]):
        inside = inside & views[:, sets[:, p]]
    return inside


def covering_waves(
    positions: Floats, normals: Floats, size: int, view_cosine: Floats | None = None
) -> Iterator[Integers]:
    """Waves of minimal sets (W, size) of points (n, 3): all, or as many as are listed.

    Those come first that cover views which the ones before do not.
    """
    ordered = covering_order(positions, normals, size, view_cosine)
    wave, done = FIRST_WAVE, 0
    while done < len(ordered):
        yield np.ascontiguousarray(ordered[done : done + wave])
        done, wave = done + wave, min(2 * wave, LARGEST_WAVE)


@cache_by_values(8)
def covering_order(positions: Floats, normals: Floats, size: int, view_cosine: Floats | None = None) -> Integers:
    """All sets (S, size) of `covering_waves`, one after the other."""
    n = len(positions)
    rng = np.random.default_rng([n, size])
    views = facing_points(normals, view_cosine)
    views &= rng.random(views.shape) < DETECTED
    if math.comb(n, size) <= LISTED:
        sets = np.array(list(combinations(range(n), size)), np.int64).reshape(-1, size)
    else:
        sets = np.unique(distinct_sets(rng, LISTED, n, size), axis=0)
    wide = width(positions, sets) * rng.uniform(EVENNESS, 1.0, len(sets))
    worth = (wide / max(float(wide.max()), 1e-300)).astype(np.float32)
    covers = np.ascontiguousarray(sets_within_views(sets, views).T).astype(np.float32)
    needed = np.ones(VIEWS, np.float32)
    free = np.ones(len(sets), np.bool_)
    first = []
    for _ in range(min(ORDERED, len(sets))):
        checkpoint()
        gain = np.where(free, worth * (covers @ needed), -1.0)
        best = int(gain.argmax())
        if gain[best] <= 0.0:
            break
        first.append(best)
        free[best] = False
        needed *= 1.0 - np.float32(1.0 - FAILURE) * covers[best]
    rest = np.flatnonzero(free)
    rest = rest[np.argsort(-(worth * covers.sum(axis=1))[rest], kind="stable")]
    ordered: Integers = sets[np.concatenate([np.array(first, np.int64), rest])]
    ordered.setflags(write=False)
    return ordered


def random_miss_probability(matched: int, n: int, size: int, sets: float) -> float:
    """Probability that none of so many sets met a pose with ``matched`` of n points detected, any of them."""
    inside = math.comb(matched, size) / math.comb(n, size)
    lost = LOST if matched < n else LOST_OF_ALL
    return float((1.0 - (1.0 - lost) * inside) ** sets)


def unmet_probability(minimum: int, maximum: int, n: int, size: int, sets: float) -> float:
    """Probability that an object shows ``minimum`` of its n points or more, and none of so many sets met its pose.

    It shows any number of points up to ``maximum`` as probably.
    """
    return sum(random_miss_probability(k, n, size, sets) for k in range(minimum, maximum + 1)) / (maximum + 1)


class TriedSets:
    """Which minimal sets a search has tried, and the probability of having missed a pose.

    ``views``: from a number of detected points to which (V, n) may be detected together; `detected_views` or
    `views_of_parts`. ``lost``: probability that a set leads to nothing though all of it is detected.
    """

    def __init__(self, views: Callable[[int], Bools], lost: float = FAILURE) -> None:
        self.views, self.lost = views, lost
        self.sets: list[Integers] = []
        self._of_pose = [KNOWN * lost, KNOWN]

    def add(self, sets: Integers) -> None:
        """Record that these sets (S, m) were tried with all their images."""
        self.sets.append(sets)

    def learn(self, own: int, met: int) -> None:
        """Take in that of so many sets of a pose that is known as many have met it again: a rival is met no better."""
        self._of_pose[0] += own - met
        self._of_pose[1] += own
        self.lost = self._of_pose[0] / self._of_pose[1]

    def unmet(self, matched: int) -> Floats:
        """Probability (V,) that a pose with so many detected points was met by none of the sets, in each view."""
        views = self.views(matched)
        if not self.sets:
            return np.ones(len(views))
        return np.asarray(self.lost ** sets_within_views(np.concatenate(self.sets), views).sum(axis=1))

    def missed(self, matched: int) -> float:
        """The same, of any view."""
        return float(self.unmet(matched).mean())
