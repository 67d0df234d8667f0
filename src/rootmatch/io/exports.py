"""Poses for other programs: ROS, OpenXR and TUM's trajectories; `rootmatch.report.colmap` writes COLMAP's models."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.io.outputs import write_text_atomically
from rootmatch.problems.pose_fit.pose import Pose

ROS_ORDER = (3, 4, 5, 0, 1, 2)
"""Rows of a covariance of ROS, translations first, in ours."""


def ros_record(
    pose: Pose, *, frame_id: str = "camera_optical_frame", child_frame_id: str = "body", time: float | None = None
) -> dict[str, Any]:
    """A pose as the fields of ROS' ``geometry_msgs``: a stamped transform, with the covariance of a ``Pose``.

    Parameters
    ----------
    pose : Pose
        In the axes of ``frame_id``: OpenCV's are those of an optical frame (REP 103); for a camera's body frame give
        ``pose.in_axes("ros")``.
    frame_id, child_frame_id : str
        Names of the camera's frame and of that of the points.
    time : float, optional
        Seconds.

    Notes
    -----
    ``covariance`` has 36 numbers, rows of x, y, z, then rotations about the fixed axes of ``frame_id``.
    """
    nanoseconds = 0 if time is None else round(time * 1e9)
    covariance = None
    if pose.covariance is not None:
        covariance = pose.covariance[np.ix_(ROS_ORDER, ROS_ORDER)].reshape(-1).tolist()
    return {
        "header": {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": frame_id},
        "child_frame_id": child_frame_id,
        "transform": {"translation": _name_components(pose.t), "rotation": _name_components(pose.quaternion)},
        "covariance": covariance,
    }


def openxr_record(pose: Pose) -> dict[str, Any]:
    """A pose as the fields of OpenXR's ``XrPosef``, of the points in a view (x right, y up, z backward).

    Lengths are metres in OpenXR, and so they must be in the model.
    """
    turned = pose.in_axes("openxr")
    return {"orientation": _name_components(turned.quaternion), "position": _name_components(turned.t)}


def write_trajectory(path: Path | str, times: Sequence[float], poses: Iterable[Pose | None]) -> None:
    """Write TUM's trajectory: ``time tx ty tz qx qy qz qw`` of the camera in the frame of the points, one per line.

    Parameters
    ----------
    path : path
    times : sequence of float
        Seconds.
    poses : iterable of Pose or None
        From points to camera, as matches have them; what is written is their inverse. Those that are None are left out.
    """
    lines = []
    for time, pose in zip(times, poses, strict=True):
        if not math.isfinite(time):
            raise InputError(f"times: {time} given; give seconds")
        if pose is not None:
            lines.append(" ".join(map(repr, trajectory_row(time, pose))))
    write_text_atomically(Path(path), "".join(f"{line}\n" for line in lines))


def trajectory_row(time: float, pose: Pose) -> list[float]:
    """``time tx ty tz qx qy qz qw`` of the camera in the frame of the points."""
    back = pose.inverse()
    return [float(time), *back.t.tolist(), *back.quaternion.tolist()]


def _name_components(values: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip("xyzw", values.tolist(), strict=False))
