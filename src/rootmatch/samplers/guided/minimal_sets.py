"""Minimal sets of source points in the order in which they are tried: wide ones first."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

ALL = 6_000
"""Minimal sets up to which all are listed; beyond, they are drawn."""
DRAWN = 1_024
"""Drawn at a time, of which the wider half is used."""
FIRST_WAVE, LARGEST_WAVE = 8, 128
"""Minimal sets that are tried side by side; each wave is twice the one before."""
EVENNESS = 0.7
"""The widths are blurred by a random factor from here to 1, so that no one point is in all of the first sets."""


def minimal_sets(places: NDArray[np.float64], size: int, rng: np.random.Generator) -> Iterator[Integers]:
    """Waves of minimal sets (W, size) of the points (n, 3), wide ones first.

    Where there are many the sets are drawn without end (a set may come again); otherwise each comes once.
    """
    n = len(places)
    wave = FIRST_WAVE
    listed = math.comb(n, size) <= ALL
    ranked = np.empty((0, size), np.int64)
    while True:
        if len(ranked) < wave:
            if listed:
                drawn = np.array(list(combinations(range(n), size)), dtype=np.int64)
            else:
                drawn = _distinct(rng, max(DRAWN, 2 * wave), n, size)
            order = np.argsort(-width(places, drawn) * rng.uniform(EVENNESS, 1.0, len(drawn)), kind="stable")
            ranked = np.concatenate([ranked, drawn[order[: len(order) if listed else len(order) // 2]]])
        while len(ranked) and (listed or len(ranked) >= wave):
            yield np.ascontiguousarray(ranked[:wave])
            ranked = ranked[wave:]
            wave = min(2 * wave, LARGEST_WAVE)
        if listed:
            return


def _distinct(rng: np.random.Generator, count: int, n: int, size: int) -> Integers:
    """About ``count`` sets (…, size) of distinct indices below n."""
    drawn = np.sort(rng.integers(0, n, (count, size)), axis=1)
    return np.asarray(drawn[(drawn[:, 1:] != drawn[:, :-1]).all(axis=1)])


def width(places: NDArray[np.float64], sets: Integers) -> NDArray[np.float64]:
    """How well sets (S, m) predict: the least altitude of a triangle, the distance of a pair, (S,)."""
    corners = places[sets]
    first = corners[:, 1] - corners[:, 0]
    if sets.shape[1] == 2:
        return np.asarray(np.sqrt((first**2).sum(axis=1)))
    second = corners[:, 2] - corners[:, 0]
    longest = np.maximum((first**2).sum(axis=1), (second**2).sum(axis=1))
    longest = np.maximum(longest, ((second - first) ** 2).sum(axis=1))
    area2 = (np.cross(first, second) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(area2 / np.maximum(longest, 1e-300)))


def widest(places: NDArray[np.float64], members: Integers, size: int, count: int, rng: np.random.Generator) -> Integers:
    """Up to ``count`` wide sets (≤ count, size) among some of the points."""
    if math.comb(len(members), size) <= 64:
        drawn = np.array(list(combinations(range(len(members)), size)), dtype=np.int64).reshape(-1, size)
    else:
        drawn = _distinct(rng, 64, len(members), size)
    sets = members[drawn]
    return sets[np.argsort(-width(places, sets), kind="stable")[:count]]


def others_of(sets: Integers, n: int) -> Integers:
    """The points (S, n − m) that are not in each set, ascending."""
    free = np.ones((len(sets), n), np.bool_)
    np.put_along_axis(free, sets, False, axis=1)
    return np.nonzero(free)[1].reshape(len(sets), n - sets.shape[1])
