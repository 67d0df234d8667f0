"""The pose of a match under a known vertical: polished from that of the model of the image, and yet upright."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize_scalar
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.problems.pose_fit.camera_fit import camera_poses
from rootmatch.problems.pose_fit.prior_residuals import Upright
from rootmatch.simulation import up2p_scene

SIGMA = 0.7


@pytest.mark.parametrize("seed", range(3, 7))
def test_the_polished_pose_is_the_most_likely_upright_one(seed: int) -> None:
    """By SciPy over an angle and a position; a fit from many starts agrees with both, but for rounding of χ²."""
    scene = up2p_scene(8, 4, noise=SIGMA, seed=seed)
    problem = scene.problem
    match = rm.match(scene.source, scene.target, problem, noise=SIGMA, seed=seed)
    assert match.pose is not None
    assert match.finding.pose is not None
    down, camera_down = (np.array(v, float) for v in (problem.vertical_world, problem.vertical_camera))
    np.testing.assert_allclose(match.pose.R @ down, camera_down, atol=1e-12)
    used = match.assignment >= 0
    points, detected = scene.source[used], scene.target[match.assignment[used]]
    first, place = match.finding.pose.R, match.finding.pose.t
    upright = Rotation.align_vectors(camera_down[None], (first @ down)[None])[0].as_matrix() @ first

    def deviations(step: np.ndarray) -> np.ndarray:
        R = Rotation.from_rotvec(step[0] * camera_down).as_matrix() @ upright
        return ((problem.camera.project(points @ R.T + place + step[1:]) - detected) / SIGMA).ravel()

    least = least_squares(deviations, np.zeros(4), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert match.pose.chi2 == pytest.approx(2.0 * least.cost, rel=1e-9)
    (anew,) = match.poses_of(match.assignment)
    assert anew is not None
    assert anew.covariance is not None
    deviation = np.sqrt(np.diag(anew.covariance)[3:])
    assert (np.abs(match.pose.t - anew.t) < 1e-5 * deviation).all()
    np.testing.assert_allclose(match.pose.covariance, anew.covariance, atol=1e-6 * np.abs(anew.covariance).max())


def test_a_start_off_the_vertical_is_turned_onto_it() -> None:
    """An exact vertical is no term of a fit: steps only turn about it."""
    scene = up2p_scene(8, 0, noise=SIGMA, seed=11)
    match = rm.match(scene.source, scene.target, scene.problem, noise=SIGMA, seed=11)
    assert match.pose is not None
    tilted = Rotation.from_rotvec([0.2, 0.1, -0.2]).as_matrix() @ match.pose.R
    given = match.task.points, scene.problem.camera, match.assignment[None], scene.problem.upright
    (pose,) = camera_poses(*given, start=rm.Pose(tilted, match.pose.t))
    assert pose is not None
    assert pose.chi2 == pytest.approx(match.pose.chi2, rel=1e-9)
    np.testing.assert_allclose(pose.R, match.pose.R, atol=1e-8)


def test_the_nearest_upright_rotation() -> None:
    """Nearest by the angle of the rotation between both, which is searched over all upright ones."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        world, camera, rotation = Rotation.random(3, random_state=rng).as_matrix()
        upright = Upright(world, camera, 0.0)
        found = upright.nearest(rotation)
        np.testing.assert_allclose(found @ world[1], camera[1], atol=1e-12)

        def angle(turn: float, upright: Upright = upright, rotation: np.ndarray = rotation) -> float:
            one = upright.camera.T @ Rotation.from_rotvec([0.0, turn, 0.0]).as_matrix() @ upright.world
            return float(Rotation.from_matrix(one @ rotation.T).magnitude())

        nearest = min(minimize_scalar(angle, bounds=(k, k + 1.1), method="bounded").fun for k in range(-4, 4))
        assert Rotation.from_matrix(found @ rotation.T).magnitude() <= nearest + 1e-9
