"""Several motions that nobody told apart: what the model of one motion says of each, and of all of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.simulation.scenes import up2p_scene

SIGMA = 0.0005


def bodies(seed: int, count: int, hidden: int, stray: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (7 · count, 3) of bodies, what is measured of them with some hidden, and the truth."""
    rng = np.random.default_rng(seed)
    points, moved = [], []
    for k in range(count):
        body = rng.uniform(-0.1, 0.1, (7, 3))
        points.append(body + np.array([0.3 * k, 0.0, 0.0]))
        moved.append(body @ Rotation.random(random_state=rng).as_matrix().T + np.array([0.3 * k, 0.0, 1.0]))
    source, every = np.concatenate(points), np.concatenate(moved)
    shown = np.sort(rng.permutation(len(source))[hidden:])
    target = every[shown] + SIGMA * rng.normal(size=(len(shown), 3))
    target = np.concatenate([target, rng.uniform(every.min(axis=0), every.max(axis=0), (stray, 3))])
    truth = np.full(len(source), -1)
    truth[shown] = np.arange(len(shown))
    return source, target, truth


@pytest.mark.parametrize("motions", [2, "auto"])
def test_a_hidden_point_gets_no_stray(motions: int | str) -> None:
    for seed in range(4):
        source, target, truth = bodies(seed, 2, 2, 2)
        match = rm.match(source, target, rm.Rigid(), noise=(0.0, SIGMA), motions=motions)
        assert match.status is rm.Status.MATCHED
        assert match.probability is not None
        assert match.probability >= 0.95
        matched = match.assignment >= 0
        assert (match.assignment == truth)[matched].all()
        assert (match.confidence[matched] > 0.9).all()
        for number, pose in enumerate(match.poses):
            own = match.motion_labels == number
            assert pose is not None
            off = pose.transform(source[own]) - target[match.assignment[own]]
            assert np.linalg.norm(off, axis=1).max() < 6.0 * SIGMA
            assert len(pose.inliers) == own.sum()


def test_a_motion_whose_noise_was_stated_too_small_keeps_its_matches() -> None:
    source, target, truth = bodies(0, 2, 0, 0)
    target[7:] += 3.0 * SIGMA * np.random.default_rng(0).normal(size=(7, 3))
    match = rm.match(source, target, rm.Rigid(), noise=(0.0, SIGMA), motions=2)
    assert match.status is rm.Status.UNTRUSTED
    assert np.count_nonzero(match.assignment == truth) == 13  # one is too far off
    assert (match.motion_labels[7:] >= 0).sum() == 6


def test_the_probability_of_all_is_below_that_of_each() -> None:
    source, target, _ = bodies(3, 3, 0, 0)
    match = rm.match(source, target, rm.Rigid(), noise=(0.0, SIGMA), motions=3)
    alone = rm.match(source[:7], target[:7], rm.Rigid(), noise=(0.0, SIGMA))
    assert alone.probability is not None
    # alone there are no strays; targets of the other motions make each match a little less sure
    assert match.probability == pytest.approx(alone.probability**3, abs=2e-3)
    assert match.probability < alone.probability


def test_motions_of_unrelated_points_go() -> None:
    rng = np.random.default_rng(5)
    source, target = rng.uniform(-1.0, 1.0, (2, 12, 3))
    match = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.02), motions=2)
    assert match.status is rm.Status.UNTRUSTED
    assert match.probability is not None
    assert match.probability < 0.5
    assert match.confidence.shape == (12,)


def test_motions_in_an_image_have_a_probability() -> None:
    scene = up2p_scene(12, 0, noise=0.5, seed=4, motions=2)
    match = rm.match(scene.source, scene.target, scene.problem, noise=0.5, motions=2)
    assert match.status is rm.Status.MATCHED
    assert match.probability is not None
    assert match.probability >= 0.95


def arm(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """LEDs (12, 3) of two links of an arm, six each, their image at another angle of the joint, and the truth."""
    rng = np.random.default_rng([seed, 12])
    links = [rng.uniform((-0.05, -0.05, 0.0), (0.05, 0.05, 0.4), (6, 3)) for _ in range(2)]
    links[1] += (0.0, 0.0, 0.45)
    joint = np.array([0.0, 0.0, 0.42])
    bent = Rotation.from_rotvec([rng.uniform(0.4, 1.6), 0.0, rng.uniform(-1.0, 1.0)])
    moved = np.concatenate([links[0], bent.apply(links[1] - joint) + joint])
    placed = Rotation.random(random_state=rng).apply(moved - (0.0, 0.0, 0.3))
    placed[:, 2] += 1.5
    pixels = 1200.0 * placed[:, :2] / placed[:, 2:] + (640.0, 480.0)
    shown = np.flatnonzero(rng.random(12) < 0.85)
    clutter = rng.uniform((200.0, 100.0), (1100.0, 850.0), (rng.integers(0, 4), 2))
    truth = np.full(12, -1)
    truth[shown] = np.arange(len(shown))
    return (
        np.concatenate(links),
        np.concatenate([pixels[shown] + rng.normal(0.0, 0.3, (len(shown), 2)), clutter]),
        truth,
    )


def test_a_motion_that_was_asked_for_is_searched_for() -> None:
    """The packing missed motions of five points: one motion was trusted, and the points left were surely unmatched."""
    problem, both, partly = rm.P3P(rm.Camera(1200.0, 1200.0, 640.0, 480.0)), 0, 0
    for seed in range(12):
        source, target, truth = arm(seed)
        match = rm.match(source, target, problem, noise=0.3, motions=2)
        unmatched = match.assignment < 0
        if match.status is not rm.Status.UNTRUSTED:
            assert not (match.confidence[unmatched & (truth >= 0)] > 0.9).any()
        count = match.motion_labels.max() + 1
        if match:
            assert count == 2
            assert (match.assignment == truth)[~unmatched].all()
            both += 1
        elif count == 1:
            assert match.status is rm.Status.AMBIGUOUS
            assert "1 of 2 motions were found" in match.advice
            partly += 1
    assert both >= 7
    assert partly >= 1


def test_a_missing_motion_leaves_nothing_open_if_nothing_is_left() -> None:
    source, target, _ = arm(0)
    first = Rotation.from_rotvec((0.3, -0.5, 0.2)).apply(source[:6])
    first[:, 2] += 1.5
    target = 1200.0 * first[:, :2] / first[:, 2:] + (640.0, 480.0)
    match = rm.match(source, target, rm.P3P(rm.Camera(1200.0, 1200.0, 640.0, 480.0)), noise=0.3, motions=2)
    assert match
    np.testing.assert_array_equal(match.assignment, [0, 1, 2, 3, 4, 5, -1, -1, -1, -1, -1, -1])
    assert (match.confidence[6:] > 0.99).all()
