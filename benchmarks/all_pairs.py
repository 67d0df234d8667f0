"""RANSAC and PnP without putative pairs: every point is paired with every detection.

    python benchmarks/all_pairs.py --first-seed 20000 --scenes 20

`cv2.solvePnPRansac` and `poselib.estimate_absolute_pose` take pairs and look for the pose that most of them agree
with. With n points and n' detections there are n n' pairs, at most n of them true. A scene is solved if the rotation
is within a degree and the centre of the camera within a twentieth of its distance.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import poselib

import rootmatch as rm
from rootmatch.simulation import Scene, p3p_scene

NOISE = 1.0
"""Standard deviation of a pixel coordinate."""
GATE = 3.0 * NOISE
"""Threshold of both libraries, in pixels: what is farther from its projection is no inlier."""
OPENCV_ITERATIONS = 10_000
"""A hundred times its default; 100,000 take six seconds a scene and solve none of the first three either."""
POSELIB_ITERATIONS = 100_000
"""Its default."""

Pose = tuple[np.ndarray, np.ndarray]


def pairs(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Every point with every detection."""
    n, n_target = len(scene.source), len(scene.target)
    return np.repeat(scene.source, n_target, axis=0), np.tile(scene.target, (n, 1))


def by_opencv(scene: Scene, K: np.ndarray) -> Pose | None:
    points, pixels = pairs(scene)
    found, rvec, t, _ = cv2.solvePnPRansac(
        points, pixels, K, None, iterationsCount=OPENCV_ITERATIONS, reprojectionError=GATE, confidence=0.999
    )
    return (cv2.Rodrigues(rvec)[0], t.ravel()) if found else None


def by_poselib(scene: Scene, K: np.ndarray) -> Pose | None:
    points, pixels = pairs(scene)
    camera = {"model": "PINHOLE", "width": 640, "height": 480, "params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]}
    options = {"max_iterations": POSELIB_ITERATIONS, "max_reproj_error": GATE, "success_prob": 0.999}
    pose, _ = poselib.estimate_absolute_pose(pixels, points, camera, options, {})
    return np.array(pose.R), np.array(pose.t)


def by_rootmatch(scene: Scene, K: np.ndarray) -> Pose | None:
    match = rm.match(scene.source, scene.target, scene.problem, noise=NOISE)
    R, t = match.poses[0]
    return R, t


METHODS: dict[str, Callable[[Scene, np.ndarray], Pose | None]] = {
    "solvePnPRansac, all pairs": by_opencv,
    "PoseLib, all pairs": by_poselib,
    "rootmatch": by_rootmatch,
}


def true_pose(scene: Scene, K: np.ndarray) -> Pose:
    """The pose of the true correspondences, by another library."""
    seen = scene.truth >= 0
    _, rvec, t = cv2.solvePnP(scene.source[seen], scene.target[scene.truth[seen]], K, None, flags=cv2.SOLVEPNP_SQPNP)
    return cv2.Rodrigues(rvec)[0], t.ravel()


def solved(found: Pose | None, truth: Pose) -> bool:
    if found is None or not all(np.isfinite(part).all() for part in found):
        return False
    angle = np.degrees(np.arccos(np.clip((np.trace(found[0].T @ truth[0]) - 1.0) / 2.0, -1.0, 1.0)))
    centre, true_centre = (-R.T @ t for R, t in (found, truth))
    return bool(angle < 1.0 and np.linalg.norm(centre - true_centre) < 0.05 * np.linalg.norm(true_centre))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-seed", type=int, default=20_000)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--csv", type=Path, help="file for the table")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows = []
    for n, outliers in ((10, 0), (10, 10), (20, 20)):
        for name, method in METHODS.items():
            right, seconds = 0, []
            for seed in range(options.first_seed, options.first_seed + options.scenes):
                scene = p3p_scene(n=n, outliers=outliers, noise=NOISE, seed=seed)
                camera = scene.problem.camera
                K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
                if not seconds:
                    method(scene, K)  # what is compiled or loaded once is not timed
                started = time.process_time()
                found = method(scene, K)
                seconds.append(time.process_time() - started)
                right += solved(found, true_pose(scene, K))
            rows.append((f"{n} + {outliers}", name, options.scenes, right, f"{np.median(seconds):.4f}"))
            print(*rows[-1], sep=" | ", flush=True)
    table = csv.writer(options.csv.open("w", newline="") if options.csv else sys.stdout, lineterminator="\n")
    table.writerow(("scene", "method", "scenes", "solved", "median s"))
    table.writerows(rows)


if __name__ == "__main__":
    main()
