"""Poses in the conventions of other libraries, and registration errors as surgeons define them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.simulation import p3p_scene

POINTS = np.array([[0.1, -0.2, 2.0], [0.3, 0.1, 2.5], [-0.2, 0.4, 3.0]])


def drawn(seed: int) -> rm.Pose:
    """A pose with a full covariance."""
    rng = np.random.default_rng(seed)
    root = 1e-3 * rng.normal(size=(6, 6))
    return rm.Pose(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3), root @ root.T)


@pytest.mark.parametrize("seed", range(5))
def test_constructors_and_properties_are_inverse_to_each_other(seed: int) -> None:
    pose = drawn(seed)
    for again in (
        rm.Pose.from_rvec(pose.rvec, pose.t, pose.covariance),
        rm.Pose.from_rvec(cv2.Rodrigues(pose.R)[0], pose.t[:, None], pose.covariance),
        rm.Pose.from_quaternion(pose.quaternion, pose.t, pose.covariance, order="xyzw"),
        rm.Pose.from_quaternion(pose.quaternion_wxyz, pose.t, pose.covariance, order="wxyz"),
        rm.Pose.from_matrix(pose.matrix, pose.covariance),
    ):
        np.testing.assert_allclose(again.matrix, pose.matrix, atol=1e-9)
        np.testing.assert_array_equal(again.covariance, pose.covariance)


def test_orders_of_quaternions_are_those_of_scipy() -> None:
    pose = rm.Pose(Rotation.from_euler("xyz", [0.3, -0.5, 0.7]).as_matrix(), np.zeros(3))
    rotation = Rotation.from_matrix(pose.R)
    np.testing.assert_allclose(pose.quaternion, rotation.as_quat(canonical=True), atol=1e-12)
    np.testing.assert_allclose(pose.quaternion_wxyz, rotation.as_quat(canonical=True, scalar_first=True), atol=1e-12)


@pytest.mark.parametrize(
    ("quaternion", "order", "text"),
    [
        ([0, 0, 0, 1], "xyz", '"xyzw" or "wxyz"'),
        ([0, 0, 0, 2], "xyzw", "length 2"),
        ([0, 0, 1], "xyzw", r"shape \(3,\)"),
        ([0, 0, np.nan, 1], "xyzw", "NaN"),
    ],
)
def test_what_is_no_quaternion(quaternion: list, order: str, text: str) -> None:
    with pytest.raises(rm.InputError, match=text):
        rm.Pose.from_quaternion(quaternion, np.zeros(3), order=order)  # type: ignore[arg-type]


def test_what_is_no_rotation_vector() -> None:
    with pytest.raises(rm.InputError, match=r"rvec of shape \(4,\)"):
        rm.Pose.from_rvec(np.zeros(4), np.zeros(3))
    with pytest.raises(rm.InputError, match="opengl"):
        drawn(0).in_axes("vulkan")  # type: ignore[arg-type]


def test_opencv_projects_by_rvec_and_t() -> None:
    pose = rm.Pose(Rotation.from_euler("y", 0.4).as_matrix(), np.array([0.1, 0.0, 1.0]))
    camera = rm.Camera(800, 780, 320, 240)
    seen, _ = cv2.projectPoints(POINTS, pose.rvec, pose.t, camera.matrix, None)
    np.testing.assert_allclose(camera.project(pose.transform(POINTS)), seen[:, 0], atol=1e-9)


def test_axes_of_opengl_openxr_and_ros() -> None:
    ahead = rm.Pose(np.eye(3), np.array([0.1, 0.2, 3.0]))  # to the right, below, in front
    for name in ("opengl", "openxr"):
        np.testing.assert_allclose(ahead.in_axes(name).t, [0.1, -0.2, -3.0])
    np.testing.assert_allclose(ahead.in_axes("ros").t, [3.0, -0.1, -0.2])
    np.testing.assert_allclose(ahead.in_axes("opencv").t, ahead.t)
    for name in ("opencv", "opengl", "openxr", "ros"):
        assert np.linalg.det(ahead.in_axes(name).R) == pytest.approx(1.0)


def test_a_covariance_turns_with_the_axes() -> None:
    pose = drawn(3)
    turned = pose.in_axes("ros")
    block = np.kron(np.eye(2), rm.Pose(np.eye(3), np.zeros(3)).in_axes("ros").R)
    np.testing.assert_allclose(turned.covariance, block @ pose.covariance @ block.T, atol=1e-15)


def kabsch(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares rotations and translations onto many noisy targets (…, n, k)."""
    centre, centre2 = source.mean(axis=0), target.mean(axis=-2)
    u, _, vt = np.linalg.svd((target - centre2[..., None, :]).swapaxes(-1, -2) @ (source - centre))
    flip = np.ones(u.shape[:-1])
    flip[..., -1] = np.linalg.det(u @ vt)
    R = (u * flip[..., None, :]) @ vt
    return R, centre2 - R @ centre


