"""Answers fitted by a pose each, against scipy's least squares and against the law of χ²."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.algebra.rotation import cross
from rootmatch.simulation import p3p_scene, up2p_scene


def least_chi2(scene, answer, sigma):  # type: ignore[no-untyped-def]
    """χ² of the best pose by scipy, from the true one."""
    matched = np.flatnonzero(answer >= 0)
    points, image = scene.source[matched], scene.target[answer[matched]]
    rotation, shift = scene.poses[0]
    upright = scene.problem.name == "up2p"

    def residual(pose):  # type: ignore[no-untyped-def]
        turn = Rotation.from_rotvec([0.0, pose[0], 0.0] if upright else pose[:3]).as_matrix()
        places = points @ (turn @ rotation).T + shift + pose[-3:]
        return ((scene.problem.camera.project(places) - image) / sigma[answer[matched], None]).ravel()

    return 2.0 * least_squares(residual, np.zeros(4 if upright else 6), xtol=1e-12, ftol=1e-12).cost


def test_cross_products_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(4, 1, 3)), rng.normal(size=(5, 3))
    np.testing.assert_array_equal(cross(first, second), np.cross(first, second))


@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_fit_is_the_least_squares_one(make) -> None:  # type: ignore[no-untyped-def]
    for seed in range(8):
        scene = make(8, 3, 1.0, seed)
        sigma = np.random.default_rng(seed).uniform(0.5, 2.0, len(scene.target))
        part = scene.truth.copy()
        part[[1, 4]] = -1
        fit = scene.problem.fitted(
            scene.problem.validated(scene.source, scene.target, sigma), np.array([scene.truth, part])
        )
        for k, answer in enumerate((scene.truth, part)):
            assert fit.chi2[k] == pytest.approx(least_chi2(scene, answer, sigma), rel=2e-3)
            assert fit.dof[k] == 2 * (answer >= 0).sum() - (4 if make is up2p_scene else 6)


@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_chi2_of_the_truth_follows_its_law(make) -> None:  # type: ignore[no-untyped-def]
    fits = []
    for seed in range(100):
        scene = make(10, 0, 1.0, seed)
        fits.append(scene.problem.fitted(scene.problem.validated(scene.source, scene.target, 1.0), scene.truth[None]))
    freedom = fits[0].dof[0]
    assert np.mean([fit.chi2[0] for fit in fits]) == pytest.approx(freedom, abs=4.0 * np.sqrt(2.0 * freedom / 100))


@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_larger_variances_change_the_evidence_as_a_fit_with_them_does(make) -> None:  # type: ignore[no-untyped-def]
    for seed in range(5):
        scene = make(10, 4, 1.0, seed)
        without = scene.truth.copy()
        without[4] = -1
        fit = scene.problem.fitted(
            scene.problem.validated(scene.source, scene.target, 1.0), np.array([scene.truth, without])
        )
        wider = fit.inflated(2.0)
        scaled = scene.problem.fitted(
            scene.problem.validated(scene.source, scene.target, np.sqrt(2.0)), np.array([scene.truth, without])
        )
        np.testing.assert_allclose(wider, scaled.evidence, atol=0.02)


def test_a_measured_vertical_is_a_prior() -> None:
    """Tilted by two degrees the exact vertical fits badly, the noisy one well, at the cost of the prior."""
    scene = up2p_scene(12, 0, 0.5, 0)
    tilt = Rotation.from_rotvec([0.03, 0.0, -0.02]).as_matrix() @ [0.0, 1.0, 0.0]
    exact = rm.UP2P(scene.problem.camera, tuple(tilt), (0.0, 1.0, 0.0))
    noisy = rm.UP2P(scene.problem.camera, tuple(tilt), (0.0, 1.0, 0.0), 0.02)
    chi2 = [
        p.fitted(p.validated(scene.source, scene.target, 0.5), scene.truth[None]).chi2[0]
        for p in (scene.problem, exact, noisy)
    ]
    assert chi2[1] > 3.0 * chi2[0]
    assert chi2[2] < chi2[0] + 12.0
