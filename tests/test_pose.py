"""`rm.Pose` as a caller makes one: what it takes, what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm

R = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
T = np.array([1.0, -2.0, 3.0])


def test_a_pose_holds_what_it_was_given() -> None:
    covariance = np.diag([1e-4, 2e-4, 3e-4, 0.1, 0.2, 0.3])
    pose = rm.Pose(R.tolist(), tuple(T), covariance)
    rotation, translation = pose
    np.testing.assert_array_equal(rotation, R)
    np.testing.assert_array_equal(translation, T)
    np.testing.assert_array_equal(pose.covariance, covariance)
    np.testing.assert_allclose(pose.quaternion, Rotation.from_matrix(R).as_quat(canonical=True))
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(pose.transform(points), points @ R.T + T)
    np.testing.assert_allclose(rm.Pose(R, T, scale=2.0).transform(points), 2.0 * points @ R.T + T)


def test_rounding_is_mended() -> None:
    """A rotation in single precision, and a translation as OpenCV's column vector."""
    pose = rm.Pose(R.astype(np.float32), T[:, None])
    np.testing.assert_allclose(pose.R.T @ pose.R, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(pose.R, R, atol=1e-6)
    assert pose.t.shape == (3,)


def test_known_exactly_is_no_error() -> None:
    """A covariance without variance in some directions, as that of a known vertical."""
    axis = np.array([0.6, 0.8, 0.0])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 1e-6 * np.outer(axis, axis)
    covariance[3:, 3:] = np.eye(3)
    assert rm.Pose(R, T, covariance).covariance is not None


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((2.0 * R, T), "R is not a rotation"),
        ((np.diag([1.0, 1.0, -1.0]), T), "a reflection"),
        ((R[:2], T), "R of shape"),
        ((R, T[:2]), "t of shape"),
        ((R, [1.0, np.nan, 0.0]), "t holds NaN"),
        (("x", T), "R is not an array"),
        ((R, T, np.eye(5)), "covariance of shape"),
        ((R, T, np.eye(6) + np.eye(6, k=1)), "not symmetric"),
        ((R, T, -np.eye(6)), "a negative eigenvalue"),
        ((R, T, np.eye(6) + 2.0 * (np.eye(6, k=1) + np.eye(6, k=-1))), "a negative eigenvalue"),
        ((R, T, np.diag([1.0, 1.0, 1.0, 1.0, 1.0, np.inf])), "covariance holds NaN"),
    ],
)
def test_what_is_no_pose_is_refused(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(rm.InputError, match=text) as caught:
        rm.Pose(*arguments)  # type: ignore[arg-type]
    assert str(caught.value).startswith("pose: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("points", [[1.0, 2.0], 1.0, None, [], "far", [[1.0, 2.0], [3.0]], [1j, 2.0, 3.0]])
@pytest.mark.parametrize("method", ["transform", "tre"])
def test_points_that_a_pose_cannot_move_are_refused(method: str, points: Any) -> None:
    with pytest.raises(rm.InputError, match=r"^pose: .*give (points )?\(…, 3\)"):
        getattr(rm.Pose(np.eye(3), np.zeros(3), np.eye(6)), method)(points)


def test_a_point_that_is_not_known_stays_so() -> None:
    moved = rm.Pose(np.eye(3), np.ones(3)).transform([[np.nan, 0.0, 0.0], [1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(moved[1], [2.0, 3.0, 4.0])
    assert np.isnan(moved[0, 0])


def test_a_matrix_is_not_composed_with_a_pose() -> None:
    pose = rm.Pose(np.eye(3), np.zeros(3))
    with pytest.raises(rm.InputError, match=r"^pose: composed with ndarray; give a Pose, of a matrix Pose.from_matrix"):
        pose @ np.eye(4)
    with pytest.raises(TypeError, match="unsupported operand"):
        np.eye(4) @ pose


@pytest.mark.parametrize("arguments", [("far",), ([[1.0, 2.0], [3.0]],), (np.eye(4), "far"), (np.eye(4), [[1.0], []])])
def test_what_is_no_matrix_of_a_pose_is_refused(arguments: tuple[Any, ...]) -> None:
    with pytest.raises(rm.InputError, match=r"^pose: it is not an array of numbers; give a"):
        rm.Pose.from_matrix(*arguments)
