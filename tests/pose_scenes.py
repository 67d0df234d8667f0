"""Seeded scenes for pose fits: a problem, its noisy points, and the true pose; also used by ``benchmarks/poses.py``."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import rootmatch as rm
from robot_scenes import INTRINSICS, robot, zoomed
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.problems.points import PointSets
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene

CAMERA = rm.Camera(*INTRINSICS)
K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])


class PoseScene(NamedTuple):
    """Matched points, and what their pose is in truth."""

    problem: rm.Problem
    source: np.ndarray
    target: np.ndarray
    noise: object
    assignment: np.ndarray
    R: np.ndarray
    t: np.ndarray
    scale: float
    focal: float
    dof: int
    """Degrees of freedom of the pose: the rank of its covariance."""

    @property
    def points(self) -> PointSets:
        return self.problem.validated(self.source, self.target, self.noise)  # type: ignore[arg-type]

    def fitted(self) -> rm.Pose:
        (pose,) = self.problem.poses(self.points, self.assignment[None])
        assert pose is not None
        return pose

    def error(self, pose: rm.Pose) -> np.ndarray:
        """Errors (p,) in the order of the covariance."""
        turn = self.R @ pose.R.T
        angles = Rotation.from_matrix(turn).as_rotvec() if len(turn) == 3 else [np.arctan2(turn[1, 0], turn[0, 0])]
        shift = self.t - pose.t
        if isinstance(
            self.problem, rm.ThreePlusOne | rm.PlanarMotion
        ):  # of length 1: its covariance lies in the tangent plane
            shift = shift - (shift @ pose.t) * pose.t
        error = [*angles, *shift]
        assert pose.covariance is not None
        if len(pose.covariance) > len(error):
            error.append(self.focal - pose.focal if pose.focal is not None else self.scale - pose.scale)
        return np.array(error)

    def squared_error(self, pose: rm.Pose) -> float:
        """The normalised estimation error squared: χ² with `dof` degrees of freedom where the covariance holds."""
        assert pose.covariance is not None
        deviation = np.sqrt(np.diag(pose.covariance))
        scale = np.where(deviation > 0.0, deviation, 1.0)
        values, vectors = np.linalg.eigh(pose.covariance / np.outer(scale, scale))
        kept = slice(len(values) - self.dof, None)
        along = (self.error(pose) / scale) @ vectors
        return float((along[kept] ** 2 / values[kept]).sum())


def _simulated(
    make: Callable[..., object], dof: int, seed: int, n: int, noise: float = 1.0, **options: float
) -> PoseScene:
    scene: object = make(n, 2, noise, seed, **options)
    R, t = scene.poses[0]  # type: ignore[attr-defined]
    if dof == 3:
        t = t / np.linalg.norm(t)
    return PoseScene(scene.problem, scene.source, scene.target, noise, scene.truth, R, t, 1.0, 0.0, dof)  # type: ignore[attr-defined]


def _tilted(rng: np.random.Generator, sigma: float) -> np.ndarray:
    """(0, 1, 0) as measured with an error of σ radians on each of two axes."""
    x, z = sigma * rng.standard_normal(2)
    return Rotation.from_rotvec([x, 0.0, z]).as_matrix() @ [0.0, 1.0, 0.0]


def p3p(seed: int, n: int = 10) -> PoseScene:
    return _simulated(p3p_scene, 6, seed, n)


def up2p(seed: int, n: int = 10) -> PoseScene:
    return _simulated(up2p_scene, 4, seed, n)


def up2p_noisy(seed: int, n: int = 10) -> PoseScene:
    """The vertical is known to half a degree."""
    scene, sigma = up2p(seed, n), np.deg2rad(0.5)
    measured = _tilted(np.random.default_rng(seed), sigma)
    problem = rm.UP2P(scene.problem.camera, tuple(measured), (0.0, 1.0, 0.0), sigma)  # type: ignore[attr-defined]
    return scene._replace(problem=problem, dof=6)


def three_plus_one(seed: int, n: int = 12) -> PoseScene:
    return _simulated(three_plus_one_scene, 3, seed, n, noise=0.3, baseline=4.0)


def three_plus_one_noisy(seed: int, n: int = 12) -> PoseScene:
    """Both directions are known to half a degree."""
    scene, sigma = three_plus_one(seed, n), np.deg2rad(0.5)
    rng = np.random.default_rng(seed)
    problem = rm.ThreePlusOne(
        scene.problem.camera,  # type: ignore[attr-defined]
        axis=tuple(_tilted(rng, sigma)),
        axis2=tuple(_tilted(rng, sigma)),
        axis_noise=sigma,
    )
    return scene._replace(problem=problem, dof=5)


def planar(seed: int, n: int = 12) -> PoseScene:
    made = robot(n, outliers=2, noise=0.3, seed=seed, tilt=0.2)
    problem = rm.PlanarMotion(CAMERA, axis=tuple(made.vertical), axis2=tuple(made.vertical))
    t = made.translation / np.linalg.norm(made.translation)
    return PoseScene(problem, made.source, made.target, 0.3, made.truth, made.rotation, t, 1.0, 0.0, 2)


def up2pf(seed: int, n: int = 12) -> PoseScene:
    made = zoomed(n, outliers=2, noise=0.5, seed=seed)
    problem = rm.UP2PF((320.0, 240.0), tuple(made.vertical), (0, 1, 0))
    return PoseScene(
        problem, made.source, made.target, 0.5, made.truth, made.rotation, made.translation, 1.0, made.focal, 5
    )


def point_sets(seed: int, problem: rm.Similarity, n: int = 8) -> PoseScene:
    """Points of both sets with a σ of their own each."""
    rng = np.random.default_rng(seed)
    dimension, known = problem.dimension, isinstance(problem, rm.Rigid)
    points = rng.uniform(-1.0, 1.0, (n, dimension)) + rng.uniform(-3.0, 3.0, dimension)
    scale = 1.0 if known else float(rng.uniform(0.3, 3.0))
    if dimension == 3:
        R = Rotation.random(rng=rng).as_matrix()
    else:
        angle = rng.uniform(-np.pi, np.pi)
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    t = rng.normal(size=dimension)
    sigma, sigma2 = rng.uniform(0.001, 0.02, n), rng.uniform(0.001, 0.02, n)
    target = scale * points @ R.T + t + sigma2[:, None] * rng.normal(size=(n, dimension))
    source = points + sigma[:, None] * rng.normal(size=(n, dimension))
    order = rng.permutation(n)
    dof = (6 if dimension == 3 else 3) + (0 if known else 1)
    truth = np.argsort(order)
    return PoseScene(problem, source, target[order], (sigma, sigma2[order]), truth, R, t, scale, 0.0, dof)


def seen_by(camera: CameraModel, seed: int, noise: float, spread: float = 2.0, n: int = 12) -> PoseScene:
    """Points all about a camera that may see wide, with a σ of their own each."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng).as_matrix()
    positions = rng.normal(size=(50 * n, 3)) * [spread, spread, 2.0] + [0.0, 0.0, 3.0]
    positions = positions[camera.sees(positions) & (np.linalg.norm(positions, axis=1) > 1.0)]
    image = camera.project(positions)
    if camera.dimension == 2:
        away = np.abs(image - [320.0, 240.0])
        inside = (away < [320.0, 240.0]).all(axis=1) & (np.linalg.norm(away, axis=1) < 350.0)  # the fisheye ends at 376
        positions, image = positions[inside], image[inside]
    positions, image = positions[:n], image[:n]
    sigma = noise * rng.uniform(0.5, 2.0, n)
    if camera.dimension == 3:
        image = image + sigma[:, None] * np.cross(image, rng.normal(size=(n, 3)))
        image = camera.bearings(image)
    else:
        image = image + sigma[:, None] * rng.normal(size=(n, 2))
    t = rng.normal(size=3)
    return PoseScene(rm.P3P(camera), (positions - t) @ R, image, sigma, np.arange(n), R, t, 1.0, 0.0, 6)


