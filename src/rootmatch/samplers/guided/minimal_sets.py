"""Minimal sets of source points in the order in which they are tried: wide ones first."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from rootmatch.algebra.rotation import cross
from rootmatch.arrays import Floats, Integers
from rootmatch.hypergraph.enumeration import subsets
from rootmatch.hypergraph.random_tuples import distinct_sets, distinct_tuples

LISTED = 6_000
"""Minimal sets up to which all are listed, each once; beyond, they are drawn."""
DRAWN = 1_024
"""Minimal sets drawn at once."""
WIDER_PART = 0.5
"""Fraction of the drawn sets that is used, the wider ones."""
FIRST_WAVE, LARGEST_WAVE = 8, 128
"""Minimal sets that are tried together at first, and at most; each wave is twice the one before."""
FEWEST = 2
"""Fewest of a first wave, which has at most a tenth of all sets: where six points of six are seen, two sets are enough
to know that no such pose was missed."""
EVENNESS = 0.7
"""Widths are blurred by a random factor from here to 1, so that no one point is in all of the first sets."""
DRAWN_IN_PART = 8
"""Sets of a part of the points of which the widest is tried. A round value."""
DRAWN_IN_CLUSTER = 64
"""Minimal sets among the points of a cluster of hypotheses, of which the widest are solved."""


def minimal_sets(positions: Floats, size: int, rng: np.random.Generator) -> Iterator[Integers]:
    """Waves of minimal sets (W, size) of the points (n, 3), wide ones first.

    Where there are many the sets are drawn without end (a set may come again); otherwise each comes once.
    """
    n = len(positions)
    every = math.comb(n, size)
    wave = min(FIRST_WAVE, max(FEWEST, every // 10))
    listed = every <= LISTED
    ranked = np.empty((0, size), np.int64)
    while True:
        if len(ranked) < wave:
            if listed:
                drawn = subsets(n, size)
            else:
                # at least so many that the wider part makes a wave
                drawn = distinct_sets(rng, max(DRAWN, math.ceil(wave / WIDER_PART)), n, size)
            blurred = width(positions, drawn) * rng.uniform(EVENNESS, 1.0, len(drawn))
            used = len(drawn) if listed else int(WIDER_PART * len(drawn))
            ranked = np.concatenate([ranked, drawn[np.argsort(-blurred)[:used]]])
        while len(ranked) and (listed or len(ranked) >= wave):
            yield np.ascontiguousarray(ranked[:wave])
            ranked = ranked[wave:]
            wave = min(2 * wave, LARGEST_WAVE)
        if listed:
            return


def sets_of_parts(positions: Floats, size: int, rng: np.random.Generator) -> Iterator[Integers]:
    """Waves of minimal sets (W, size) of parts of the points (n, 3), without end; each part is of any size.

    An image may show no more of an object: of a long row of lamps hardly a wide set is then seen as a whole.
    """
    n, wave = len(positions), FIRST_WAVE
    while True:
        near = distances2(positions, wave, rng).argsort(axis=1)
        count = np.exp(rng.uniform(math.log(size), math.log(n + 1), wave)).astype(np.int64)
        places = distinct_tuples(rng, (wave, DRAWN_IN_PART), np.maximum(count, size)[:, None], size)
        part = np.arange(wave)
        drawn = near[part[:, None, None], places]
        yield drawn[part, width(positions, drawn.reshape(-1, size)).reshape(wave, -1).argmax(axis=1)]
        wave = min(2 * wave, LARGEST_WAVE)


def distances2(positions: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Squared distances (``count``, n) of points (n, 3) from places that are spread as they are, less a constant."""
    places = positions - positions.mean(axis=0)
    about = rng.standard_normal((count, len(places))) @ places / math.sqrt(len(places))
    return np.asarray((places**2).sum(axis=1) - 2.0 * about @ places.T)


def alternate(first: Iterator[Integers], second: Iterator[Integers]) -> Iterator[Integers]:
    """Waves of two sources in turn, until the first one ends."""
    for wave in first:
        yield wave
        yield next(second)


def width(positions: Floats, sets: Integers) -> Floats:
    """How well sets (S, m) predict: the least altitude of a triangle, the distance of a pair, (S,)."""
    if sets.shape[1] == 2:
        # coordinate by coordinate: of five thousand pairs in a third of the time
        axes = np.ascontiguousarray(positions.T)
        apart = axes.take(sets[:, 1], axis=1) - axes.take(sets[:, 0], axis=1)
        return np.asarray(np.sqrt((apart * apart).sum(axis=0)))
    corners = positions[sets]
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    longest = np.maximum((first**2).sum(axis=1), (second**2).sum(axis=1))
    longest = np.maximum(longest, ((second - first) ** 2).sum(axis=1))
    area2 = (cross(first, second) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(area2 / np.maximum(longest, 1e-300)))


def widest_sets(positions: Floats, members: Integers, size: int, count: int, rng: np.random.Generator) -> Integers:
    """Up to ``count`` wide sets (≤ count, size) among some of the points."""
    if math.comb(len(members), size) <= DRAWN_IN_CLUSTER:
        drawn = subsets(len(members), size)
    else:
        drawn = distinct_sets(rng, DRAWN_IN_CLUSTER, len(members), size)
    sets = members[drawn]
    return sets[np.argsort(-width(positions, sets), kind="stable")[:count]]


def at_every_root(sets: Integers, images: Integers, solutions: int) -> tuple[Integers, Integers]:
    """Minimal sets (S, m) and their images (S, m), once for each solution: (K, m) and, after the root, (K, 1 + m)."""
    roots = np.tile(np.arange(solutions), len(sets))
    return np.repeat(sets, solutions, axis=0), np.column_stack([roots, np.repeat(images, solutions, axis=0)])


def nearest_neighbours(positions: Floats, maximum: int) -> Integers:
    """The nearest of the points (n, 2 or 3) to each, itself left out, nearest first: (n, at most ``maximum``)."""
    from scipy.spatial import cKDTree  # slow to import, and only large objects need it

    k = min(maximum, len(positions) - 1)
    _, found = cKDTree(positions).query(positions, k=k + 1)
    others = np.argsort(found == np.arange(len(positions))[:, None], axis=1, kind="stable")[:, :k]
    return np.ascontiguousarray(np.take_along_axis(found, others, axis=1).astype(np.int64))


def nearest_other_points(triples: Integers, neighbours: Integers) -> Integers:
    """The ``neighbours`` (n, k) of the first point of triples (T, 3), nearest first, without their own: (T, k − 2)."""
    near = neighbours[triples[:, 0]]
    own = (near[:, :, None] == triples[:, None, :]).any(axis=2)
    order = np.argsort(own, axis=1, kind="stable")[:, : near.shape[1] - 2]
    return np.ascontiguousarray(np.take_along_axis(near, order, axis=1))


def remaining_points(sets: Integers, n: int) -> Integers:
    """The points (S, n − m) that are not in each set, ascending."""
    free = np.ones((len(sets), n), np.bool_)
    free[np.arange(len(sets))[:, None], sets] = False
    return np.nonzero(free)[1].reshape(len(sets), n - sets.shape[1])
