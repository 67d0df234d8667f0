"""The pose of a match, and how it is estimated: by PoseLib from images, in closed form between two point sets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import RootmatchError

Floats = NDArray[np.float64]

LEAST_ABSOLUTE, LEAST_RELATIVE = 4, 5
"""Matches that PoseLib needs: one more than P3P, to tell its solutions apart, and those of the five-point problem."""
KEEP_ALL = {"max_reproj_error": 1e4, "max_epipolar_error": 1e4, "seed": 0}
"""Thresholds in pixels so wide that every match counts: refinement is wanted, not another selection of inliers."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion, or a similarity: x' = scale · R x + t. Unpacks as ``R, t = pose``.

    What x and x' are depends on the problem. Points in space and their image: x in the frame of the points, x' in the
    camera frame (x right, y down, z forward), lengths in the unit of the points. Two images: x in the first camera's
    frame, x' in the second's, t of length 1. Two point sets: x a source point, x' a target point.

    Attributes
    ----------
    R : (k, k) float64
        Rotation, k = 3, or 2 for point sets of a plane. With ``Similarity(mirror=True)`` its determinant may be −1.
    t : (k,) float64
        Translation.
    scale : float
        1 but for `rootmatch.Similarity`.
    """

    R: Floats
    t: Floats
    scale: float = field(default=1.0, kw_only=True)

    def __iter__(self) -> Iterator[Floats]:
        """Rotation and translation."""
        return iter((self.R, self.t))


def absolute_pose(camera: Camera, source: Floats, target: Floats) -> Pose:
    """Camera pose from points in space (m, 3) and their pixels (m, 2), m ≥ `LEAST_ABSOLUTE`."""
    found, _ = _poselib().estimate_absolute_pose(target, source, _described(camera), KEEP_ALL)
    return _rigid(found)


def relative_pose(cameras: tuple[Camera, Camera], source: Floats, target: Floats) -> Pose:
    """Pose of the second camera in the first one's frame from pixels (m, 2) and (m, 2), m ≥ `LEAST_RELATIVE`."""
    first, second = cameras
    found, _ = _poselib().estimate_relative_pose(source, target, _described(first), _described(second), KEEP_ALL)
    return _rigid(found)


def point_set_pose(source: Floats, target: Floats, *, scaled: bool, mirror: bool = False) -> Pose:
    """Least-squares motion between matched points (m, k) and (m, k), m ≥ k (Umeyama 1991).

    Minimises Σ |scale · R source + t − target|².

    Parameters
    ----------
    source, target : (m, k) arrays
    scaled : bool
        Whether the scale is estimated; 1 otherwise.
    mirror : bool
        Whether a reflection is possible.
    """
    centre, centre2 = source.mean(axis=0), target.mean(axis=0)
    first, second = source - centre, target - centre2
    u, values, vt = np.linalg.svd(second.T @ first)
    signs = np.ones(source.shape[1])
    if not mirror and np.linalg.det(u) * np.linalg.det(vt) < 0.0:
        signs[-1] = -1.0
    rotation = (u * signs) @ vt
    scale = float((values * signs).sum() / (first**2).sum()) if scaled else 1.0
    return Pose(rotation, centre2 - scale * rotation @ centre, scale=scale)


def _poselib() -> Any:
    try:
        import poselib
    except ImportError:
        raise RootmatchError("pose: PoseLib is missing; install the extra: pip install 'rootmatch[pose]'") from None
    return poselib


def _rigid(found: Any) -> Pose:
    return Pose(np.asarray(found.R, dtype=float), np.asarray(found.t, dtype=float))


def _described(camera: Camera) -> dict[str, object]:
    width, height = int(2 * camera.cx) + 1, int(2 * camera.cy) + 1
    parameters = [camera.fx, camera.fy, camera.cx, camera.cy]
    return {"model": "PINHOLE", "width": width, "height": height, "params": parameters}
