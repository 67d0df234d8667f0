"""Poses of matched points through PoseLib, for those who want them: matching itself hands none on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import RootmatchError
from rootmatch.problems.base import Problem

Pose = tuple[NDArray[np.float64], NDArray[np.float64]]


def poses_of(
    problem: Problem,
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    assignment: NDArray[np.int64],
    motions: NDArray[np.int64],
) -> list[Pose | None]:
    """One pose (R, t) a motion, None where a motion has fewer matches than the estimator needs."""
    try:
        import poselib
    except ImportError:
        raise RootmatchError("pose: PoseLib is missing; install the extra: pip install 'rootmatch[pose]'") from None
    least = 5 if problem.source_dimension == 2 else 4
    cameras: Any = problem  # problems from a camera have `camera`, those between two views `camera2` too
    poses: list[Pose | None] = []
    for label in range(int(motions.max(initial=-1)) + 1):
        points = np.flatnonzero((motions == label) & (assignment >= 0))
        if len(points) < least:
            poses.append(None)
            continue
        image = target[assignment[points]]
        # every match is kept by a wide gate: refinement is wanted, not another choice of inliers
        options = {"max_reproj_error": 1e4, "max_epipolar_error": 1e4, "seed": 0}
        if problem.source_dimension == 3:
            pose, _ = poselib.estimate_absolute_pose(image, source[points], _described(cameras.camera), options)
        else:
            pose, _ = poselib.estimate_relative_pose(
                source[points], image, _described(cameras.camera), _described(cameras.camera2), options
            )
        poses.append((np.asarray(pose.R), np.asarray(pose.t, dtype=float)))
    return poses


def _described(camera: Camera) -> dict[str, object]:
    width, height = int(2 * camera.cx) + 1, int(2 * camera.cy) + 1
    parameters = [camera.fx, camera.fy, camera.cx, camera.cy]
    return {"model": "PINHOLE", "width": width, "height": height, "params": parameters}
