"""Assignments fitted by a pose each, against SciPy's least squares and against the law of χ²."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.algebra.rotation import cross
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.model.mode_search import find_modes
from rootmatch.model.proposals import Proposals, fit_assignments
from rootmatch.simulation import p3p_scene, up2p_scene

BENT = rm.Camera.from_opencv_fisheye([[420.0, 0, 402], [0, 421.0, 398], [0, 0, 1]], [0.03, -0.01, 0.002, 0.0])


def fits_of(problem, source, target, sigma, assignments):  # type: ignore[no-untyped-def]
    """The evidence of each assignment at its fitted pose."""
    model = make_detection_model(MatchingTask.of(problem, source, target, noise=sigma))
    proposals, found, _ = fit_assignments(model, np.array(assignments))
    np.testing.assert_array_equal(proposals.assignments, assignments)
    return found


def min_chi2(scene, camera, target, answer, sigma):  # type: ignore[no-untyped-def]
    """χ² of the best pose by SciPy, from the true one."""
    matched = np.flatnonzero(answer >= 0)
    points, image = scene.source[matched], target[answer[matched]]
    rotation, shift = scene.poses[0]
    upright = scene.problem.name == "up2p"

    def residual(pose):  # type: ignore[no-untyped-def]
        turn = Rotation.from_rotvec([0.0, pose[0], 0.0] if upright else pose[:3]).as_matrix()
        places = points @ (turn @ rotation).T + shift + pose[-3:]
        return ((camera.project(places) - image) / sigma[answer[matched], None]).ravel()

    return 2.0 * least_squares(residual, np.zeros(4 if upright else 6), xtol=1e-12, ftol=1e-12).cost


def test_cross_products_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(4, 1, 3)), rng.normal(size=(5, 3))
    np.testing.assert_array_equal(cross(first, second), np.cross(first, second))


@pytest.mark.parametrize("bent", [False, True], ids=["pinhole", "fisheye"])
@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_fit_is_the_least_squares_one(make, bent: bool) -> None:  # type: ignore[no-untyped-def]
    for seed in range(8):
        scene = make(8, 3, 1.0, seed)
        camera, target = scene.cameras[0], scene.target
        if bent:
            target, camera = BENT.project(camera.bearings(target)), BENT
        sigma = np.random.default_rng(seed).uniform(0.5, 2.0, len(target))
        part = scene.truth.copy()
        part[[1, 4]] = -1
        found = fits_of(replace(scene.problem, camera=camera), scene.source, target, sigma, [scene.truth, part])
        for k, answer in enumerate((scene.truth, part)):
            minimum = min_chi2(scene, camera, target, answer, sigma)
            assert found.squared[k] == pytest.approx(minimum, rel=0.02, abs=0.05)
            freedom = 2 * np.count_nonzero(answer >= 0) - (4 if make is up2p_scene else 6)
            assert found.freedom[k] == pytest.approx(freedom, abs=0.5)


@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_chi2_of_the_truth_follows_its_law(make) -> None:  # type: ignore[no-untyped-def]
    squared, freedom = [], 16.0 if make is up2p_scene else 14.0
    for seed in range(100):
        scene = make(10, 0, 1.0, seed)
        squared.append(fits_of(scene.problem, scene.source, scene.target, 1.0, [scene.truth]).squared[0])
    assert np.mean(squared) == pytest.approx(freedom, abs=4.0 * np.sqrt(2.0 * freedom / 100))


def test_a_measured_vertical_is_a_prior() -> None:
    """Tilted by two degrees the exact vertical fits badly, the noisy one well, at the cost of the prior."""
    scene = up2p_scene(12, 0, 0.5, 0)
    tilt = tuple(Rotation.from_rotvec([0.03, 0.0, -0.02]).as_matrix() @ [0.0, 1.0, 0.0])
    exact = rm.UP2P(scene.problem.camera, tilt, (0.0, 1.0, 0.0))
    noisy = rm.UP2P(scene.problem.camera, tilt, (0.0, 1.0, 0.0), 0.02)
    minimum, off, within = (
        fits_of(problem, scene.source, scene.target, 0.5, [scene.truth]).squared[0]
        for problem in (scene.problem, exact, noisy)
    )
    assert off > 3.0 * minimum
    assert within < minimum + 12.0


def test_an_assignment_with_too_few_matches_is_left_out() -> None:
    scene = p3p_scene(6, 2, noise=1.0, seed=3)
    two = np.where(np.arange(6) < 2, scene.truth, -1)
    model = make_detection_model(MatchingTask.of(scene.problem, scene.source, scene.target, noise=1.0))
    proposals, found, at = fit_assignments(model, np.array([two, scene.truth]))
    np.testing.assert_array_equal(proposals.assignments, [scene.truth])
    assert len(found.log_odds) == len(at.pixels) == 1


def test_a_mode_grows_by_many_changes_at_once() -> None:
    """Half of the points unmatched and four exchanged in pairs: more than single changes mend in their few rounds."""
    scene = p3p_scene(40, 10, noise=0.5, seed=2)
    start = np.where(np.arange(40) % 2 == 0, scene.truth, -1)
    start[[0, 2, 4, 6]] = start[[2, 0, 6, 4]]
    task = MatchingTask.of(scene.problem, scene.source, scene.target, noise=0.5)
    model = make_detection_model(task)
    (pose,) = scene.poses
    rotation, position = pose[0][None], (pose[1] + pose[0] @ model.centre)[None]
    modes = find_modes(model, Proposals(start[None], rotation, position))
    np.testing.assert_array_equal(modes.assignments[0], scene.truth)
