"""Poses as matrices, vectors and quaternions, their inverses and products, and what becomes of the covariance."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm

SIGMA = 1e-5
"""Small, so that first order is all there is."""


def drawn(rng: np.random.Generator, k: int = 3, scaled: bool = False, mirrored: bool = False) -> rm.Pose:
    """A pose with a full covariance."""
    if k == 3:
        R = Rotation.random(random_state=rng.integers(1 << 30)).as_matrix()
    else:
        angle = rng.uniform(-3.0, 3.0)
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if mirrored:
        R = R @ np.diag([-1.0, *np.ones(k - 1)])
    size = (3 if k == 3 else 1) + k + scaled
    root = SIGMA * rng.normal(size=(size, size))
    scale = float(rng.uniform(0.5, 2.0)) if scaled else 1.0
    return rm.Pose(R, rng.normal(size=k), root @ root.T, scale=scale, mirrored=mirrored)


def disturbed(pose: rm.Pose, error: np.ndarray) -> rm.Pose:
    """The true pose for an error (ω, τ, scale) of an estimated one."""
    k = len(pose.R)
    turns = 3 if k == 3 else 1
    if k == 3:
        turn = Rotation.from_rotvec(error[:3]).as_matrix()
    else:
        turn = np.array([[np.cos(error[0]), -np.sin(error[0])], [np.sin(error[0]), np.cos(error[0])]])
    scale = pose.scale + (error[-1] if len(error) > turns + k else 0.0)
    return rm.Pose(turn @ pose.R, pose.t + error[turns : turns + k], scale=scale, mirrored=pose.mirrored)


def error_of(estimated: rm.Pose, true: rm.Pose, size: int) -> np.ndarray:
    """The error (ω, τ, scale) of an estimated pose."""
    turn = true.R @ estimated.R.T
    angles = Rotation.from_matrix(turn).as_rotvec() if len(turn) == 3 else [np.arctan2(turn[1, 0], turn[0, 0])]
    return np.concatenate([angles, true.t - estimated.t, [true.scale - estimated.scale]])[:size]


KINDS = [{}, {"scaled": True}, {"k": 2}, {"k": 2, "scaled": True}, {"mirrored": True}, {"k": 2, "mirrored": True}]


@pytest.mark.parametrize("kind", KINDS)
def test_covariances_are_those_of_disturbed_poses(kind: dict) -> None:
    rng = np.random.default_rng(0)
    a, b = drawn(rng, **kind), drawn(rng, **kind)
    assert a.covariance is not None
    assert b.covariance is not None
    size = len(a.covariance)
    roots = [np.linalg.cholesky(one.covariance + 1e-24 * np.eye(size)) for one in (a, b)]
    inverse, product = a.inverse(), a @ b
    errors = []
    for _ in range(1000):
        one, two = (disturbed(p, root @ rng.normal(size=size)) for p, root in zip((a, b), roots, strict=True))
        errors.append((error_of(inverse, one.inverse(), size), error_of(product, one @ two, size)))
    for k, pose in enumerate((inverse, product)):
        sample = np.cov(np.array([error[k] for error in errors]).T)
        assert pose.covariance is not None
        deviation = np.sqrt(np.diag(pose.covariance))
        np.testing.assert_allclose(
            sample / np.outer(deviation, deviation), pose.covariance / np.outer(deviation, deviation), atol=0.25
        )


@pytest.mark.parametrize("kind", KINDS)
def test_matrices_inverses_and_products_map_points_alike(kind: dict) -> None:
    rng = np.random.default_rng(1)
    a, b = drawn(rng, **kind), drawn(rng, **kind)
    k = len(a.R)
    points = rng.normal(size=(5, k))
    homogeneous = np.column_stack([points, np.ones(5)])
    np.testing.assert_allclose((homogeneous @ a.matrix.T)[:, :k], a.transform(points), atol=1e-12)
    np.testing.assert_allclose(a.inverse().transform(a.transform(points)), points, atol=1e-12)
    np.testing.assert_allclose((a @ b).transform(points), a.transform(b.transform(points)), atol=1e-12)
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-12)
    again = rm.Pose.from_matrix(a.matrix, a.covariance)
    np.testing.assert_allclose(again.matrix, a.matrix, atol=1e-12)
    assert again.mirrored == a.mirrored
    assert (a @ rm.Pose(np.eye(k), np.zeros(k))).covariance is not None
    assert (rm.Pose(a.R, a.t, mirrored=a.mirrored) @ rm.Pose(b.R, b.t, mirrored=b.mirrored)).covariance is None


def test_rotations_are_those_of_opencv_and_scipy() -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        pose = drawn(rng)
        np.testing.assert_allclose(cv2.Rodrigues(pose.rvec)[0], pose.R, atol=1e-9)
        np.testing.assert_allclose(Rotation.from_quat(pose.quaternion).as_matrix(), pose.R, atol=1e-12)
        assert pose.quaternion[3] >= 0.0


def test_what_is_no_pose() -> None:
    for matrix, text in (
        (np.eye(5), r"shape \(5, 5\)"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
        (np.zeros((4, 4)) + np.diag([0.0, 0.0, 0.0, 1.0]), "singular matrix"),
        (np.diag([1.0, 2.0, 3.0, 1.0]), "R"),
        (np.full((4, 4), np.nan), "finite"),
    ):
        with pytest.raises(rm.InputError, match=text):
            rm.Pose.from_matrix(matrix)
    flat, solid = drawn(np.random.default_rng(3), k=2), drawn(np.random.default_rng(3))
    with pytest.raises(rm.InputError, match="plane"):
        flat @ solid
    for name in ("rvec", "quaternion"):
        with pytest.raises(rm.InputError, match="rotation in a plane has no"):
            getattr(flat, name)
        with pytest.raises(rm.InputError, match="reflection has no"):
            getattr(drawn(np.random.default_rng(4), mirrored=True), name)


def test_poses_of_points_far_from_the_origin_have_inverses() -> None:
    """Of a position of 10⁸ with an error of metres little but rounding is left of some covariances."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        near = drawn(rng)
        far = near @ rm.Pose(np.eye(3), np.array([0.1, 1.0, 0.3]) * 5e7)
        for one in (far.inverse(), far.inverse().inverse(), far @ far.inverse(), far.in_axes("opengl")):
            np.testing.assert_array_equal(one.covariance, one.covariance.T)