BROWN = rm.Camera.from_opencv(K, [-0.28, 0.07, 1e-3, -5e-4, 0.0])
FISHEYE = rm.Camera.from_opencv_fisheye(
    0.33 * K + np.diag([0.0, 0.0, 0.67]) + [[0, 0, 214], [0, 0, 161], [0, 0, 0]], [0.02, -0.01, 0.0, 0.0]
)

SCENES: dict[str, Callable[[int], PoseScene]] = {
    "p3p": p3p,
    "p3p, 6 points": lambda seed: p3p(seed, 6),
    "p3p, OpenCV's distortion": lambda seed: seen_by(BROWN, seed, 0.5),
    "p3p, fisheye": lambda seed: seen_by(FISHEYE, seed, 0.5, 4.0),
    "p3p, unit rays": lambda seed: seen_by(UnitRays(), seed, 0.001, 4.0),
    "up2p": up2p,
    "up2p, noisy vertical": up2p_noisy,
    "3p1": three_plus_one,
    "3p1, noisy axes": three_plus_one_noisy,
    "planar": planar,
    "up2pf": up2pf,
    "similarity": lambda seed: point_sets(seed, rm.Similarity(2)),
    "similarity in space": lambda seed: point_sets(seed, rm.Similarity(3)),
    "rigid": lambda seed: point_sets(seed, rm.Rigid(2)),
    "rigid in space": lambda seed: point_sets(seed, rm.Rigid(3)),
}