@pytest.mark.parametrize("k", [2, 3])
def test_tre_is_that_of_monte_carlo_and_fre_that_of_its_law(k: int) -> None:
    rng = np.random.default_rng(8)
    fle, n, draws = 0.3, 7, 20_000
    source = rng.uniform(-80, 80, (n, k))
    true = rm.Pose(Rotation.random(random_state=1).as_matrix() if k == 3 else _turn(0.7), np.full(k, 300.0))
    exact = true.transform(source)
    places = np.vstack([source.mean(axis=0), rng.uniform(-150, 150, (4, k))])
    match = rm.match(source, exact + rng.normal(0, fle, exact.shape), rm.Rigid(k), noise=(0.0, fle))
    assert match
    expected = match.pose.tre(places)

    R, t = kabsch(source, exact + rng.normal(0, fle, (draws, n, k)))
    errors = places @ R.swapaxes(-1, -2) + t[:, None] - true.transform(places)
    np.testing.assert_allclose(expected.rms, np.sqrt((errors**2).sum(axis=-1).mean(axis=0)), rtol=0.03)
    sample = np.einsum("dpi,dpj->pij", errors, errors) / draws
    np.testing.assert_allclose(sample, expected.covariance, atol=0.04 * expected.rms.max() ** 2)
    if k == 3:
        np.testing.assert_allclose(expected.rms, fitzpatrick(source, places, fle), rtol=0.02)

    noisy = exact + rng.normal(0, fle, (draws, n, k))
    R, t = kabsch(source, noisy)
    squares = ((source @ R.swapaxes(-1, -2) + t[:, None] - noisy) ** 2).sum(axis=-1).mean(axis=-1)
    angles = 3 if k == 3 else 1
    # of n k coordinates the fit takes away one for each parameter; in space 1 − 2 / n of the FLE squared
    assert squares.mean() == pytest.approx(fle**2 * (k - (k + angles) / n), rel=0.02)
    off = np.linalg.norm(match.pose.transform(source) - match.target[match.assignment], axis=1)
    assert match.pose.fre == pytest.approx(np.sqrt((off**2).mean()), rel=1e-9)


def test_tre_counts_an_estimated_scale() -> None:
    rng = np.random.default_rng(9)
    source, fle, draws = rng.uniform(-80, 80, (6, 3)), 0.3, 3000
    exact = 1.3 * source @ Rotation.random(random_state=2).as_matrix().T + 100.0
    match = rm.match(source, exact + rng.normal(0, fle, exact.shape), rm.Similarity(), noise=(0.0, fle))
    assert match
    place = np.array([[10.0, -120.0, 60.0]])
    errors = []
    for _ in range(draws):
        target = exact + rng.normal(0, fle, exact.shape)
        (R,), _ = kabsch(source, target[None])
        a, b = source - source.mean(axis=0), target - target.mean(axis=0)
        scale = float((b * (a @ R.T)).sum() / (a**2).sum())
        moved = scale * (place - source.mean(axis=0)) @ R.T + target.mean(axis=0)
        errors.append(moved - (1.3 * place @ Rotation.random(random_state=2).as_matrix().T + 100.0))
    assert match.pose.tre(place).rms[0] == pytest.approx(np.sqrt((np.array(errors) ** 2).sum(axis=-1).mean()), rel=0.05)


def test_registration_errors_need_a_covariance_points_and_space() -> None:
    with pytest.raises(rm.InputError, match="no covariance"):
        rm.Pose(np.eye(3), np.zeros(3)).tre(POINTS)
    with pytest.raises(rm.InputError, match=r"shape \(2,\)"):
        drawn(0).tre([1.0, 2.0])
    with pytest.raises(rm.InputError, match="two point sets"):
        drawn(0).fre  # noqa: B018
    scene = p3p_scene(n=8, noise=0.5, seed=1)
    match = rm.match(scene.source, scene.target, scene.problem, noise=0.5)
    with pytest.raises(rm.InputError, match="in pixels"):
        match.pose.fre  # noqa: B018
    assert match.pose.tre(scene.source[0]).rms > 0.0  # of a pose from an image too


def _turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def fitzpatrick(fiducials: np.ndarray, places: np.ndarray, fle: float) -> np.ndarray:
    """TRE in space by Fitzpatrick, West & Maurer (1998); the FLE of each coordinate is ``fle``."""
    centred = fiducials - fiducials.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    distance = [(places - fiducials.mean(axis=0)) @ axes.T, centred @ axes.T]
    about = [np.stack([(d**2).sum(axis=-1) - d[:, a] ** 2 for a in range(3)], axis=-1) for d in distance]
    ratio = about[0] / about[1].mean(axis=0)
    return np.sqrt(3 * fle**2 / len(fiducials) * (1 + ratio.mean(axis=-1)))
