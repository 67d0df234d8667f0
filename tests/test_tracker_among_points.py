"""A camera among the points that it sees, as below the lamps of a ceiling: it is the camera that moves and turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.tracking.motion_filter import MotionFilter
from rootmatch.tracking.search_schedule import INTERVAL, LONGEST_INTERVAL, frame_budget

CAMERA = rm.Camera(600.0, 600.0, 640.0, 480.0)
OPTIONS = rm.TrackingOptions(interval=0.1, motion=rm.MotionOptions(velocity=0.3, acceleration=1.0))


def ceiling(rng: np.random.Generator) -> NDArray[np.float64]:
    """Thirty lamps, 1.5 m apart and off by 3 cm."""
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    return np.column_stack([1.5 * grid + rng.normal(0.0, 0.03, grid.shape), np.zeros(30)])


def walk(seed: int, frames: int = 30) -> tuple[int, int]:
    """Trusted frames, and wrong ones, at ten frames a second, between which a hand turns the camera by two degrees."""
    rng = np.random.default_rng(seed)
    lamps, place, yaw = ceiling(rng), np.array([*rng.uniform(2.5, 4.5, 2), -2.4]), rng.uniform(0.0, 6.0)
    tracker, speed = rm.Tracker(lamps, rm.P3P(CAMERA), noise=0.4, tracking=OPTIONS), rng.normal(0.0, 0.3, 2)
    trusted = wrong = 0
    for _ in range(frames):
        place[:2] += 0.1 * speed
        speed += rng.normal(0.0, 0.1, 2) - 0.05 * (place[:2] - (3.75, 3.0))
        yaw += rng.normal(0.0, 0.03)
        R = Rotation.from_euler("zx", [yaw, rng.normal(0.0, 0.03)]).as_matrix()
        pixels = CAMERA.project((lamps - place) @ R.T)
        shown = ((pixels > 0.0) & (pixels < (1280.0, 960.0))).all(axis=1) & (rng.random(30) > 0.08)
        seen = np.flatnonzero(shown)
        clutter = rng.uniform((0.0, 0.0), (1280.0, 960.0), (1, 2))
        match = tracker.update(np.concatenate([pixels[seen] + rng.normal(0.0, 0.4, (len(seen), 2)), clutter]))
        trusted += bool(match)
        wrong += bool(match) and not all(j < len(seen) and seen[j] == i for i, j in match.pairs)
    return trusted, wrong


def test_a_camera_that_turns_below_a_ceiling_is_followed() -> None:
    trusted, wrong = np.sum([walk(seed) for seed in range(3)], axis=0)
    assert wrong <= 1, "clutter beside a lamp that is not detected"
    assert trusted > 75, (
        "of 90; 30 if the ceiling is what turns, and gates with several lamps are not looked into nearer"
    )


def test_what_turns_below_a_ceiling_is_the_camera() -> None:
    """An unknown turn moves the lamps about the camera; a headset turns about itself."""
    lamps = ceiling(np.random.default_rng(0))
    below, before, headset = np.array([3.0, 2.5, -2.4]), np.array([0.3, 0.2, -2.4]), 0.1 * lamps
    for points, place, centre in ((lamps, below, below), (headset, before, headset.mean(axis=0))):
        filter_ = MotionFilter(points, rm.Pose(np.eye(3), -place, 1e-6 * np.eye(6)), 0.0, OPTIONS.motion)
        predicted = filter_.predicted(0.1)
        arm = np.cross(np.eye(3), centre)  # of the origin, per rotation about each axis
        about = np.eye(6)
        about[3:, :3] = -arm
        covariance = about @ predicted.covariance @ about.T
        assert np.allclose(covariance[:3, 3:], 0.0, atol=1e-3 * np.sqrt(covariance[0, 0] * covariance[3, 3]))


def test_a_filter_of_another_body_is_of_its_size() -> None:
    """A camera that is among the points of one body is in front of another, smaller one."""
    lamps, place = ceiling(np.random.default_rng(0)), np.array([3.0, 2.5, -2.4])
    of_lamps = MotionFilter(lamps, rm.Pose(np.eye(3), -place, 1e-6 * np.eye(6)), 0.0, OPTIONS.motion)
    headset = 0.1 * lamps
    other = of_lamps.of_body(np.eye(3), np.zeros(3), headset)
    pose = other.predicted(0.1)
    other.update(rm.Pose(pose.R, pose.t, 1e-6 * np.eye(6)), 0.1)
    np.testing.assert_allclose(other.centre, headset.mean(axis=0))


def test_a_filter_goes_with_the_camera() -> None:
    """Its point of reference changes, and neither the pose nor how the points move."""
    lamps, rng = ceiling(np.random.default_rng(0)), np.random.default_rng(1)
    place = np.array([3.0, 2.5, -2.4])
    options = replace(OPTIONS.motion, min_scale=1.0, max_scale=1.0)  # of one level: as given, a pose is taken in
    filter_ = MotionFilter(lamps, rm.Pose(np.eye(3), -place, 1e-4 * np.eye(6)), 0.0, options)
    for k in range(1, 6):
        place += np.array([0.2, 0.1, 0.0])
        R = Rotation.from_rotvec(rng.normal(0.0, 0.05, 3)).as_matrix()
        filter_.update(rm.Pose(R, -R @ place, 1e-5 * np.eye(6)), 0.1 * k)
    pose = filter_.predicted(0.5)
    assert np.allclose(-pose.R.T @ pose.t, place, atol=1e-9)
    assert np.allclose(filter_.t, 0.0, atol=1e-9)
    other = filter_.copy()
    other._go_with(np.array([0.5, -0.2, 0.3]))
    one, two = filter_.predicted(0.5), other.predicted(0.5)
    assert np.allclose(one.t, two.t)
    assert np.allclose(one.covariance, two.covariance)
    assert np.allclose(filter_.predicted(0.5001).t, other.predicted(0.5001).t, atol=1e-6)


@pytest.mark.parametrize(
    ("gap", "factor"), [(0.0, 1.0), (1e-3, 1.0), (INTERVAL, 1.0), (0.1, 6.0), (10.0, LONGEST_INTERVAL)]
)
def test_a_longer_interval_allows_a_longer_search(gap: float, factor: float) -> None:
    assert frame_budget(1000, gap) == round(1000 * factor)
