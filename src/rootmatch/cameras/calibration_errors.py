"""Errors of a calibration, which all detections of a camera share, as the cameras state them.

They are the focal length, the principal point and, in a rig, the rotation and the centre of each camera: m independent
numbers that do not change from one image to the next.
"""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.arrays import Floats
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.rig_image import RigImage


def is_uncertain(camera: CameraModel | None) -> bool:
    """Whether a camera, or a rig, states that its calibration is not exact."""
    if isinstance(camera, Rig):
        return any((*camera.rotation_noise, *camera.position_noise)) or any(map(is_uncertain, camera.cameras))
    return isinstance(camera, Camera) and camera.focal_noise + camera.centre_noise > 0.0


def calibration_jacobian(camera: CameraModel, points: Floats) -> Floats:
    """Derivatives (n, 2, m) of the pixels of points (n, 3) by the errors, in units of their standard deviations.

    ``camera``: one, with points of its frame; or the images of a rig, with sightings of the rig's frame. Where a camera
    does not see a point they mean nothing.
    """
    if not isinstance(camera, RigImage):
        return _of_one(camera, points)
    each, rows = [], 0
    for k, own in enumerate(camera.rig.cameras):
        deviations = camera.rig.rotation_noise[k], camera.rig.position_noise[k]
        each.append(_of_one(own, camera.to_camera_frame(points, k), *deviations))
    whole = np.zeros((len(points), 2, sum(one.shape[2] for one in each)))
    columns = 0
    for one in each:
        whole[rows : rows + len(one), :, columns : columns + one.shape[2]] = one
        rows, columns = rows + len(one), columns + one.shape[2]
    return whole


def _of_one(camera: CameraModel, points: Floats, turned: float = 0.0, moved: float = 0.0) -> Floats:
    """See `calibration_jacobian`; ``turned``, ``moved``: standard deviations of a camera's pose in its rig.

    A camera turns about its centre, and errors are those of its frame: x = Exp(ω) (R x_rig + t) + τ.
    """
    parts = [np.zeros((len(points), 2, 0))]
    with np.errstate(all="ignore"):
        if isinstance(camera, Camera):
            if camera.focal_noise:
                from_centre = camera.project(points) - (camera.cx, camera.cy)
                parts.append(camera.focal_noise / camera.focal * from_centre[..., None])
            if camera.centre_noise:
                parts.append(np.tile(camera.centre_noise * np.eye(2), (len(points), 1, 1)))
        if turned or moved:
            by_point = camera.jacobian(points)
            parts += [-turned * by_point @ cross_matrix(points)] * (turned > 0.0) + [moved * by_point] * (moved > 0.0)
    return np.concatenate(parts, axis=2)


def calibration_noise(camera: CameraModel, target: Floats, distance: float) -> Floats:
    """Standard deviation (n',) of a coordinate of each detection (n', 2 or 3) by the errors, px.

    ``distance``: at which a camera that is moved sees what it detects, in the unit of the points.
    """
    views = [(camera, 0.0, 0.0, np.ones(len(target), np.bool_))]
    if isinstance(camera, Rig):
        each = zip(camera.cameras, camera.rotation_noise, camera.position_noise, strict=True)
        views = [(*one, target[:, 2] == k) for k, one in enumerate(each)]
    out = np.zeros(len(target))
    for one, turned, moved, own in views:
        rays = one.seen_bearings(np.ascontiguousarray(target[own, :2]))
        squared = (_of_one(one, distance * rays, turned, moved) ** 2).sum(axis=(1, 2))
        out[own] = np.sqrt(0.5 * np.nan_to_num(squared))
    return out
