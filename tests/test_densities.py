"""Densities of detections, about predictions and among themselves, against NumPy that shares no code with them."""

from __future__ import annotations

import numpy as np
import pytest

from rootmatch.samplers.guided.detection_grid import local_density
from rootmatch.simulation import p3p_scene, up2p_scene


def test_densities_are_those_of_the_pose_of_the_other_points() -> None:
    # equal σ have a loop of their own
    for make, sigma in ((p3p_scene, np.linspace(0.5, 1.5, 13)), (up2p_scene, np.full(13, 0.8))):
        scene = make(8, 5, noise=1.0, seed=2)
        assignment = np.where(np.arange(8) == 3, -1, scene.truth)
        fit = scene.problem.fitted(scene.problem.validated(scene.source, scene.target, sigma), assignment[None])
        found = fit.densities(0, 1.7)
        for i in range(8):
            spread = fit.jacobian[0, i] @ fit.covariance[0] @ fit.jacobian[0, i].T
            centre = fit.predicted[0, i]
            if assignment[i] >= 0:
                k = assignment[i]
                hat = np.linalg.inv(np.eye(2) * (1.0 + 1e-9) - spread / sigma[k] ** 2)
                centre, spread = scene.target[k] - hat @ (scene.target[k] - centre), hat @ spread
            for j in range(13):
                covariance = spread + sigma[j] ** 2 * np.eye(2)
                away = scene.target[j] - centre
                chi2 = away @ np.linalg.solve(covariance, away)
                expected = -0.5 * chi2 / 1.7 - np.log(2.0 * np.pi * 1.7) - 0.5 * np.log(np.linalg.det(covariance))
                assert found[i, j] == pytest.approx(expected, rel=1e-7)


def test_local_density_of_neighbours() -> None:
    positions = np.random.default_rng(0).uniform(size=(2, 40))
    apart = ((positions[:, :, None] - positions[:, None]) ** 2).sum(axis=0)
    found = local_density(positions, 0.01, neighbours=9)
    suu, suv, svv = np.cov(positions, bias=True)[[0, 0, 1], [0, 1, 1]]
    overall = 40 / (4.0 * np.pi * np.sqrt((suu + 1e-4) * (svv + 1e-4) - suv**2))
    expected = np.maximum(overall, 9 / (np.pi * (np.sort(apart, axis=1)[:, 9] + 1e-4)))
    np.testing.assert_allclose(found, expected)
    assert (found > overall).any()
