"""Methods compared on blind PnP: this library, and baselines that need no training.

Local methods are begun from random rotations until a pose explains nearly all points or all detections, or until their
starts or their time are spent; the pose with the most support is their answer. A detection supports a pose if it and a
point are each other's nearest, within three standard deviations. Estimators that need putative pairs are given all.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rootmatch.algebra.rotation import random_rotation
from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError
from rootmatch.research.blind.scenes import BlindScene, project_points
from rootmatch.research.blind.softposit import softposit

GATE = 3.0
"""Standard deviations within which a detection supports a pose."""
STARTS = 1000
ENOUGH = 0.9
"""Share of the points or detections, whichever are fewer, that ends a search."""
PAIRS = 100_000
"""Most pairs that are handed to an estimator."""
OPENCV_ITERATIONS, POSELIB_ITERATIONS = 10_000, 100_000


class Answer(NamedTuple):
    """A pose, or none, and whether the method vouches for it."""

    pose: tuple[Floats, Floats] | None
    claimed: bool


Method = Callable[[BlindScene, float], Answer]
"""From a scene and the seconds of processor time that are allowed."""


def solve_by_rootmatch(scene: BlindScene, seconds: float) -> Answer:
    """Match with the camera and the noise, as any user would."""
    from rootmatch.api import match
    from rootmatch.cameras.pinhole import Camera
    from rootmatch.problems.p3p import P3P

    found = match(scene.source, scene.target, P3P(Camera.from_matrix(scene.K)), noise=scene.noise, max_seconds=seconds)
    pose = found.poses[0] if found.poses else None
    return Answer(None if pose is None else (pose.R, pose.t), bool(found))


def solve_by_icp(scene: BlindScene, seconds: float) -> Answer:
    """Nearest neighbours and a pose in turn, from many rotations."""
    return _best(scene, (_descend_icp(scene, *start) for start in _starts(scene)), seconds)


def solve_by_softposit(scene: BlindScene, seconds: float) -> Answer:
    """SoftPOSIT from many rotations, each result refined as those of ICP."""
    image, focal = scene.target - scene.K[:2, 2], float(scene.K[0, 0])

    def poses() -> Iterator[tuple[Floats, Floats]]:
        for R, t in _starts(scene):
            R, t = softposit(scene.source, image, focal, scene.noise, start=(R, t))
            if t[2] > 0.0 and np.isfinite(t).all():
                yield _descend_icp(scene, R, t, gate=10.0 * GATE * scene.noise)

    return _best(scene, poses(), seconds)


def solve_by_opencv(scene: BlindScene, seconds: float) -> Answer:
    """`cv2.solvePnPRansac` fed all pairs."""
    import cv2

    points, pixels = _all_pairs(scene)
    found, rvec, t, _ = cv2.solvePnPRansac(
        points, pixels, scene.K, None,
        iterationsCount=OPENCV_ITERATIONS, reprojectionError=GATE * scene.noise, confidence=0.999,
    )  # fmt: skip
    pose = (np.asarray(cv2.Rodrigues(rvec)[0], float), np.asarray(t, float).ravel()) if found else None
    return Answer(pose, bool(found))


def solve_by_poselib(scene: BlindScene, seconds: float) -> Answer:
    """`poselib.estimate_absolute_pose` fed all pairs."""
    import poselib

    points, pixels = _all_pairs(scene)
    params = [scene.K[0, 0], scene.K[1, 1], scene.K[0, 2], scene.K[1, 2]]
    camera = {"model": "PINHOLE", "width": 640, "height": 480, "params": params}
    options = {"max_iterations": POSELIB_ITERATIONS, "max_reproj_error": GATE * scene.noise, "success_prob": 0.999}
    pose, _ = poselib.estimate_absolute_pose(pixels, points, camera, options, {})
    return Answer((np.array(pose.R), np.array(pose.t)), True)


def load_peer(path: Path) -> Method:
    """The function ``ransac_match(points, pixels, K, tolerance, max_seconds, seed)`` of another program's file.

    It returns an assignment, a pose (R, t) and the number of inliers.
    """
    if not path.is_file():
        raise InputError(f"peer: {path} is no file; give a Python file with a function ransac_match")
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[path.stem] = module  # its compiled kernels, if read from a cache, ask for it by name
    spec.loader.exec_module(module)

    def run(scene: BlindScene, seconds: float) -> Answer:
        tolerance = GATE * scene.noise
        _, pose, _ = module.ransac_match(
            scene.source, scene.target, scene.K, tolerance, max_seconds=seconds, seed=scene.seed
        )[:3]
        return Answer(None if pose is None else (np.array(pose[0]), np.array(pose[1])), pose is not None)

    return run


def methods(peer: Path | None = None) -> dict[str, Method]:
    """All methods that can be run here, by name."""
    found: dict[str, Method] = {"rootmatch": solve_by_rootmatch, "SoftPOSIT": solve_by_softposit, "ICP": solve_by_icp}
    if find_spec("cv2") is not None:
        found["solvePnPRansac, all pairs"] = solve_by_opencv
    if find_spec("poselib") is not None:
        found["PoseLib, all pairs"] = solve_by_poselib
    if peer is not None:
        found["brute force"] = load_peer(peer)
    return found


def _all_pairs(scene: BlindScene) -> tuple[Floats, Floats]:
    """Every point with every detection, thinned to `PAIRS`."""
    n, n_target = len(scene.source), len(scene.target)
    points, pixels = np.repeat(scene.source, n_target, axis=0), np.tile(scene.target, (n, 1))
    if len(points) > PAIRS:
        kept = np.random.default_rng(scene.seed).choice(len(points), PAIRS, replace=False)
        points, pixels = points[kept], pixels[kept]
    return points, pixels


def _starts(scene: BlindScene) -> Iterator[tuple[Floats, Floats]]:
    """Random rotations, with the translation at which the model's spread and centre are those of the detections."""
    rng = np.random.default_rng([scene.seed, 3])
    middle = scene.source.mean(axis=0)
    size = np.sqrt(((scene.source - middle) ** 2).sum() / len(scene.source) * (2.0 / 3.0))
    centre = scene.target.mean(axis=0)
    spread = float(np.sqrt(((scene.target - centre) ** 2).sum() / len(scene.target)))
    depth = scene.K[0, 0] * size / spread
    ray = np.append((centre - scene.K[:2, 2]) / (scene.K[0, 0], scene.K[1, 1]), 1.0)
    for _ in range(STARTS):
        R = random_rotation(rng)
        yield R, depth * ray - R @ middle


