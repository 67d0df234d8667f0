"""Noise that differs by axis between two point sets: what no motion fits."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm

TOOL = np.array([[0.0, 0.0, 0.0], [55.0, 0.0, 0.0], [20.0, 45.0, 0.0], [80.0, 40.0, 12.0]])


@pytest.mark.parametrize("count", [3, 4, 7])
@pytest.mark.parametrize("problem", [rm.Rigid(), rm.Rigid(mirror=True), rm.Similarity()])
def test_where_nothing_fits_nothing_is_found(count: int, problem: rm.Rigid) -> None:
    target = np.random.default_rng(count).uniform(-900.0, 900.0, (count, 3))
    noise = (0.0, np.tile([0.15, 0.15, 0.45], (count, 1)))
    match = rm.match(TOOL, target, problem, noise=noise)
    assert match.status is rm.Status.UNTRUSTED
    assert match.probability is not None
    assert match.probability < 0.5
