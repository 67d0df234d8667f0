"""Matches in images with lenses, and of detections beside and behind the camera."""

from __future__ import annotations

import math

import numpy as np
import pytest

import instances
import rootmatch as rm
from rootmatch.samplers.guided.detection_grid import build_grid
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene
from test_hypotheses import look_up

K = np.array([[400.0, 0.0, 640.0], [0.0, 400.0, 480.0], [0.0, 0.0, 1.0]])
CAMERAS = {
    "brown": rm.Camera.from_opencv(K, [-0.28, 0.07, 1e-3, -2e-3, 0.001]),
    "fisheye": rm.Camera.from_opencv_fisheye(K, [0.05, -0.02, 0.003, -0.0005]),
    "bearings": rm.Bearings(),
}
SCENES = {"p3p": p3p_scene, "up2p": up2p_scene, "3p1": three_plus_one_scene}


def directions(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array([instances.random_unit(rng) for _ in range(count)])


@pytest.mark.parametrize("spread", [1.0, 3.2])
def test_the_grid_finds_detections_all_around(spread: float) -> None:
    rays = directions(300, 0)
    rays = rays[np.arccos(rays[:, 2]) < spread]
    gate = 0.03
    grid = build_grid(np.ascontiguousarray(rays.T), gate)
    assert len(grid.whole) == 1
    rng = np.random.default_rng(1)
    found = asked = 0
    for direction in [*directions(300, 2), *(rays + rng.normal(0.0, 0.01, rays.shape))]:
        direction = direction / np.linalg.norm(direction)
        chord = np.linalg.norm(rays - direction, axis=1)
        x, y, z = (rng.uniform(0.1, 9.0) * grid.basis @ direction).tolist()
        k, distance2 = look_up(grid, x, y, z)
        if k >= 0:
            assert math.sqrt(distance2) == pytest.approx(chord[k], abs=1e-9)
            assert chord[k] <= gate
        asked += chord.min() <= gate
        found += k >= 0 and chord[k] < chord.min() + 0.5 * gate
        assert chord.min() <= gate or k < 0
    assert asked > 50
    # a cell names one detection: of two that are as near, or of crowded ones, it may be the other
    assert found >= 0.97 * asked


def test_an_ordinary_image_has_a_plane() -> None:
    assert build_grid(p3p_scene(20, seed=1).problem.camera.bearings([[0.0, 0.0], [640.0, 480.0]]).T, 1e-3).whole == ()


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("scene", SCENES)
def test_matches_with_lenses_and_of_rays(scene: str, camera: str) -> None:
    sigma = 0.5 / 400.0 if camera == "bearings" else 0.5
    made = SCENES[scene](9, outliers=3, noise=sigma, seed=3, camera=CAMERAS[camera])
    found = rm.match(made.source, made.target, made.problem, noise=sigma)
    assert found.status is rm.Status.MATCHED
    assert made.accuracy(found.assignment) == 1.0
    assert found.probability > 0.9


def room(camera: rm.Camera, sigma: float, seed: int, n: int = 40, clutter: int = 10) -> tuple[np.ndarray, ...]:
    """Points all about a camera, their detections where it sees them, clutter, and which is which."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3.0, 3.0, (n, 3))
    R, t = instances.random_rotation(rng), rng.uniform(-0.5, 0.5, 3)
    seen = np.flatnonzero(camera.sees(points @ R.T + t))
    image = camera.project((points @ R.T + t)[seen])
    if camera.dimension == 3:
        image = image + rng.normal(0.0, sigma, image.shape)
        image = np.concatenate([image, directions(clutter, seed + 1000)])
    else:
        image = image + rng.normal(0.0, sigma, image.shape)
        image = np.concatenate([image, camera.project(directions(4 * clutter, seed + 1000))[:clutter]])
        image = image[camera.shows(image)]
    order = rng.permutation(len(image))
    truth = np.full(n, -1)
    place = np.argsort(order)
    truth[seen[seen >= 0]] = place[: len(seen)]
    return points, image[order], truth


@pytest.mark.parametrize("camera", ["fisheye", "bearings"])
def test_the_guided_search_finds_what_lies_all_around(camera: str) -> None:
    sigma = 0.5 / 400.0 if camera == "bearings" else 0.5
    points, image, truth = room(CAMERAS[camera], sigma, seed=5)
    rays = CAMERAS[camera].bearings(image)
    assert rays[:, 2].min() < -0.2
    found = rm.match(points, image, rm.P3P(CAMERAS[camera]), noise=sigma, sampler="guided")
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.assignment[truth >= 0], truth[truth >= 0])


def test_estimated_noise_is_in_the_unit_of_the_detections() -> None:
    made = p3p_scene(12, outliers=2, noise=1e-3, seed=2, camera=rm.Bearings())
    found = rm.match(made.source, made.target, made.problem, noise="auto")
    assert made.accuracy(found.assignment) == 1.0
    assert found.noise == pytest.approx(1e-3, rel=0.5)
