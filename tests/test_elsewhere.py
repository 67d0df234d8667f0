"""Points that no camera shows, of something that has other points in their stead."""

from __future__ import annotations

import numpy as np

import rootmatch as rm
from hall_scenes import RIG, SIGMA, cluster, images

SEEDS = range(1000, 1006)


def found(seed: int, *, elsewhere: int, covered: int) -> rm.Match:
    """A cluster of six markers, of which the last ones are elsewhere, and the last ones are covered."""
    rng = np.random.default_rng(seed)
    points = cluster(rng, 6)
    built = points.copy()
    built[6 - elsewhere :] = cluster(rng, elsewhere)
    shown = np.repeat([0.8, 0.0], [6 - covered, covered])
    return rm.match(points, images(rng, built, shown)[0], rm.P3P(RIG), noise=SIGMA)


def test_two_points_that_are_elsewhere_may_be_of_something_else() -> None:
    """Four of six points match, and six cameras see two more: the body with two points moved, or another one."""
    for seed in SEEDS:
        match = found(seed, elsewhere=2, covered=0)
        assert not match
        assert match.probability is not None
        assert match.probability < 0.92


def test_two_points_that_are_covered_are_not_elsewhere() -> None:
    for seed in SEEDS:
        match = found(seed, elsewhere=0, covered=2)
        assert match
        assert match.probability is not None
        assert match.probability > 0.99
