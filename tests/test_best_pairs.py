"""Pairs of points and detections that gain most, compiled, against SciPy's assignment."""

from __future__ import annotations

import numpy as np
import pytest

from rootmatch.model.compiled.best_pairs import pair_best
from rootmatch.model.prediction import Gated, assigned


@pytest.mark.parametrize("shape", [(1, 1), (3, 9), (9, 3), (6, 6), (24, 40)])
def test_pairs_are_those_that_gain_most(shape: tuple[int, int]) -> None:
    contested = 0
    for seed in range(30):
        rng = np.random.default_rng([seed, *shape])
        candidates, gains = rng.random(shape) < rng.uniform(0.05, 0.9), rng.normal(0.5, 2.0, shape)
        found = np.empty(shape[0], np.int64)
        pair_best(candidates, gains, found)
        best = assigned(Gated(candidates, gains, found, False))
        np.testing.assert_array_equal(found, best)
        likeliest = np.where(candidates, gains, -np.inf).argmax(axis=1)
        contested += bool((found >= 0).any() and (likeliest[found >= 0] != found[found >= 0]).any())
    assert contested or min(shape) == 1
