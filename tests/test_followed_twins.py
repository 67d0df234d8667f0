"""Poses that look the same, followed with predictions of which one is much better than the other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import norm

import rootmatch as rm
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_evidence, weigh_poses
from rootmatch.model.mode_search import find_modes
from rootmatch.model.pose_density import Broad, Doubted, Gaussian
from rootmatch.model.proposals import Proposals
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.motion_filter import MotionFilter

Floats = NDArray[np.float64]

CAMERA = rm.Camera(800.0, 780.0, 320.0, 240.0)
VIEW = np.radians(70.0)
TURN = np.array([-1.0, 1.0, -1.0])
"""Half a turn about the y axis, which maps the body onto itself."""


def two_sides() -> tuple[Floats, Floats]:
    """Eight points on a dome and the same on its back, with normals."""
    side = np.random.default_rng(6).uniform(-0.3, 0.3, (8, 2))
    front = np.column_stack([side, 0.2 - (side**2).sum(axis=1)])
    normals = np.column_stack([4.0 * side, np.ones(8)])
    return np.concatenate([front, front * TURN]), np.concatenate([normals, normals * TURN])


def cosines(points: Floats, normals: Floats, R: Floats, t: Floats) -> Floats:
    """Cosines between normals and the directions to the camera."""
    place, normal = points @ R.T + t, normals @ R.T
    length = np.linalg.norm(place, axis=1) * np.linalg.norm(normal, axis=1)
    return np.asarray(-(place * normal).sum(axis=1) / length)


def test_a_poor_prediction_does_not_lose_to_a_good_one_of_the_pose_that_looks_the_same() -> None:
    """The right pose, 150 times as probable, is off by 15°: too far for its own prediction to find all six points."""
    points, normals = two_sides()
    R, t = Rotation.from_euler("xyz", [225.0, 0.0, 60.0], degrees=True).as_matrix(), np.array([0.1, 0.0, 3.0])
    seen = np.flatnonzero(cosines(points, normals, R, t) > np.cos(VIEW))
    rng = np.random.default_rng(1)
    shown = CAMERA.project(points[seen] @ R.T + t) + rng.normal(0.0, 0.2, (len(seen), 2))
    target = np.concatenate([shown, rng.uniform((0.0, 0.0), (640.0, 480.0), (5, 2))])
    off = Rotation.from_rotvec(np.radians(15.0) * np.array([np.cos(1.0), np.sin(1.0), 0.0])).as_matrix() @ R
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.2, normals=normals, view_angle=VIEW)
    tracker.update(np.empty((0, 2)), time=0.0)
    poor, good = np.diag(np.repeat([0.1, 0.02], 3) ** 2), 0.02**2 * np.eye(6)
    tracker._bodies[None].belief.poses = [
        FollowedPose(MotionFilter(points, rm.Pose(off, t, poor), 0.0)),
        FollowedPose(MotionFilter(points, rm.Pose(R * TURN, t, good), 0.0), -5.0),
    ]
    match = tracker.update(target)
    assert match.status is rm.Status.AMBIGUOUS
    every = [match.assignment, *(one for one, _ in match.alternatives[:2])]
    assert any(np.array_equal(one[seen], np.arange(len(seen))) for one in every)


def test_two_matches_about_a_prediction_are_weighed_against_each_alone() -> None:
    """One of them may be clutter: a wide prediction meets some by chance, and followed it turned a headset by 34°."""
    points, position = np.random.default_rng(4).uniform(-0.3, 0.3, (7, 3)), np.array([0.0, 0.0, 3.0])
    wide = np.diag(np.repeat([0.15, 0.03], 3) ** 2)
    gaussian = Gaussian(np.eye(3), position + points.mean(axis=0), wide, freedom=8.0)
    prior = Doubted([gaussian], [np.log(0.99)], Broad(), 0.01)
    shown = CAMERA.project(points[:1] + position)
    target = np.concatenate([shown, np.random.default_rng(3).uniform((0.0, 0.0), (640.0, 480.0), (6, 2))])
    model = DetectionModel(CAMERA, points, target, np.full(7, 0.2), prior=prior)
    both, pose = np.array([[0, 6, -1, -1, -1, -1, -1]]), (np.eye(3)[None], gaussian.position[None])
    modes = find_modes(model, Proposals(both, *pose))
    np.testing.assert_array_equal(modes.assignments, both)
    alone = np.array([np.where(np.arange(7) == k, both[0], -1) for k in (0, 1)])
    found, _ = settle_evidence(model, alone, *weigh_poses(model, alone, *(np.repeat(one, 2, axis=0) for one in pose)))
    every = np.logaddexp.reduce([modes.log_odds[0], *found.log_odds])
    assert modes.log_mass[0] == pytest.approx(every, abs=0.02)
    np.testing.assert_allclose(modes.local[0, :2], 1.0 - np.exp(found.log_odds[::-1] - every), atol=0.01)


@pytest.mark.parametrize("tilt", [0.0, 0.05, 0.3])
def test_visibility_is_its_mean_over_the_directions_that_a_pose_leaves_open(tilt: float) -> None:
    """Integrated numerically: a point that only this pose hides may well be seen."""
    points, normals = two_sides()
    model = DetectionModel(
        CAMERA, points, np.empty((0, 2)), np.empty(0), normals=normals, view_cosine=np.full(16, np.cos(VIEW))
    )
    turns = np.radians(np.linspace(100.0, 260.0, 41))
    rotations = Rotation.from_rotvec(turns[:, None] * np.array([1.0, 0.0, 0.0])).as_matrix()
    at = model.linearise_about(rotations, np.tile([0.0, 0.0, 3.0], (41, 1)))
    assert at.cosine is not None
    steps = np.linspace(-5.0, 5.0, 1001)
    cosine = at.cosine[..., None] + tilt * np.sqrt(1.0 - at.cosine[..., None] ** 2) * steps
    exact = np.where(cosine < np.cos(VIEW) - 0.15, 0.0, 0.02 + 0.98 * norm.cdf(cosine - np.cos(VIEW), scale=0.03))
    mean = (exact * norm.pdf(steps)).sum(axis=-1) / norm.pdf(steps).sum()
    told = model.visibility(at, np.full(41, tilt))
    np.testing.assert_allclose(told, mean, atol=0.02)
    likely = mean > 0.02
    np.testing.assert_allclose(np.log(told[likely]), np.log(mean[likely]), atol=0.7)


def test_poses_that_are_equal_stay_equal_however_long_they_are_followed() -> None:
    """A board that looks the same in four poses, with a hand before it now and then; rounding must not add up."""
    board = np.array([[30.0 * x, 30.0 * y, 0.0] for y in range(5) for x in range(7)])
    rng, tracker = np.random.default_rng(3), rm.Tracker(board, rm.P3P(CAMERA), noise=0.2)
    for k in range(60):
        turn = Rotation.from_euler("xyz", [0.4 * np.sin(k / 12.0), 0.3 * np.cos(k / 9.0), 0.03 * k])
        middle = np.array([60.0 * np.sin(k / 11.0), 30.0, 500.0 + 60.0 * np.cos(k / 13.0)])
        pixels = CAMERA.project(turn.apply(board - board.mean(axis=0)) + middle)
        seen = rng.random(len(board)) > 0.03
        if k % 20 > 11:
            seen &= pixels[:, 0] > np.quantile(pixels[:, 0], 0.45)
        target = pixels[seen] + rng.normal(0.0, 0.2, (np.count_nonzero(seen), 2))
        match = tracker.update(np.concatenate([target, rng.uniform((0.0, 0.0), (640.0, 480.0), (3, 2))]))
        assert match.status is rm.Status.AMBIGUOUS
        belief = tracker._bodies[None].belief
        assert belief.shares == pytest.approx(np.full(4, 0.25), abs=1e-6)
        for one in belief.poses:
            np.testing.assert_allclose(one.filter.R.T @ one.filter.R, np.eye(3), atol=1e-12)
