"""Minimal solvers of poselib, OpenCV and pytheia behind one face: instance -> list of (rotation, translation).

Every solution is judged by its own reprojection error before anything is concluded from it, because near a
degeneracy these solvers return sloppy or spurious poses too.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import poselib
import pytheia
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import oracles
from instances import Instance

Poses = list[tuple[np.ndarray, np.ndarray]]


def p3p_poselib(instance: Instance) -> Poses:
    rays = oracles.bearings(instance.target, instance.intrinsics)  # poselib wants unit rays
    return [(pose.R, pose.t) for pose in poselib.p3p(rays, instance.source)]


def p3p_opencv(instance: Instance, flag: int = cv2.SOLVEPNP_AP3P) -> Poses:
    """Ke and Roumeliotis 2017; OpenCV's other flag is the algorithm that poselib has."""
    fx, fy, cx, cy = instance.intrinsics
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    pixels = np.ascontiguousarray(instance.target.reshape(3, 1, 2))
    _, turns, shifts = cv2.solveP3P(instance.source.reshape(3, 1, 3), pixels, matrix, None, flags=flag)
    return [(cv2.Rodrigues(r)[0], np.ravel(t)) for r, t in zip(turns, shifts, strict=True)]


def up2p_poselib(instance: Instance) -> Poses:
    """poselib turns about y: both frames are turned so that the verticals are y, and the pose is turned back."""
    y = np.array([0.0, 1.0, 0.0])
    camera = Rotation.align_vectors(y[None], instance.vertical_camera[None])[0].as_matrix()
    world = Rotation.align_vectors(y[None], instance.vertical_world[None])[0].as_matrix()
    rays = oracles.bearings(instance.target, instance.intrinsics) @ camera.T
    poses = poselib.up2p(rays, instance.source @ world.T)
    return [(camera.T @ pose.R @ world, camera.T @ pose.t) for pose in poses]


def up2p_pytheia(instance: Instance) -> Poses:
    """pytheia takes any axis, the same in both frames: only the world is turned. Its quaternions are w, x, y, z."""
    axis = instance.vertical_camera
    world = Rotation.align_vectors(axis[None], instance.vertical_world[None])[0].as_matrix()
    points = instance.source @ world.T
    rays = oracles.bearings(instance.target, instance.intrinsics)
    count, quaternions, shifts = pytheia.sfm.TwoPointPosePartialRotation(axis, points[0], points[1], rays[0], rays[1])
    turns = [Rotation.from_quat(np.ravel(q), scalar_first=True).as_matrix() for q in quaternions[:count]]
    return [(turn @ world, np.ravel(t)) for turn, t in zip(turns, shifts[:count], strict=True)]


def ray_error(instance: Instance, rotation: np.ndarray, translation: np.ndarray) -> float:
    """Largest sine between a ray and the line through the centre and its point (a point behind counts as seen)."""
    points = instance.source @ rotation.T + translation
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    rays = oracles.bearings(instance.target, instance.intrinsics)
    return float(np.nan_to_num(np.linalg.norm(np.cross(points, rays), axis=1), nan=1.0).max())


def ray_depths(instance: Instance, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Signed depths along the rays, (m,): negative behind the camera, where the equations hold all the same."""
    points = instance.source @ rotation.T + translation
    return np.sum(points * oracles.bearings(instance.target, instance.intrinsics), axis=1)


def polished_depths(instance: Instance, depths: np.ndarray) -> np.ndarray | None:
    """Newton's method on the three distance equations from ``depths`` (3,); None where it leaves the neighbourhood."""
    rays = oracles.bearings(instance.target, instance.intrinsics)
    pairs = ((0, 1), (1, 2), (2, 0))
    sides = np.array([np.sum((instance.source[i] - instance.source[j]) ** 2) for i, j in pairs])

    def laws(values: np.ndarray) -> np.ndarray:
        points = values[:, None] * rays
        return np.array([np.sum((points[i] - points[j]) ** 2) for i, j in pairs]) / sides - 1.0

    found = least_squares(laws, depths, x_scale=np.abs(depths), xtol=1e-15, ftol=1e-15, gtol=1e-15, method="lm")
    close = np.abs(found.x / depths - 1.0).max() < 0.05
    return found.x if close and np.abs(found.fun).max() < 1e-9 else None


def polished_turn(instance: Instance, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray | None:
    """Gauss-Newton on u x (R X + t) = 0 over the turn about the vertical and t; the rotation, None where it fails."""
    rays = oracles.bearings(instance.target, instance.intrinsics)
    middle = instance.source.mean(axis=0)
    start = rotation @ middle + translation

    def turned(angle: float) -> np.ndarray:
        return rotation @ Rotation.from_rotvec(angle * instance.vertical_world).as_matrix()

    def lines(values: np.ndarray) -> np.ndarray:
        points = (instance.source - middle) @ turned(values[0]).T + start + values[1:]
        return np.cross(rays, points).ravel()

    found = least_squares(lines, np.zeros(4), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15, method="lm")
    return turned(found.x[0]) if abs(found.x[0]) < 0.05 and np.abs(found.fun).max() < 5e-14 else None


Solver = Callable[[Instance], Poses]
P3P_SOLVERS: dict[str, Solver] = {"poselib": p3p_poselib, "opencv": p3p_opencv}
UP2P_SOLVERS: dict[str, Solver] = {"poselib": up2p_poselib, "pytheia": up2p_pytheia}
