"""Two views whose camera hardly moved, or whose common direction is measured."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.rotation import one_rotation_matrix, rotation_vector

CAMERA = rm.Camera(900, 900, 640, 480)


def two_images(seed: int, baseline: float, axis_noise: float = 0.0, clutter: int = 0):  # type: ignore[no-untyped-def]
    """Pixels of both images, their problem, and the rotation and direction of the motion; matches are in order."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(4.0, 12.0, 12)
    points = np.stack([rng.uniform(-0.5, 0.5, 12) * depth, rng.uniform(-0.4, 0.4, 12) * depth, depth], axis=1)
    rotation = one_rotation_matrix(np.array([0.0, rng.uniform(-0.2, 0.2), 0.0]))
    t = rng.standard_normal(3) * [1.0, 0.3, 0.5]
    t /= np.linalg.norm(t)
    tilts = [one_rotation_matrix(axis_noise * rng.standard_normal(3)) for _ in range(2)]
    axes = [tuple(tilt @ [0.0, 1.0, 0.0]) for tilt in tilts]
    pixels = []
    for seen in (points, points @ rotation.T + baseline * t):
        other = rng.uniform(0.0, 1.0, (clutter, 2)) * [1280.0, 960.0]
        image = np.concatenate([CAMERA.project(seen), other])
        pixels.append(image + 0.3 * rng.standard_normal(image.shape))
    problem = rm.ThreePlusOne(CAMERA, axis=axes[0], axis2=axes[1], axis_noise=axis_noise)
    return *pixels, problem, rotation, t


@pytest.mark.parametrize("baseline", [0.0, 0.1])
def test_a_camera_that_hardly_moved_is_no_reason_for_doubt(baseline: float) -> None:
    """Half a turn about a vertical baseline fits the epipolar planes as well, with all points behind the camera."""
    for seed in range(1000, 1020):
        first, second, problem, _, _ = two_images(seed, baseline)
        match = rm.match(first, second, problem, noise=0.3)
        assert match, seed
        assert np.array_equal(match.assignment, np.arange(len(first))), seed


@pytest.mark.parametrize("baseline", [0.001, 0.03])
def test_the_covariance_covers_baselines_far_away(baseline: float) -> None:
    inside = 0
    for seed in range(1000, 1020):
        first, second, problem, rotation, t = two_images(seed, baseline)
        pose = rm.match(first, second, problem, noise=0.3).pose
        error = np.concatenate([rotation_vector((rotation @ pose.R.T)[None])[0], t - pose.t])
        inside += error @ np.linalg.pinv(pose.covariance, rcond=1e-12, hermitian=True) @ error < 7.81
    assert inside >= 16


def test_a_measured_common_direction_is_met_among_clutter() -> None:
    right = wrong = 0
    for seed in range(1000, 1020):
        first, second, problem, _, _ = two_images(seed, 0.5, np.radians(0.5), clutter=8)
        match = rm.match(first, second, problem, noise=0.3)
        own = match.assignment[:12]
        right += bool(match) and np.count_nonzero(own == np.arange(12)) >= 8
        wrong += bool(match) and bool(((own >= 0) & (own != np.arange(12))).any())
    assert wrong == 0
    assert right >= 18
