"""Trees of markers in space: another one of nearly the shape, its mirror image, a bent one, and larger noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats
from rootmatch.model.image_alike import ERRORS
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.point_set_off import log_odds_of_errors, log_odds_of_reflection
from rootmatch.model.weighed_labellings import MIRRORED
from rootmatch.problems.points import PointClouds
from rootmatch.problems.pose_fit.reference_point import body_radius

SIGMA = 0.25
TREE = np.array([[0.0, 0.0, 0.0], [50.0, 5.0, -8.0], [-6.0, 70.0, 9.0], [42.0, 92.0, 3.0], [20.0, 41.0, 17.0]])
SEEDS = (0, 16)
FREE = np.array([[-200.0, -150.0, 800.0], [200.0, 150.0, 1300.0]])


def flight(frames: int, rng: np.random.Generator) -> list[tuple[Floats, Floats]]:
    """Motions (R, t) of a hand with a tree, in millimetres."""
    start, turn = rng.normal(0.0, 3.0, 3), rng.normal(0.0, 0.01, 3)
    place, speed = np.array([20.0, -10.0, 1000.0]), rng.normal(0.0, 1.0, 3)
    turns = [Rotation.from_rotvec(k * turn) * Rotation.from_rotvec(start) for k in range(frames)]
    return [(one.as_matrix(), place + k * speed) for k, one in enumerate(turns)]


def cloud(
    tree: Floats, motion: tuple[Floats, Floats], strays: Floats, rng: np.random.Generator, sigma: float = SIGMA
) -> Floats:
    """What a tracker sees of a tree, and of strays that stay."""
    points = np.concatenate([tree @ motion[0].T + motion[1], strays])
    return points + rng.normal(0.0, sigma, points.shape)


@pytest.mark.parametrize("scale", [1.0, 0.03])
def test_the_odds_are_the_evidence_of_points_that_are_off_with_all_that_is_near(scale: float) -> None:
    rng = np.random.default_rng(3)
    tree, off = scale * TREE[:4], np.zeros((4, 3))
    off[3] = scale * np.array([3.0, -2.0, 2.0])
    seen = np.concatenate([tree + off, scale * rng.uniform(-300.0, 300.0, (4, 3))])
    seen = seen + rng.normal(0.0, scale * SIGMA, seen.shape)
    clouds = PointClouds(tree, seen, np.zeros(4), np.full(8, (scale * SIGMA) ** 2), scaled=False, mirror=False)
    model, own = PointSetModel(clouds), np.array([0, 1, 2, -1])
    mass = float(model.judge_one(own).log_odds[0])
    odds = log_odds_of_errors(model, own, mass)
    assert odds is not None
    for error, told in zip(ERRORS[2:] * body_radius(tree), odds[2:], strict=True):
        wide = PointSetModel(clouds.off_by(np.full(4, error)))
        assert told == pytest.approx(float(wide.judge(np.arange(4)[None]).log_odds[0]) - mass, abs=1e-6)
    assert odds[2] > 2.0, "a target beside the place of the fourth is nothing by chance"
    taken = np.arange(8) == 3
    assert log_odds_of_errors(model, own, mass, taken) is None, "it is a marker of another body"


def another_tree(seed: int) -> tuple[int, int]:
    """Frames in which another tree is taken for one that left, and those before in which that is trusted."""
    rng = np.random.default_rng(seed)
    tree, strays = TREE[:4], rng.uniform(*FREE, (4, 3))
    other = tree + rng.normal(0.0, 1.5, tree.shape)
    tracker, before, after = rm.Tracker(tree, rm.Rigid(), noise=(0.0, SIGMA)), 0, 0
    for motion in flight(30, rng):
        before += bool(tracker.update(cloud(tree, motion, strays, rng)))
    for _ in range(12):
        tracker.update(strays + rng.normal(0.0, SIGMA, strays.shape))
    for motion in flight(50, rng):
        after += bool(tracker.update(cloud(other, motion, strays, rng)))
    return after, before


def test_another_tree_of_nearly_the_shape_is_not_followed() -> None:
    wrong, right = np.sum([another_tree(seed) for seed in SEEDS], axis=0)
    assert right >= 29 * len(SEEDS)
    assert wrong <= 8, "of 100; 66 where each frame is weighed by its matches alone"


def test_a_tree_that_is_bent_while_it_is_followed_stays_trusted() -> None:
    rng = np.random.default_rng(5)
    strays, bent = rng.uniform(*FREE, (4, 3)), TREE.copy()
    bent[1] += (1.5, -1.0, 1.0)
    tracker = rm.Tracker(TREE, rm.Rigid(), noise=(0.0, SIGMA))
    shown = [TREE if k < 60 else bent for k in range(110)]
    matched = [bool(tracker.update(cloud(*one, strays, rng))) for one in zip(shown, flight(110, rng), strict=True)]
    assert sum(matched[:60]) >= 59
    assert sum(matched[60:]) >= 40


def test_the_odds_of_a_mirror_image_are_its_evidence() -> None:
    rng = np.random.default_rng(4)
    seen = np.concatenate([TREE * (-1.0, 1.0, 1.0), rng.uniform(-300.0, 300.0, (4, 3))])
    seen = seen + rng.normal(0.0, SIGMA, seen.shape)
    clouds = PointClouds(TREE, seen, np.zeros(5), np.full(9, SIGMA**2), scaled=False, mirror=False)
    model, own = PointSetModel(clouds), np.array([0, 1, 2, -1, -1])
    mass = float(model.judge_one(own).log_odds[0])
    told = log_odds_of_reflection(model, own, mass)
    every = float(PointSetModel(clouds, mirror=True).judge(np.arange(5)[None]).log_odds[0])
    assert told == pytest.approx(every + math.log(MIRRORED) - mass, abs=1e-6)
    assert told > 20.0
    taken = np.isin(np.arange(9), (3, 4))
    assert log_odds_of_reflection(model, own, mass, taken) == -math.inf, "they are markers of another body"
    assert log_odds_of_reflection(model, np.arange(5), every) == -math.inf, "it explains all of them"


def mirror_image(seed: int) -> tuple[int, int, int]:
    """Frames in which a mirror image is trusted that has come into view, and most in a row; those of the tree before.

    The mirror image is beside the tree, which leaves, and first shows three markers alone.
    """
    rng = np.random.default_rng(seed)
    tree, strays = TREE[[0, 1, 2, 4]], rng.uniform(*FREE, (3, 3))
    other, aside = tree * (1.0, 1.0, -1.0), np.array([150.0, 0.0, 0.0])
    tracker, right, wrong, longest, row = rm.Tracker(tree, rm.Rigid(), noise=(0.0, SIGMA)), 0, 0, 0, 0
    for k, (R, t) in enumerate(flight(60, rng)):
        image = other[rng.random(4) > 0.05] if k != 30 else other[:3]
        shown = np.concatenate([strays, image @ R.T + t + aside])
        match = tracker.update(cloud(tree if k < 30 else tree[:0], (R, t), shown, rng))
        right += bool(match) and k < 30
        wrong += bool(match) and k >= 30
        row = row + 1 if match and k >= 30 else 0
        longest = max(longest, row)
    return wrong, longest, right


def test_a_mirror_image_is_neither_followed_nor_a_copy_beside_the_tree() -> None:
    every = np.array([mirror_image(seed) for seed in SEEDS])
    assert every[:, 0].sum() <= 6, "of 60; 56 where reflections count in a search alone"
    assert every[:, 1].max() <= 2
    assert every[:, 2].sum() >= 54, "of 60; none where either may be the copy"


def test_noise_of_twice_the_size_is_learned_in_space() -> None:
    rng = np.random.default_rng(7)
    strays = rng.uniform(*FREE, (4, 3))
    tracker = rm.Tracker(TREE, rm.Rigid(), noise=(0.0, SIGMA))
    matched = [bool(tracker.update(cloud(TREE, one, strays, rng, 2.0 * SIGMA))) for one in flight(60, rng)]
    assert sum(matched[30:]) >= 29
    assert 1.3 < tracker.noise_factor < 2.0
