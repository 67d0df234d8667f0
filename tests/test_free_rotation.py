"""Poses that are free to turn about a line of points: what is told of them, and what a filter keeps."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import with_curvature
from rootmatch.tracking.motion_filter import MotionFilter


def free_about(axis: tuple[float, ...], arm: tuple[float, ...], sigma: float) -> np.ndarray:
    """Covariance of a pose whose position is an arm away from a line about which it is free to turn."""
    line = sigma * np.concatenate([axis, np.cross(axis, arm)])
    return np.outer(line, line) + 1e-4 * np.eye(6)


def test_a_covariance_has_the_arc_of_what_turns() -> None:
    """The square of how far an arc of 2 m leaves its tangent, as turns that are drawn have it."""
    sigma, arm = 0.2, np.array([2.0, 0.0, 0.0])
    told = with_curvature(free_about((0.0, 0.0, 1.0), tuple(arm), sigma))
    angles = np.random.default_rng(1).normal(0.0, sigma, 100_000)
    moved = Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0]).apply(arm) - arm
    expected = moved.T @ moved / len(angles) + 1e-4 * np.eye(3)
    np.testing.assert_allclose(np.diag(told)[3:], np.diag(expected), rtol=0.1)
    sure = free_about((0.0, 0.0, 1.0), tuple(arm), 0.001) / 100.0
    assert with_curvature(sure) is sure


def test_a_frame_that_tells_nothing_of_a_rotation_narrows_no_motion() -> None:
    """A fit that tilts a body by what was seen, and leaves its rotation about a line as open as it was."""
    before = free_about((0.0, 0.6, 0.8), (0.3, 0.1, 0.0), 0.5)
    source = np.random.default_rng(2).normal(size=(8, 3)) * 0.1
    source -= source.mean(axis=0)
    moving = MotionFilter(source, Pose.unchecked(np.eye(3), np.array([0.0, 0.0, 2.0]), before), 0.0)
    expected, P = moving.predicted(0.1), moving._at(0.1)[3]
    tilt = Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix()
    both = np.kron(np.eye(2), tilt)
    assert expected.covariance is not None
    moving.update(Pose.unchecked(tilt @ expected.R, expected.t, both @ expected.covariance @ both.T), 0.1)
    whole = np.kron(np.eye(4), tilt)
    np.testing.assert_allclose(moving.P[6:, 6:], whole @ P[6:, 6:] @ whole.T, rtol=1e-6, atol=1e-6 * P.max())
