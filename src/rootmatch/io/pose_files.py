"""Files of the poses of one image: CSV with covariance, JSON, and the records of ROS and OpenXR."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from rootmatch.errors import InputError, quote_value
from rootmatch.io.calibrations.reading import load_json, read_small_text
from rootmatch.io.calibrations.values import prefix_errors
from rootmatch.io.csv_tables import write_table
from rootmatch.io.exports import openxr_record, ros_record
from rootmatch.io.outputs import is_standard_output, write_text_atomically
from rootmatch.problems.pose_fit.pose import Pose

PoseFormat = Literal["csv", "json", "ros", "openxr", "colmap"]
FORMATS: tuple[PoseFormat, ...] = get_args(PoseFormat)
SUFFIXES: dict[str, PoseFormat] = {".csv": "csv", ".json": "json"}
IN_SPACE = ("rx", "ry", "rz", "tx", "ty", "tz")
IN_PLANE = ("angle", "tx", "ty")


def pose_format(path: Path, given: str | None) -> PoseFormat:
    """The format of a file of poses: as given, else by its suffix."""
    if given == "tum" or (given is None and path.suffix.lower() == ".tum"):
        raise InputError(
            f"poses {path}: a TUM trajectory needs the times of its poses, which a single image does not have; "
            "`rootmatch track` writes one"
        )
    if given is not None:
        if given in FORMATS:
            return given
        raise InputError(f"pose_format: {quote_value(given)} given; give csv, json, ros, openxr or colmap")
    if is_standard_output(path):  # as `rootmatch track` prints them
        return "csv"
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"poses {path}: its suffix names no format; use .csv or .json, or give --pose-format")
    return SUFFIXES[path.suffix.lower()]


def pose_record(pose: Pose) -> dict[str, Any]:
    """A pose as numbers, lists and strings that JSON can hold; what is absent or not finite is null.

    Keys: ``R`` (rows), ``t``, ``quaternion`` (x, y, z, w; null in a plane or of a reflection), ``scale``, ``focal``
    (pixels), ``covariance`` (rows, in the order of ``parameters``: rotations in radians, translations, then scale or
    focal length), ``chi2``, ``dof``, ``rms`` (pixels, or the target's unit), ``rms_sigma``, ``points`` (source
    points), ``residuals`` of these, ``inliers``.
    """
    in_space = len(pose.R) == 3
    size = 0 if pose.covariance is None else len(pose.covariance)
    return {
        "R": pose.R.tolist(),
        "t": pose.t.tolist(),
        "quaternion": pose.quaternion.tolist() if in_space and not pose.mirrored else None,
        "scale": pose.scale,
        "focal": pose.focal,
        "parameters": list(_parameter_names(pose)[:size]),
        "covariance": None if pose.covariance is None else pose.covariance.tolist(),
        "chi2": finite_or_none(pose.chi2),
        "dof": pose.dof,
        "rms": finite_or_none(pose.rms),
        "rms_sigma": finite_or_none(pose.rms_sigma),
        "points": None if pose.points is None else pose.points.tolist(),
        "residuals": None if pose.residuals is None else pose.residuals.tolist(),
        "inliers": None if pose.inliers is None else pose.inliers.tolist(),
    }


def read_prior(path: Path, labelled: bool) -> Pose | dict[str, Pose]:
    """A predicted pose of a JSON file: an object with ``R``, ``t`` and ``covariance``, or a list of one as written.

    ``labelled``: whether there are several bodies: then an object from labels to such objects.
    """
    expected = "give an object with R, t and covariance"
    content = load_json(path, read_small_text(path), expected)
    if not labelled:
        return _read_pose(path, content[0] if isinstance(content, list) and len(content) == 1 else content)
    if not isinstance(content, dict) or "R" in content:
        raise InputError(
            f"{path}: it holds one pose, but there are several bodies; give an object from labels to poses"
        )
    return {label: _read_pose(path, record) for label, record in content.items()}


def _read_pose(path: Path, record: Any) -> Pose:
    missing = [name for name in ("R", "t", "covariance") if not isinstance(record, dict) or record.get(name) is None]
    if missing:
        raise InputError(f"{path}: {missing[0]} is missing; give an object with R, t and covariance")
    with prefix_errors(path):
        return Pose(record["R"], record["t"], record["covariance"], scale=record.get("scale", 1.0))


def write_poses(path: Path, poses: Sequence[Pose | None], form: PoseFormat) -> None:
    """Write the poses of the motions, one per row; motions without a pose are left out, in JSON null.

    CSV: ``motion``, the rotation as a unit quaternion ``qx,qy,qz,qw`` (in a plane an ``angle`` in radians),
    ``tx,ty,tz``, ``scale``, ``focal``, ``rms``, ``rms_sigma``, ``inliers``, ``points`` (how many), and the upper
    triangle of the covariance, ``cov_rx_rx`` to ``cov_tz_tz``. ROS and OpenXR: JSON lists, see `rootmatch.io.exports`.
    COLMAP's folder is another matter (`rootmatch.report.colmap.write_colmap`).
    """
    known = [(motion, pose) for motion, pose in enumerate(poses) if pose is not None]
    if form == "json":
        records = [None if pose is None else {"motion": k, **pose_record(pose)} for k, pose in enumerate(poses)]
        write_text_atomically(path, json.dumps(records, allow_nan=False, indent=1) + "\n")
        return
    if form in ("ros", "openxr") and any(len(pose.R) == 2 for _, pose in known):
        raise InputError(f"pose_format: {form} is for poses in space, but these are in a plane; give csv or json")
    if form in ("ros", "openxr"):
        record: Callable[[Pose], dict[str, Any]] = ros_record if form == "ros" else openxr_record
        others = [None if pose is None else record(pose) for pose in poses]
        write_text_atomically(path, json.dumps(others, allow_nan=False, indent=1) + "\n")
        return
    in_plane = any(len(pose.R) == 2 for _, pose in known)
    turn, shift = (("angle",), ("tx", "ty")) if in_plane else (("qx", "qy", "qz", "qw"), ("tx", "ty", "tz"))
    names = _parameter_names(known[0][1]) if known else IN_SPACE
    pairs = upper_triangle(len(names))
    header = ["motion", *turn, *shift, "scale", "focal", "rms", "rms_sigma", "inliers", "points"]
    header += covariance_columns(names)
    write_table(path, header, ([motion, *_pose_cells(pose, pairs)] for motion, pose in known))


def upper_triangle(size: int) -> list[tuple[int, int]]:
    """Rows and columns of a covariance as files have it."""
    return [(a, b) for a in range(size) for b in range(a, size)]


def covariance_columns(names: Sequence[str]) -> list[str]:
    """Columns of the covariance of parameters of these names."""
    return [f"cov_{names[a]}_{names[b]}" for a, b in upper_triangle(len(names))]


def _pose_cells(pose: Pose, pairs: Sequence[tuple[int, int]]) -> list[Any]:
    """The cells of one pose after its motion; empty for what is absent."""
    if len(pose.R) == 3:
        turn = pose.quaternion.tolist()
    else:
        turn = [math.atan2(pose.R[1, 0], pose.R[0, 0])]
    counts = ["" if part is None else len(part) for part in (pose.inliers, pose.points)]
    spread = ["" if pose.covariance is None else float(pose.covariance[a, b]) for a, b in pairs]
    numbers = [
        "" if value is None else value
        for value in (pose.focal, finite_or_none(pose.rms), finite_or_none(pose.rms_sigma))
    ]
    return [*turn, *pose.t.tolist(), pose.scale, *numbers, *counts, *spread]


def _parameter_names(pose: Pose) -> tuple[str, ...]:
    """Names of the rows of the covariance."""
    names = IN_SPACE if len(pose.R) == 3 else IN_PLANE
    size = len(names) if pose.covariance is None else len(pose.covariance)
    return names if size == len(names) else (*names, "scale" if pose.focal is None else "focal")


def finite_or_none(value: float | None) -> float | None:
    """A number that JSON can hold, or None."""
    return float(value) if value is not None and np.isfinite(value) else None