def _best(scene: BlindScene, poses: Iterator[tuple[Floats, Floats]], seconds: float) -> Answer:
    """The pose with the most support, of those that come in time."""
    ends, best, maximum = time.process_time() + seconds, None, 0
    for R, t in poses:
        support = len(_mutual_nearest_pairs(scene, R, t, GATE * scene.noise)[0])
        if support > maximum:
            best, maximum = (R, t), support
        if time.process_time() > ends or maximum >= ENOUGH * min(len(scene.source), len(scene.target)):
            break
    return Answer(best, best is not None)


def _mutual_nearest_pairs(scene: BlindScene, R: Floats, t: Floats, gate: float) -> tuple[Integers, Integers]:
    """Points and detections that are each other's nearest, within a gate in pixels."""
    if (scene.source @ R[2] + t[2]).min() <= 0.0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    image = project_points(scene.K, R, t, scene.source)
    distance, nearest = cKDTree(image).query(scene.target)
    _, back = cKDTree(scene.target).query(image)
    j = np.flatnonzero((back[nearest] == np.arange(len(scene.target))) & (distance < gate))
    return nearest[j].astype(np.int64), j


def _descend_icp(scene: BlindScene, R: Floats, t: Floats, gate: float = np.inf) -> tuple[Floats, Floats]:
    """Mutual nearest neighbours and a Gauss-Newton step in turn, until the pairs stay the same; the gate shrinks."""
    before: Any = None
    for _ in range(30):
        i, j = _mutual_nearest_pairs(scene, R, t, max(gate, GATE * scene.noise))
        if len(i) < 4 or (before is not None and np.array_equal(before[0], i) and np.array_equal(before[1], j)):
            break
        before, gate = (i, j), 0.7 * gate
        R, t = _gauss_newton_step(scene, R, t, i, j)
    return R, t


def _gauss_newton_step(scene: BlindScene, R: Floats, t: Floats, i: Integers, j: Integers) -> tuple[Floats, Floats]:
    """One damped Gauss-Newton step of the reprojection error of pairs."""
    x, y, z = (scene.source[i] @ R.T + t).T
    fx, fy = scene.K[0, 0], scene.K[1, 1]
    error = (scene.target[j] - scene.K[:2, 2] - np.stack([fx * x / z, fy * y / z], axis=1)).ravel()
    zero = np.zeros_like(x)
    by_point = np.stack([fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2], axis=1).reshape(-1, 2, 3)
    turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
    jacobian = np.concatenate([by_point @ turn, by_point], axis=2).reshape(-1, 6)
    normal = jacobian.T @ jacobian
    step = np.linalg.solve(normal + 1e-6 * np.diag(np.diag(normal)) + 1e-12 * np.eye(6), jacobian.T @ error)
    step[:3] *= min(1.0, 0.5 / max(float(np.linalg.norm(step[:3])), 1e-12))
    turned = Rotation.from_rotvec(step[:3]).as_matrix()
    moved = turned @ t + step[3:]
    return (turned @ R, moved) if moved[2] > 0.0 else (R, t)
