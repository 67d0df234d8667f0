"""The noise of a rig's detections, camera by camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rig_scenes import RigScene, four_about

SIGMA = (0.4, 0.5, 0.6, 0.7)


def by_camera(scene: RigScene) -> tuple[list[NDArray[np.float64]], NDArray[np.int64]]:
    """The detections of each camera, and how many they are."""
    images = [scene.rows[scene.rows[:, 2] == k, :2] for k in range(4)]
    return images, np.array([len(one) for one in images])


def assert_same(one: rm.Match, other: rm.Match) -> None:
    assert one
    assert one.sightings is not None
    assert other.sightings is not None
    np.testing.assert_array_equal(one.sightings.assignment, other.sightings.assignment)
    np.testing.assert_array_equal(one.confidence, other.confidence)


@pytest.mark.parametrize("form", ["numbers", "arrays", "covariances", "mixed"])
def test_a_list_by_camera_is_the_noise_of_all_detections(form: str) -> None:
    scene = four_about(seed=1)
    images, counts = by_camera(scene)
    images[2], counts[2] = images[2][:-1], counts[2] - 1
    whole: Any = np.repeat(SIGMA, counts)
    given: list[Any] = list(SIGMA)
    if form in ("arrays", "mixed"):
        given = [np.full(count, sigma) for count, sigma in zip(counts, SIGMA, strict=True)]
        given[3] = SIGMA[3] if form == "mixed" else given[3]
    elif form == "covariances":
        given = [np.tile(sigma**2 * np.eye(2), (count, 1, 1)) for count, sigma in zip(counts, SIGMA, strict=True)]
        whole = np.concatenate(given)
    problem = rm.P3P(scene.rig)
    first = rm.match(scene.points, images, problem, noise=whole)
    assert_same(first, rm.match(scene.points, images, problem, noise=given))
    assert_same(first, rm.Matcher(scene.points, problem, noise=given).match(images))
    assert_same(first, rm.Matcher(scene.points, problem).match(images, noise=given))
    trackers = [rm.Tracker(scene.points, problem, noise=one) for one in (whole, given)]
    for k in range(3):
        assert_same(*(tracker.update(images, time=k / 60.0) for tracker in trackers))
        assert_same(*(tracker.update(images, noise=given, time=(k + 0.5) / 60.0) for tracker in trackers))


def test_a_list_by_camera_goes_with_rows_in_any_order() -> None:
    scene = four_about(seed=1)
    camera = scene.rows[:, 2].astype(int)
    given = [np.full(int((camera == k).sum()), sigma) for k, sigma in enumerate(SIGMA)]
    whole = np.array(SIGMA)[camera]
    problem = rm.P3P(scene.rig)
    assert_same(*(rm.match(scene.points, scene.rows, problem, noise=one) for one in (whole, given)))
    assert_same(*(rm.match(scene.points, scene.rows, problem, noise=one) for one in (whole, whole.tolist())))


def test_a_tracker_multiplies_a_list_by_camera() -> None:
    """The noise is twice as large as stated."""
    scene, rng = four_about(seed=1, sigma=0.0), np.random.default_rng(1)
    images, counts = by_camera(scene)
    stated: list[Any] = [np.full(count, 0.3) for count in counts]
    tracker = rm.Tracker(scene.points, rm.P3P(scene.rig), noise=stated)
    for k in range(12):
        shown = [one + rng.normal(0.0, 0.6, one.shape) for one in images]
        tracker.update([[], [], [], []] if k == 6 else shown, noise=0.6 if k == 6 else None, time=k / 60.0)
    assert tracker.noise_factor > 1.0


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ([np.full(3, 0.5)] * 4, "3 given for camera 0, which has 7 detections"),
        ([np.full(7, 0.5)] * 3, "a list of 3 given, but the rig has 4 cameras and 28 detections"),
        ([0.5, 0.5, 0.5], "shape"),
        ([0.5, "a", 0.5, 0.5], "noise of camera 1: it is not an array of numbers"),
        ([0.5, 0.0, 0.5, 0.5], "0 given, which no measured point can fit"),
    ],
)
def test_what_is_no_noise_of_cameras_has_one_error(noise: Any, message: str) -> None:
    scene = four_about(seed=1)
    images, _ = by_camera(scene)
    with pytest.raises(rm.InputError, match=message):
        rm.match(scene.points, images, rm.P3P(scene.rig), noise=noise)
    with pytest.raises(rm.InputError, match=message):
        rm.Tracker(scene.points, rm.P3P(scene.rig), noise=noise).update(images)


@pytest.mark.parametrize("problem", [rm.P3P(rm.Camera(900, 900, 640, 480)), rm.Rigid(), rm.Similarity()])
def test_rows_of_different_lengths_have_one_error(problem: Any) -> None:
    points = np.random.default_rng(0).uniform(size=(6, 3))
    target = points + 1.0 if problem.noisy_source else problem.camera.project(points + np.array([0.0, 0.0, 3.0]))
    with pytest.raises(rm.InputError, match="noise: rows of different lengths"):
        rm.match(points, target, problem, noise=[[0.1], [0.1, 0.2], [0.1]])
