"""Answers between two views, fitted by a pose each."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

import rootmatch as rm
from rootmatch.simulation import three_plus_one_scene


def sampson(scene, answer, pose):  # type: ignore[no-untyped-def]
    """Epipolar deviations in σ of a turn and a direction (two angles) of the shift, by fundamental matrices."""
    turn, azimuth, height = pose
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    t = [np.cos(height) * np.cos(azimuth), np.sin(height), np.cos(height) * np.sin(azimuth)]
    essential = np.cross(np.eye(3), t).T @ rotation
    inverse = np.linalg.inv(scene.cameras[0].matrix)
    fundamental = inverse.T @ essential @ inverse
    matched = np.flatnonzero(answer >= 0)
    ones = np.ones((len(matched), 1))
    first, second = np.hstack([scene.source[matched], ones]), np.hstack([scene.target[answer[matched]], ones])
    line, back = first @ fundamental.T, second @ fundamental
    return (second * line).sum(axis=1) / np.sqrt((line[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))


@pytest.mark.parametrize("baseline", [3.0, 6.0])
def test_chi2_is_the_least_sampson_error_and_follows_its_law(baseline: float) -> None:
    found, least = [], []
    for seed in range(25):
        scene = three_plus_one_scene(10, 0, 1.0, seed, baseline=baseline)
        rotation, shift = scene.poses[0]
        start = [
            np.arctan2(rotation[0, 2], rotation[0, 0]),
            np.arctan2(shift[2], shift[0]),
            np.arcsin(shift[1] / np.linalg.norm(shift)),
        ]
        fit = scene.problem.fitted(scene.problem.validated(scene.source, scene.target, 1.0), scene.truth[None])
        assert fit.dof[0] == 7
        found.append(fit.chi2[0])
        least.append(2.0 * least_squares(lambda pose, s=scene: sampson(s, s.truth, pose), start).cost)
    assert np.mean(np.abs(np.array(found) - least) < 0.02 * np.array(least) + 0.05) >= 0.8
    assert np.mean(found) == pytest.approx(7.0, abs=4.0 * np.sqrt(14.0 / 25))


def test_parallaxes_of_one_size_are_more_probable() -> None:
    """Two images from nearly one place: exchanged points lie near epipolar lines too, but far along them."""
    right = 0
    for seed in range(12):
        scene = three_plus_one_scene(10, 0, 1.0, 100 + seed, baseline=1.0)
        exchanged = scene.truth.copy()
        exchanged[[2, 7]] = exchanged[[7, 2]]
        fit = scene.problem.fitted(
            scene.problem.validated(scene.source, scene.target, 1.0), np.array([scene.truth, exchanged])
        )
        right += fit.evidence[0] > fit.evidence[1] + 3.0
    assert right >= 11


def test_measured_directions_are_a_prior() -> None:
    """Half a degree off, the exact direction fits badly and the noisy one well."""
    scene = three_plus_one_scene(12, 0, 0.3, 4, baseline=5.0)
    camera = scene.cameras[0]
    tilted = (0.009, 1.0, -0.006)
    exact = rm.ThreePlusOne(camera, camera, axis=(0, 1, 0), axis2=tilted)
    noisy = rm.ThreePlusOne(camera, camera, axis=(0, 1, 0), axis2=tilted, axis_noise=0.007)
    chi2 = [
        problem.fitted(problem.validated(scene.source, scene.target, 0.3), scene.truth[None]).chi2[0]
        for problem in (scene.problem, exact, noisy)
    ]
    assert chi2[1] > 2.0 * chi2[0]
    assert chi2[2] < 0.7 * chi2[1]
