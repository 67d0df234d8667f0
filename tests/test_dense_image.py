"""Alignment of densities: its parts against slow computations that share no code with it, and matches by it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import convolve2d
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.algebra.rotation import spread_rotations
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.explain import dense_image
from rootmatch.research.blind.run import ROTATION
from rootmatch.research.blind.scenes import surface_scene
from rootmatch.samplers.densities import alignment
from rootmatch.samplers.densities.alignment import (
    LEVELS,
    MIN_POSES,
    Aligned,
    Blob,
    _climb_level,
    align_densities,
    histogram,
)
from rootmatch.samplers.densities.descent_kernels import ascend
from rootmatch.samplers.guided.crowding import VAGUE, crowding

Floats = NDArray[np.float64]

TAPS = np.exp(-0.5 * (np.arange(-3, 4) / 1.1) ** 2)
TAPS /= TAPS.sum()
VARIANCE, CLUTTER, CELL = 1.1**2, 0.07, 0.02
ORIGIN = np.array([-0.3, -0.25])


def drawn(place: Floats, shape: tuple[int, int]) -> Floats:
    """Points (n, 2) in cells, each shared among four cells bilinearly and blurred; (n, h, w)."""
    row, column = np.indices(shape)
    every = []
    for u, v in place:
        inside = 0.0 <= u < shape[1] - 1 and 0.0 <= v < shape[0] - 1
        hat = np.maximum(1.0 - abs(column - u), 0.0) * np.maximum(1.0 - abs(row - v), 0.0)
        every.append(convolve2d(hat * inside, np.outer(TAPS, TAPS), mode="same"))
    return np.array(every)


def places(points: Floats, R: Floats, t: Floats) -> Floats:
    """Images (n, 2) in cells."""
    seen = points @ R.T + t
    return (seen[:, :2] / seen[:, 2:] - ORIGIN) / CELL


def log_likelihood(points: Floats, R: Floats, t: Floats, counts: Floats) -> float:
    """Of the detections in the cells, up to a constant."""
    expected = drawn(places(points, R, t), counts.shape).sum(axis=0)
    return float((counts * np.log1p(expected / CLUTTER)).sum())


def turned(R: Floats, t: Floats, step: Floats) -> tuple[Floats, Floats]:
    """A pose after a rotation about the body's centre and a translation."""
    return Rotation.from_rotvec(step[:3]).as_matrix() @ R, t + step[3:]


