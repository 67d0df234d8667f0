"""Rotation vectors against SciPy's, up to the half turn whose two vectors are one rotation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rootmatch.algebra.rotation import rotation_from_vector, rotation_vector, triangle_frames
from rootmatch.model.pose_density import Gaussian


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, 3.0, np.pi - 1e-6, np.pi - 1e-10, np.pi])
def test_the_vector_of_a_rotation_is_that_rotation(angle: float) -> None:
    axes = np.random.default_rng(2).normal(size=(40, 3))
    axes[:3] = np.eye(3)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    matrices = Rotation.from_rotvec(angle * axes).as_matrix()
    found = rotation_vector(matrices)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), angle, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(rotation_from_vector(found), matrices, atol=1e-7)


@pytest.mark.parametrize("axis", range(3))
def test_a_prediction_that_is_off_by_half_a_turn_is_no_good_one(axis: int) -> None:
    turned = -np.eye(3)
    turned[axis, axis] = 1.0
    prediction = Gaussian(np.eye(3), np.zeros(3), np.eye(6) * 0.01)
    squared = prediction.terms(turned[None], np.zeros((1, 3))).squared
    assert squared[0] == pytest.approx(np.pi**2 / 0.01, rel=1e-4)


def test_frames_of_corners_nearly_on_a_line_are_rotations() -> None:
    rng = np.random.default_rng(0)
    corners = np.array([0.0, 0.3, 1.0])[:, None] * rng.normal(size=(100, 1, 3)) + rng.normal(size=(100, 1, 3))
    frames = triangle_frames(corners)
    frames = frames[np.isfinite(frames).all(axis=(1, 2))]  # on a line to the last digit there is none
    assert len(frames) > 50
    np.testing.assert_allclose(frames.swapaxes(1, 2) @ frames, np.tile(np.eye(3), (len(frames), 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
