"""Weights of candidates: what they mean, that likelihood ratios help, and that others create no trust."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.task import candidate_log_odds

Floats = NDArray[np.float64]
CAMERA = rm.Camera(800.0, 800.0, 320.0, 240.0)


def test_weights_that_know_nothing_are_no_evidence_in_the_mean() -> None:
    weights = np.random.default_rng(0).exponential(size=(1, 6)) ** 3
    factors = np.exp(candidate_log_odds(weights))
    assert np.mean([factors[0, order[0]] for order in permutations(range(6))]) == pytest.approx(1.0)


def test_only_ratios_within_a_row_count() -> None:
    rng = np.random.default_rng(1)
    weights, factors = rng.uniform(0.1, 2.0, (3, 5)), rng.uniform(0.1, 9.0, (3, 1))
    weights[1, 2] = weights[2] = 0.0
    np.testing.assert_allclose(candidate_log_odds(factors * weights), candidate_log_odds(weights))
    assert candidate_log_odds(weights)[1, 2] == -np.inf
    np.testing.assert_array_equal(candidate_log_odds(np.where(weights > 0.0, 7.0, 0.0))[0], np.zeros(5))
    own = np.array([[True, True, False, False, False]] * 3)  # of a rig, the detections of a sighting's camera
    np.testing.assert_allclose(candidate_log_odds(weights, own)[0, :2], candidate_log_odds(weights[:1, :2])[0])


def scene(seed: int) -> tuple[Floats, Floats, NDArray[np.int64], Floats]:
    """Four LEDs among six clutter points, and the likelihood ratios of a measurement of each one's brightness."""
    rng = np.random.default_rng([seed, 78])
    points = rng.uniform(-0.15, 0.15, (4, 3))
    place = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.8, 1.4)])
    pixels = CAMERA.project(points @ Rotation.random(random_state=seed).as_matrix().T + place)
    target = np.concatenate([pixels + rng.normal(0.0, 0.3, (4, 2)), rng.uniform((0, 0), (640, 480), (6, 2))])
    bright = rng.normal(size=4)
    measured = np.concatenate([bright + rng.normal(0.0, 0.4, 4), rng.normal(size=6)])
    off = (bright[:, None] - measured) / 0.4
    return points, target, np.arange(4), np.exp(0.5 * (measured**2 - off**2)) / 0.4 + 1e-6


def test_likelihood_ratios_help_and_random_weights_make_nothing_trusted() -> None:
    trusted = {"none": 0, "ratios": 0, "random": 0}
    for seed in range(12):
        points, target, truth, ratios = scene(seed)
        random = np.exp(np.random.default_rng(seed).normal(0.0, 3.0, ratios.shape))
        for name, weights in (("none", None), ("ratios", ratios), ("random", random)):
            match = rm.match(points, target, rm.P3P(CAMERA), noise=0.3, candidates=weights)
            trusted[name] += bool(match)
            assert not match or (match.assignment[match.assignment >= 0] == truth[match.assignment >= 0]).all()
    assert trusted["none"] <= 3
    assert trusted["random"] <= 3
    assert trusted["ratios"] >= 6


def test_ratios_help_in_space() -> None:
    """Three of five markers among strays: their triangle alone is not enough, with what is known of them it is."""
    trusted = np.zeros(2, np.int64)
    for seed in range(20):
        rng = np.random.default_rng([seed, 79])
        points = rng.uniform(-0.08, 0.08, (5, 3))
        strays = rng.uniform(-0.3, 0.3, (20, 3))
        target = np.concatenate([points[:3] + rng.normal(0.0, 0.002, (3, 3)), strays])
        ratios = np.where(np.arange(23) == np.arange(5)[:, None], 8.0, rng.uniform(0.2, 1.8, (5, 23)))
        for k, weights in enumerate((None, ratios)):
            match = rm.match(points, target, rm.Rigid(3), noise=0.002, candidates=weights)
            trusted[k] += bool(match) and (match.assignment[:3] == np.arange(3)).all()
    assert trusted[1] >= trusted[0] + 4
