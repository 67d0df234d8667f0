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

    minimum = least_squares(deviations, np.zeros(4), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert match.pose.chi2 == pytest.approx(2.0 * minimum.cost, rel=1e-9)
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


def tilted_match(degrees: float, seed: int, noise: float = np.radians(1.0)) -> tuple[rm.Match, rm.Pose]:
    """A match with a vertical that is off by an angle, and the true pose."""
    rng = np.random.default_rng([seed, 61])
    body = rng.uniform(-0.9, 0.9, (10, 3)) * (1.0, 1.0, 0.4)
    pose = rm.Pose(Rotation.random(random_state=seed).as_matrix(), np.array([0.0, 0.0, 4.0]))
    camera = rm.Camera(800.0, 800.0, 640.0, 480.0, size=(1280, 960))
    seen = camera.project(pose.transform(body)) + rng.normal(0.0, 0.3, (10, 2))
    target = np.vstack([seen, rng.uniform((0, 0), (1280, 960), (4, 2))])
    down = pose.R @ (0.0, 0.0, -1.0)
    across = np.cross(down, rng.normal(size=3))
    down = Rotation.from_rotvec(np.radians(degrees) * across / np.linalg.norm(across)).apply(down)
    problem = rm.UP2P(camera, tuple(down.tolist()), (0.0, 0.0, -1.0), noise)
    return rm.match(body, target, problem, noise=0.3), pose


@pytest.mark.parametrize("seed", range(4))
def test_a_vertical_that_is_contradicted_is_told_and_left_out(seed: int) -> None:
    for degrees in (0.0, 2.0):
        match, _ = tilted_match(degrees, seed)
        assert match
        assert match.prior_holds is None
        assert "vertical" not in match.advice
    match, truth = tilted_match(15.0, seed)
    assert match
    assert match.prior_holds is False
    assert "this pose contradicts the measured vertical" in match.advice
    assert match.pose is not None
    assert match.pose.covariance is not None
    off = np.concatenate([Rotation.from_matrix(truth.R @ match.pose.R.T).as_rotvec(), truth.t - match.pose.t])
    assert off @ np.linalg.solve(match.pose.covariance, off) < 22.5  # 99.9 % of χ² of six
    assert match.pose.rms_sigma is not None
    assert match.pose.rms_sigma < 1.8


def upside_down_match(seed: int, count: int = 30) -> rm.Match:
    """Lamps of a hall by bearings over the whole sphere, with a vertical that is the wrong way up."""
    rng = np.random.default_rng([seed, 62])
    lamps = rng.uniform((-20.0, -20.0, 1.0), (20.0, 20.0, 3.0), (count, 3))
    R = Rotation.from_euler("ZX", [rng.uniform(0.0, 360.0), rng.normal(0.0, 5.0)], degrees=True).as_matrix()
    rays = lamps @ R.T + (0.3, -0.2, -1.5)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    strays = rng.normal(size=(5, 3))
    target = np.vstack([rays + rng.normal(0.0, 1e-3, rays.shape), strays])
    target /= np.linalg.norm(target, axis=1, keepdims=True)
    up = tuple((R @ (0.0, 0.0, 1.0)).tolist())
    return rm.match(lamps, target, rm.UP2P(rm.Bearings(), up, (0.0, 0.0, -1.0), np.radians(1.0)), noise=1e-3)


@pytest.mark.parametrize("seed", [0, 1, 54, 68])
def test_the_pose_that_is_told_is_the_one_that_was_weighed(seed: int) -> None:
    """From a pose that is upside down no upright one is near, and a fit from any of them may end elsewhere."""
    match = upside_down_match(seed)
    assert match
    assert match.prior_holds is False
    assert match.pose is not None
    assert match.pose.rms_sigma is not None
    assert match.pose.rms_sigma < 1.5


def test_the_pose_of_what_is_not_trusted_is_the_one_that_was_weighed() -> None:
    match = upside_down_match(27, count=18)
    assert match.status is rm.Status.UNTRUSTED
    assert match.prior_holds is None
    assert match.pose is not None
    assert match.pose.rms_sigma is not None
    assert match.pose.rms_sigma < 1.5
