"""Lamps on a grid, seen in part: what looks like itself is ambiguous, and never trusted a period away."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.problems.base import Problem
from rootmatch.samplers.guided.minimal_sets import sets_of_parts
from rootmatch.tracking.motion_filter import MotionOptions

Floats = NDArray[np.float64]

CAMERA = rm.Camera(250.0, 250.0, 640.0, 480.0)
UPRIGHT = rm.UP2P(CAMERA, vertical_camera=(0.0, 0.0, 1.0), vertical_world=(0.0, 0.0, 1.0))


def ceiling(seed: int, size: tuple[int, int], jitter: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Lamps 2.6 m high, a fifth of them missing, off their grid by ``jitter``; those within 62°, and whose they are."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(1.2 * np.arange(size[0]), 1.8 * np.arange(size[1])), axis=-1).reshape(-1, 2)
    lamps = np.column_stack([grid + rng.normal(0.0, jitter, grid.shape), np.full(len(grid), 2.6)])
    lamps = lamps[rng.random(len(lamps)) < 0.8]
    angle = rng.uniform(-np.pi, np.pi)
    R = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    place = np.append(rng.uniform(1.4, 5.8, 2), 1.0)
    image = CAMERA.project((lamps - place) @ R.T)
    own = rng.permutation(np.flatnonzero(np.linalg.norm(image - (640.0, 480.0), axis=1) < 480.0))
    return lamps, image[own] + rng.normal(0.0, 0.3, (len(own), 2)), own


@pytest.mark.parametrize("problem", [UPRIGHT, rm.P3P(CAMERA)])
def test_a_part_of_a_grid_is_not_trusted_a_period_away(problem: Problem) -> None:
    """Before rivals of parts were sought, 8 of 32 trusted were wrong upright and 13 of 21 not (60 seeds from 1000)."""
    trusted = wrong = 0
    for seed in range(1000, 1016):
        lamps, image, own = ceiling(seed, (6, 4), 0.0)
        if len(own) < 6:
            continue
        match = rm.match(lamps, image, problem, noise=0.3)
        points, detections = match.pairs.T
        trusted += bool(match)
        wrong += bool(match) and bool((own[detections] != points).any())
    assert trusted >= 3
    assert wrong == 0


def test_a_part_of_many_lamps_is_found_by_the_vertical() -> None:
    """The widest pairs of 112 lamps are never in view together."""
    lamps, image, own = ceiling(1000, (14, 10), 0.05)
    match = rm.match(lamps, image, UPRIGHT, noise=0.3)
    points, detections = match.pairs.T
    assert match
    assert (own[detections] == points).all()


@pytest.mark.parametrize("seed", [1006])
def test_lights_of_an_approach_are_not_seen_from_below(seed: int) -> None:
    """Turned over about its middle line a runway looks the same, but for how far its lights are off their places."""
    rng = np.random.default_rng(seed)
    edge = [(60.0 * x, 22.5 * y, 0.0) for x in range(20) for y in (-1, 1)]
    approach = [(-30.0 * x, y, 0.0) for x in range(1, 14) for y in (-2, -1, 0, 1, 2)]
    lights = np.array(edge + approach) + rng.normal(0.0, 0.05, (105, 3))
    camera = rm.Camera(2000.0, 2000.0, 960.0, 540.0, size=(1920, 1080))
    away = rng.uniform(900.0, 1800.0)
    place = lights - (-away, rng.normal(0.0, 15.0), 0.052 * away)
    R = np.array([[0.0, -1.0, 0.0], [0.052, 0.0, -1.0], [1.0, 0.0, 0.052]])
    R /= np.linalg.norm(R, axis=1, keepdims=True)
    own = rng.permutation(np.flatnonzero((rng.random(105) < 0.9) & (lights[:, 0] < 700.0)))
    image = camera.project(place[own] @ R.T) + rng.normal(0.0, 0.2, (len(own), 2))
    match = rm.match(lights, image, rm.P3P(camera), noise=0.2)
    points, detections = match.pairs.T
    assert match
    assert (own[detections] == points).mean() > 0.95


@pytest.mark.parametrize("seed", [1005, 1012, 1018])
def test_frames_do_not_tell_between_poses_a_period_apart(seed: int) -> None:
    """Before poses that look the same moved alike, how far the lamps' centre moves decided, and often wrongly."""
    rng = np.random.default_rng(seed)
    lamps, _, _ = ceiling(seed, (6, 4), 0.0)
    walk = MotionOptions(velocity=0.2, acceleration=0.5, angular_velocity=1.0, angular_acceleration=5.0)
    tracker = rm.Tracker(lamps, UPRIGHT, noise=0.3, tracking=rm.TrackingOptions(interval=1.0 / 30.0, motion=walk))
    place, speed, turn = rng.uniform(2.4, 4.8, 2), rng.normal(0.0, 0.6, 2), rng.normal(0.0, 0.8)
    told = []
    for k in range(45):
        R = Rotation.from_euler("z", turn * k / 30.0).as_matrix()
        image = CAMERA.project((lamps - np.append(place + speed * k / 30.0, 1.0)) @ R.T)
        own = rng.permutation(np.flatnonzero(np.linalg.norm(image - (640.0, 480.0), axis=1) < 480.0))
        match = tracker.update(image[own] + rng.normal(0.0, 0.3, (len(own), 2)))
        points, detections = match.pairs.T
        told.append((bool(match), bool((own[detections] != points).any())))
    assert not any(trusted and wrong for trusted, wrong in told)


def test_sets_of_parts_are_of_all_sizes() -> None:
    row = np.column_stack([np.arange(100.0), np.zeros((100, 2))])
    waves = sets_of_parts(row, 2, np.random.default_rng(0))
    sets = np.concatenate([next(waves) for _ in range(5)])
    apart = np.ptp(sets, axis=1)
    assert (apart > 0).all()
    assert (apart <= 5).mean() > 0.2
    assert (apart >= 40).mean() > 0.1
