"""Two views whose camera hardly moved, or whose common direction is measured."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.rotation import one_rotation_matrix, rotation_vector
from rootmatch.problems.points import TwoViews
from rootmatch.samplers.two_views.pose_refinement import DIMENSIONS, refine_poses

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


def images_with_measured_axes(seed: int, degrees: float):  # type: ignore[no-untyped-def]
    """Twenty-six points of two cameras that look around with measured axes, few of them in both, and clutter."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-4.0, -3.0, 5.0), (4.0, 3.0, 13.0), (26, 3))
    rotation = one_rotation_matrix(0.12 * rng.standard_normal(3))
    t = rng.standard_normal(3) * [1.0, 0.4, 0.6]
    t *= 3.0 / np.linalg.norm(t)
    noise = np.radians(degrees)
    down = np.array([0.0, 1.0, 0.0])
    axes = [tuple(one_rotation_matrix(noise * rng.standard_normal(3)) @ one) for one in (down, rotation @ down)]
    pixels = []
    for seen, lost in ((points, range(22, 26)), (points @ rotation.T + t, range(18, 22))):
        image = CAMERA.project(seen)
        image[list(lost)] = rng.uniform((0.0, 0.0), (1280.0, 960.0), (4, 2))
        pixels.append(image + 0.3 * rng.standard_normal(image.shape))
    return *pixels, rm.ThreePlusOne(CAMERA, axis=axes[0], axis2=axes[1], axis_noise=noise)


def test_a_pose_is_met_though_the_axes_are_off_by_many_pixels() -> None:
    """An axis noise of 1° is 20 pixels: taken for noise of the detections, it hid the pose among accidental ones."""
    met = 0
    for seed in range(1000, 1010):
        first, second, problem = images_with_measured_axes(seed, 1.0)
        own = rm.match(first, second, problem, noise=0.3).assignment
        matched = np.flatnonzero(own >= 0)
        met += len(matched) >= 12 and np.count_nonzero(own[matched] == matched) >= len(matched) - 1
    assert met >= 8


def test_refined_tilts_are_those_of_the_axes() -> None:
    """From the pose without them: the right pairs are the likeliest, by the noise of the detections alone."""
    rng = np.random.default_rng(1000)
    points = rng.uniform((-4.0, -3.0, 5.0), (4.0, 3.0, 13.0), (20, 3))
    t, tilt, sigma = np.array([0.8, 0.0, 0.6]), 0.02, 3e-4
    turn = one_rotation_matrix(np.array([0.0, 0.1, 0.0]))
    moved = points @ (one_rotation_matrix(np.array([tilt, 0.0, -tilt])) @ turn).T + t
    bearings = []
    for seen in (points, moved):
        rays = seen / np.linalg.norm(seen, axis=1, keepdims=True) + sigma * rng.standard_normal(seen.shape)
        bearings.append(np.ascontiguousarray((rays / np.linalg.norm(rays, axis=1, keepdims=True)).T))
    variance = np.full(20, sigma**2)
    judge = np.full(20, 0.1), np.ones((20, 20))
    pose = np.array([[np.cos(0.1), np.sin(0.1), *t, 0.1]])
    views = TwoViews(*bearings, variance, variance, False)
    (ratios,), (found,) = tables = np.zeros((1, 20, 20)), np.zeros((1, 2))
    scratch = np.zeros(40), np.zeros((3, 3)), np.zeros((DIMENSIONS, DIMENSIONS)), np.zeros(DIMENSIONS)
    blurs = np.geomspace(tilt**2, 0.2 * sigma**2, 9)
    refine_poses(views, judge, blurs, 0.2, tilt**2, 0, 1, pose, tables[1], tables[0], *scratch)
    np.testing.assert_allclose(found, (tilt, -tilt), atol=0.01)
    assert (ratios.argmax(axis=1) == np.arange(20)).sum() >= 18


@pytest.mark.parametrize(("degrees", "vague"), [(0.0, False), (0.1, False), (1.0, True)])
def test_vague_axes_are_told_where_nothing_was_found(degrees: float, vague: bool) -> None:
    rng = np.random.default_rng(1000)
    first, second = rng.uniform((0.0, 0.0), (1280.0, 960.0), (2, 12, 2))
    axes = {"axis": (0.0, 1.0, 0.0), "axis2": (0.0, 1.0, 0.0), "axis_noise": np.radians(degrees)}
    match = rm.match(first, second, rm.ThreePlusOne(CAMERA, **axes), noise=0.3)
    assert not match
    assert ("may have missed the pose" in match.advice) == vague
    assert ("no pose explains" in match.advice) != vague