def scene(seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Points, a pose, and counts of detections near it."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.3, 0.3, (7, 3))
    R, t = Rotation.random(random_state=seed).as_matrix(), np.array([0.1, -0.05, 2.0])
    counts = np.zeros((25, 31))
    near = np.rint(places(points, *turned(R, t, rng.normal(0.0, 0.01, 6)))).astype(int)
    np.add.at(counts, (near[:, 1], near[:, 0]), 1.0)
    counts[3, 4] += 2.0  # clutter
    counts[20, 25] += 0.5
    return points, R, t, counts


def climbed(points: Floats, R: Floats, t: Floats, counts: Floats, steps: int) -> tuple[Floats, Floats, float]:
    """Pose and likelihood by the kernel."""
    rotation, position, likelihood = R[None].copy(), t[None].copy(), np.empty(1)
    ascend(points, rotation, position, counts, ORIGIN, CELL, TAPS, VARIANCE, CLUTTER, steps, likelihood)
    return rotation[0], position[0], float(likelihood[0])


@pytest.mark.parametrize("seed", range(4))
def test_likelihood(seed: int) -> None:
    points, R, t, counts = scene(seed)
    assert climbed(points, R, t, counts, 0)[2] == pytest.approx(log_likelihood(points, R, t, counts), rel=1e-9)
    far = t + np.array([3.0, 0.0, 0.0])  # nothing is in the image
    assert climbed(points, R, far, counts, 0)[2] == 0.0
    assert climbed(points, R, -t, counts, 0)[2] == 0.0  # behind the camera


@pytest.mark.parametrize("seed", range(4))
def test_a_step_is_one_of_expectation_maximisation(seed: int) -> None:
    """The gradient of the likelihood by finite differences, and weights from each detection's share."""
    points, R, t, counts = scene(seed)
    tiny = 1e-7
    gradient = np.array(
        [
            (
                log_likelihood(points, *turned(R, t, tiny * axis), counts)
                - log_likelihood(points, *turned(R, t, -tiny * axis), counts)
            )
            / (2.0 * tiny)
            for axis in np.eye(6)
        ]
    )
    each = drawn(places(points, R, t), counts.shape)
    weight = (each * (counts / (CLUTTER + each.sum(axis=0)))).sum(axis=(1, 2))
    jacobian = np.array(
        [
            (places(points, *turned(R, t, tiny * axis)) - places(points, *turned(R, t, -tiny * axis))) / (2.0 * tiny)
            for axis in np.eye(6)
        ]
    )
    normal = np.einsum("i,aik,bik->ab", weight, jacobian, jacobian)
    normal += np.diag(0.001 * np.diag(normal) + 1e-12)
    step = np.linalg.solve(normal, VARIANCE * gradient)
    assert np.linalg.norm(step[:3]) < 0.3
    expected_R, expected_t = turned(R, t, step)
    moved_R, moved_t, _ = climbed(points, R, t, counts, 1)
    np.testing.assert_allclose(moved_R, expected_R, atol=1e-5)
    np.testing.assert_allclose(moved_t, expected_t, atol=1e-5)


def test_steps_climb() -> None:
    for seed in range(4):
        points, R, t, counts = scene(seed)
        away = turned(R, t, np.random.default_rng(seed).normal(0.0, 0.05, 6))
        values = [climbed(points, *away, counts, steps)[2] for steps in (0, 2, 8)]
        assert values[0] + 0.5 < values[1] < values[2] + 0.1


def test_no_detections_and_a_single_point_are_no_trouble() -> None:
    points, R, t, counts = scene(1)
    same = climbed(points, R, t, np.zeros_like(counts), 3)
    np.testing.assert_array_equal(same[0], R)
    np.testing.assert_array_equal(same[1], t)
    alone = climbed(points[:1], R, t, counts, 3)
    assert np.isfinite(alone[0]).all()
    np.testing.assert_allclose(alone[0] @ alone[0].T, np.eye(3), atol=1e-9)


def test_a_histogram_keeps_count_and_centre() -> None:
    rng = np.random.default_rng(5)
    detections = rng.uniform(-0.2, 0.2, (40, 2))
    found = histogram(detections, ORIGIN, CELL, (30, 40))
    row, column = np.indices(found.shape)
    assert found.sum() == pytest.approx(40.0)
    centre = np.array([(found * column).sum(), (found * row).sum()]) / 40.0 * CELL + ORIGIN
    np.testing.assert_allclose(centre, detections.mean(axis=0), atol=1e-12)
    assert histogram(np.array([[9.0, 0.0], [0.0, -9.0]]), ORIGIN, CELL, (30, 40)).sum() == 0.0


def test_few_poses_climb_where_the_image_has_many_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """A blur that is small for the body would take many seconds."""
    monkeypatch.setattr(alignment, "POSES_CELLS", alignment.POSES_CELLS // 25)
    points, R, t, _ = scene(2)
    seen = points @ R.T + t
    detections = seen[:, :2] / seen[:, 2:]
    starts = Aligned(np.tile(R, (30, 1, 1)), np.tile(t, (30, 1)))
    blob = Blob.of(detections, 1e-4, len(points))
    size = math.sqrt(0.5 * float(np.trace(blob.covariance)))
    for fineness, expected in ((10.0, 30), (50.0, MIN_POSES)):
        found = _climb_level(points, detections, starts, blob, blur=size / fineness, false=1.0, level=LEVELS[-1])
        assert len(found.rotation) == expected
        np.testing.assert_allclose(found.rotation, np.tile(R, (expected, 1, 1)), atol=0.02)


def test_the_grid_of_rotations_has_no_holes() -> None:
    grid = spread_rotations(4600)
    np.testing.assert_allclose(grid @ grid.swapaxes(1, 2), np.broadcast_to(np.eye(3), grid.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(grid), 1.0)
    wanted = Rotation.random(2000, random_state=1).as_matrix().reshape(-1, 9)
    trace = (wanted @ grid.reshape(-1, 9).T).max(axis=1)
    away = np.degrees(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))
    assert away.max() < 15.0


def test_a_blob_is_found_among_clutter() -> None:
    rng = np.random.default_rng(7)
    mean, spread = np.array([0.1, -0.05]), np.array([[0.002, 0.0005], [0.0005, 0.001]])
    own = rng.standard_normal((200, 2)) @ np.linalg.cholesky(spread).T + mean
    blob = Blob.of(np.concatenate([own, rng.uniform(-0.4, 0.4, (150, 2))]), 0.001, 200)
    np.testing.assert_allclose(blob.mean, mean, atol=0.01)
    np.testing.assert_allclose(blob.covariance, spread, atol=6e-4)


@pytest.mark.parametrize("detections", [np.zeros((9, 2)), np.linspace(0.0, 1.0, 9)[:, None] * [0.1, 0.2]])
def test_detections_of_one_place_or_line(detections: Floats) -> None:
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (8, 3))
    poses = align_densities(points - points.mean(axis=0), detections, 0.002, rng=np.random.default_rng(0))
    assert np.isfinite(poses.rotation).all()
    assert np.isfinite(poses.position).all()


@pytest.mark.parametrize("clutter", [0, 20])
def test_crowding_counts_what_a_vague_prediction_cannot_tell_apart(clutter: int) -> None:
    rng = np.random.default_rng(3)
    body, far = rng.uniform(-0.05, 0.05, (20, 2)), rng.uniform(0.3, 0.9, (clutter, 2))
    rays = np.append(np.concatenate([body, far]), np.ones((20 + clutter, 1)), axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    sigma = np.full(len(rays), 0.004)
    near = np.linalg.norm(rays[:, None] - rays, axis=2) <= VAGUE * 0.004
    half = sorted((near.sum(axis=1) - 1).tolist())[len(rays) // 2 :]
    assert crowding(rays, sigma) == pytest.approx(sum(half) / len(half))
    assert crowding(rays, 0.01 * sigma) < 0.1
    assert crowding(rays[:1], sigma[:1]) == 0.0


def surface(count: int, clutter: float, seed: int) -> tuple[object, rm.P3P]:
    """A scene of the protocol with its problem."""
    made = surface_scene(count, clutter, seed)
    return made, rm.P3P(rm.Camera(made.K[0, 0], made.K[1, 1], made.K[0, 2], made.K[1, 2]))


@pytest.mark.parametrize(("count", "clutter"), [(100, 0.5), (200, 0.0)])
def test_a_surface_that_is_dense_for_its_noise(count: int, clutter: float) -> None:
    made, problem = surface(count, clutter, 1020)
    found = rm.match(made.source, made.target, problem, noise=2.0)
    assert found.status is not rm.Status.UNTRUSTED
    off = found.poses[0].R @ made.R.T
    assert math.acos(min(0.5 * (np.trace(off) - 1.0), 1.0)) < ROTATION
    assert found.evaluated > 0
    assert "the pose is certain, but" in found.advice


def test_unit_rays_and_a_fisheye_are_dense_alike() -> None:
    made, _ = surface(100, 0.0, 1024)
    rays = np.concatenate([(made.target - made.K[:2, 2]) / made.K[0, 0], np.ones((len(made.target), 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    fisheye = rm.Camera(800.0, 800.0, 320.0, 240.0, lens=KannalaBrandt((0.02, -0.01, 0.0, 0.0)))
    for target, camera, noise in ((rays, rm.Bearings(), 2.0 / 800.0), (fisheye.project(rays), fisheye, 2.0)):
        found = rm.match(made.source, target, rm.P3P(camera), noise=noise)
        assert found.status is not rm.Status.UNTRUSTED
        off = found.poses[0].R @ made.R.T
        assert math.acos(min(0.5 * (np.trace(off) - 1.0), 1.0)) < ROTATION


def test_unrelated_points_that_are_dense() -> None:
    made, problem = surface(100, 0.0, 1021)
    other, _ = surface(100, 0.0, 1022)
    found = rm.match(made.source, other.target, problem, noise=2.0, max_seconds=1.0)
    assert found.status is not rm.Status.MATCHED


def test_where_it_does_not_apply(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sparse images and whatever else is known of points or pose go to the search."""
    made, problem = surface(100, 0.0, 1023)

    def asked(*_: object, **__: object) -> None:
        raise AskedError

    monkeypatch.setattr(dense_image, "align_densities", asked)
    for options in ({"noise": 0.02}, {"noise": 2.0, "source_noise": 0.01}, {"noise": 2.0, "sampler": "random"}):
        rm.match(made.source, made.target, problem, max_seconds=0.05, **options)
    with pytest.raises(AskedError):
        rm.match(made.source, made.target, problem, noise=2.0)


class AskedError(Exception):
    """The alignment was called."""
