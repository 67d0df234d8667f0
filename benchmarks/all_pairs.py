"""RANSAC and PnP without putative pairs: every point is paired with every detection.

    python benchmarks/all_pairs.py --first-seed 20000 --scenes 20

`cv2.solvePnPRansac` and `poselib.estimate_absolute_pose` take pairs and look for the pose that most of them agree
with. With n points and n' detections there are n n' pairs, at most n of them true. A scene is solved if the rotation
is within a degree and the centre of the camera within a twentieth of its distance.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from shared import parser, timed

from rootmatch.research.blind.methods import Answer, solve_by_opencv, solve_by_poselib, solve_by_rootmatch
from rootmatch.research.blind.scenes import BlindScene, intrinsics
from rootmatch.simulation import FOCAL, p3p_scene

NOISE = 1.0
"""Standard deviation of a pixel coordinate."""
PATIENCE = 1e6
"""Seconds that a method may take."""
METHODS: dict[str, Callable[[BlindScene, float], Answer]] = {
    "solvePnPRansac, all pairs": solve_by_opencv,
    "PoseLib, all pairs": solve_by_poselib,
    "rootmatch": solve_by_rootmatch,
}
"""As of `rootmatch benchmark blind`, which says how many iterations they have."""


def scene_of(n: int, outliers: int, seed: int) -> BlindScene:
    """A scene of the paper, with the pose of the true correspondences by another library."""
    made, K = p3p_scene(n=n, outliers=outliers, noise=NOISE, seed=seed), intrinsics(FOCAL)
    seen = made.truth >= 0
    _, rvec, t = cv2.solvePnP(made.source[seen], made.target[made.truth[seen]], K, None, flags=cv2.SOLVEPNP_SQPNP)
    R = cv2.Rodrigues(rvec)[0]
    return BlindScene("all pairs", seed, made.source, made.target, NOISE, K=K, R=R, t=t.ravel())


def solved(answer: Answer, scene: BlindScene) -> bool:
    """Whether a pose is within a degree and a twentieth of the distance."""
    if answer.pose is None or not all(np.isfinite(part).all() for part in answer.pose):
        return False
    R, t = answer.pose
    angle = np.degrees(np.arccos(np.clip((np.trace(R.T @ scene.R) - 1.0) / 2.0, -1.0, 1.0)))
    return bool(angle < 1.0 and np.linalg.norm(scene.R.T @ scene.t - R.T @ t) < 0.05 * np.linalg.norm(scene.t))


def main() -> None:
    ask = parser(__doc__, first_seed=20_000, scenes=20)
    ask.add_argument("--csv", type=Path, help="file for the table")
    options = ask.parse_args()
    cv2.setNumThreads(1)
    rows = []
    for n, outliers in ((10, 0), (10, 10), (20, 20)):
        for name, method in METHODS.items():
            right, seconds = 0, []
            for seed in range(options.first_seed, options.first_seed + options.scenes):
                scene = scene_of(n, outliers, seed)
                if not seconds:
                    method(scene, PATIENCE)  # what is compiled or loaded once is not timed
                found, took = timed(partial(method, scene, PATIENCE))
                seconds.append(took)
                right += solved(found, scene)
            rows.append((f"{n} + {outliers}", name, options.scenes, right, f"{np.median(seconds):.4f}"))
            print(*rows[-1], sep=" | ", flush=True)
    table = csv.writer(options.csv.open("w", newline="") if options.csv else sys.stdout, lineterminator="\n")
    table.writerow(("scene", "method", "scenes", "solved", "median s"))
    table.writerows(rows)


if __name__ == "__main__":
    main()
