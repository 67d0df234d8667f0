"""Camera poses by PoseLib and OpenCV, refined, over random and nearly degenerate scenes; for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np
import poselib
from scipy.spatial.transform import Rotation

import rootmatch as rm

CAMERA = rm.Camera(800.0, 810.0, 320.0, 240.0)
SHAPES = ("ball", "plane", "nearly a plane", "nearly a line", "deep", "four points", "four in a plane", "five points")

SIZES = {
    "plane": (1.0, 1.0, 0.0),
    "four in a plane": (1.0, 1.0, 0.0),
    "nearly a plane": (1.0, 1.0, 0.02),
    "nearly a line": (1.0, 0.02, 0.02),
    "deep": (1.0, 1.0, 4.0),
}


def scene(seed: int) -> tuple[str, np.ndarray, np.ndarray, float]:
    """Shape, points (n, 3), pixels (n, 2) and σ."""
    rng = np.random.default_rng(seed)
    shape = SHAPES[seed % len(SHAPES)]
    n = {"four points": 4, "four in a plane": 4, "five points": 5}.get(shape, int(rng.integers(6, 15)))
    size = SIZES.get(shape, (1.0, 1.0, 1.0))
    points = rng.uniform(-1.0, 1.0, (n, 3)) * size
    distance = 10.0 ** rng.uniform(0.8, 1.6)
    R = Rotation.random(rng=rng).as_matrix()
    positions = points @ R.T + distance * np.array([*rng.uniform(-0.2, 0.2, 2), 1.0])
    sigma = 10.0 ** rng.uniform(-1.0, 0.5)
    image = CAMERA.project(positions) + sigma * rng.standard_normal((n, 2))
    return shape, points, image, sigma


def cost(points: np.ndarray, image: np.ndarray, R: np.ndarray, t: np.ndarray) -> float:
    """Sum of squared pixels; infinite behind the camera."""
    x, y, z = R @ points.T + t.reshape(3, 1)
    if not (z > 0.0).all():
        return np.inf
    u = CAMERA.fx * x / z + CAMERA.cx - image[:, 0]
    v = CAMERA.fy * y / z + CAMERA.cy - image[:, 1]
    return float(u @ u + v @ v)


def by_poselib(points: np.ndarray, image: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """RANSAC with every point an inlier, refined."""
    described = {"model": "PINHOLE", "width": 640, "height": 480, "params": list(CAMERA.numbers)}
    keep = {"max_reproj_error": 1e6, "seed": 0, "min_iterations": 100}
    pose, _ = poselib.estimate_absolute_pose(image, points, described, keep, {"loss_type": "TRIVIAL"})
    yield pose.R, pose.t


def by_opencv(points: np.ndarray, image: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Every solution of SQPNP, IPPE, EPNP and the iterative solver, refined by Levenberg and Marquardt."""
    flags = [cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_EPNP, cv2.SOLVEPNP_ITERATIVE]
    if len(points) == 4:
        flags.append(cv2.SOLVEPNP_AP3P)
    for flag in flags:
        try:
            _, rotations, translations, _ = cv2.solvePnPGeneric(points, image, CAMERA.matrix, None, flags=flag)
        except cv2.error:
            continue  # IPPE takes points of a plane, others six of them
        for rotation, translation in zip(rotations, translations, strict=True):
            if not np.isfinite(rotation).all() or not np.isfinite(translation).all():
                continue
            strict = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-15)
            refined = cv2.solvePnPRefineLM(points, image, CAMERA.matrix, None, rotation, translation, strict)
            yield cv2.Rodrigues(refined[0])[0], refined[1]


PEERS: dict[str, Callable[[np.ndarray, np.ndarray], Iterator[tuple[np.ndarray, np.ndarray]]]] = {
    "PoseLib": by_poselib,
    "OpenCV": by_opencv,
}


def compared(seed: int) -> tuple[str, float, dict[str, float]]:
    """Shape, our cost in pixel², and each library's lowest."""
    shape, points, image, sigma = scene(seed)
    problem = rm.P3P(CAMERA)
    (pose,) = problem.poses(problem.validated(points, image, sigma), np.arange(len(points))[None])
    ours = np.inf if pose is None else cost(points, image, pose.R, pose.t)
    theirs = {
        name: min((cost(points, image, R, t) for R, t in peer(points, image)), default=np.inf)
        for name, peer in PEERS.items()
    }
    return shape, ours, theirs
