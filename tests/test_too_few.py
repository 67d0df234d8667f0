"""Detections of many points that are too few to tell a pose from chance: no search, and nothing else is given up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats
from rootmatch.samplers.guided.hypotheses import Hypotheses, recurrence_miss_probability
from rootmatch.samplers.guided.minimal_sets import sets_of_parts
from rootmatch.samplers.guided.sequential_test import sequential_test
from rootmatch.samplers.guided.stopping import min_telling_matches

CAMERA = rm.Camera(1800.0, 1800.0, 640.0, 480.0)
AT_THE_STARS = rm.PosePrior(position=((0, 0, 0), 1e-6))


def sky(seed: int, stars: int, shown: int, strays: int) -> tuple[Floats, Floats]:
    """Directions of stars, the first of them in the image, among stray detections."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform((100, 100), (1180, 860), (shown, 2))
    seen = CAMERA.bearings(pixels) @ Rotation.random(random_state=seed).as_matrix()
    others = rng.normal(size=(stars - shown, 3))
    others /= np.linalg.norm(others, axis=1)[:, None]
    target = np.vstack([pixels + rng.normal(0, 0.3, pixels.shape), rng.uniform((0, 0), (1280, 960), (strays, 2))])
    return np.vstack([seen, others]), target


@pytest.mark.parametrize("prior", [None, AT_THE_STARS])
def test_nothing_is_searched_where_chance_explains_as_much(prior: rm.PosePrior | None) -> None:
    match = rm.match(*sky(0, 150, 2, 2), rm.P3P(CAMERA), noise=0.3, prior=prior)
    assert match.status is rm.Status.UNTRUSTED
    assert match.evaluated == 0
    assert match.advice.startswith("no trustworthy match: ")
    if prior is None:
        assert "4 detections are too few to tell a pose of 150 points from chance" in match.advice


def test_as_many_detections_of_fewer_points_are_searched() -> None:
    match = rm.match(*sky(1, 8, 4, 0), rm.P3P(CAMERA), noise=0.3)
    assert match.evaluated > 0


def test_no_more_is_searched_than_a_pose_takes_that_can_be_told() -> None:
    """Five of eight points in sixty detections are chance: a search meets every pose of six, and not all of five."""
    source = np.random.default_rng(5).uniform(-0.1, 0.1, (8, 3))
    target = np.random.default_rng(1001).uniform((0, 0), (1280, 960), (60, 2))
    match = rm.match(source, target, rm.P3P(rm.Camera(1000.0, 1000.0, 640.0, 480.0)), noise=0.5)
    assert match.status is rm.Status.UNTRUSTED
    assert match.evaluated < 45_000_000


def test_fewest_matches_that_tell_a_pose() -> None:
    """Each match beyond three is worth e⁹ here, and 10⁷ sets are tried, of which one in 19 odds may be chance."""
    density, variance = np.full(60, math.exp(-9.0) / (2.0 * math.pi)), np.ones(60)
    assert min_telling_matches(density, variance, 3, 1.0) == 4
    assert min_telling_matches(density, variance, 3, 1e6) == 5
    assert min_telling_matches(density, variance, 3, 1e7) == 6
    assert min_telling_matches(np.ones(60), variance, 3, 1e7) == 60


def test_what_is_known_still_finds_few_stars() -> None:
    source, target = sky(2, 150, 4, 0)
    match = rm.match(source, target, rm.P3P(CAMERA), noise=0.3, prior=AT_THE_STARS)
    assert match.status is rm.Status.MATCHED
    np.testing.assert_array_equal(match.assignment[:4], np.arange(4))


def test_a_test_does_not_assume_more_points_in_view_than_can_be() -> None:
    """Half of the right hypotheses have no hit among the first sixteen points of which one in twenty is seen."""
    sparse = sequential_test(1e-4, 0.05, 5, minimum=4, normals=False)
    usual = sequential_test(1e-4, 0.85, 20, minimum=4, normals=False)
    assert sparse.floor / sparse.miss > 30
    assert math.exp(usual.miss) == pytest.approx(0.8, abs=1e-3)


def test_sets_of_parts_have_different_points() -> None:
    waves = sets_of_parts(np.random.default_rng(0).normal(size=(5, 3)), 3, np.random.default_rng(1))
    for _ in range(4):
        wave = next(waves)
        assert wave.shape[1] == 3
        assert all(len(set(row)) == 3 for row in wave.tolist())
        assert wave.min() >= 0
        assert wave.max() < 5


def test_what_was_met_often_would_not_have_been_missed_elsewhere() -> None:
    best = np.array([0, 1, 2, 3, -1, -1])

    def batch(*sets: tuple[int, int, int]) -> Hypotheses:
        points = np.array(sets)
        images = np.column_stack([np.zeros(len(sets), np.int64), points])  # of each point its own number
        count = len(sets)
        return Hypotheses(points, images, np.ones(count), np.tile(best, (count, 1)), np.full((count, 6, 4), -1))

    assert recurrence_miss_probability(best, []) == 1.0
    assert recurrence_miss_probability(best, [batch((0, 1, 2))]) == 1.0
    assert recurrence_miss_probability(best, [batch((0, 1, 2), (2, 1, 0)), batch((1, 3, 4))]) == 1.0, (
        "two roots, and another pose"
    )
    assert recurrence_miss_probability(best, [batch((0, 1, 2), (1, 2, 3)), batch((0, 1, 2))]) == 0.25
