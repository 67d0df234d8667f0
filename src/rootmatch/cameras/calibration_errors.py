"""Errors of a calibration, which all detections of a camera share, as the cameras state them.

They are the focal length, the principal point and, in a rig, the rotation and the centre of each camera: m independent
numbers that do not change from one image to the next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.arrays import Floats
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.rig_image import RigImage

NEAR = 0.5
"""Size of a body over its distance, at most: one that is all around a camera counts as smaller. A round value."""


def calibration_jacobian(camera: CameraModel, points: Floats) -> Floats:
    """Derivatives (…, n, 2, m) of the pixels of points (…, n, 3) by the errors, in units of their standard deviations.

    ``camera``: one, with points of its frame; or the images of a rig, with sightings of the rig's frame. Where a camera
    does not see a point they mean nothing.
    """
    if not isinstance(camera, RigImage):
        return _camera_jacobian(camera, points)
    each = [
        _camera_jacobian(own, camera.to_camera_frame(points, k), turned, moved)
        for k, (own, turned, moved) in enumerate(
            zip(camera.rig.cameras, camera.rig.rotation_noise, camera.rig.position_noise, strict=True)
        )
    ]
    whole, row, column = np.zeros((*points.shape[:-1], 2, sum(one.shape[-1] for one in each))), 0, 0
    for one in each:
        whole[..., row : row + camera.count, :, column : column + one.shape[-1]] = one
        row, column = row + camera.count, column + one.shape[-1]
    return whole


def _camera_jacobian(camera: CameraModel, points: Floats, turned: float = 0.0, moved: float = 0.0) -> Floats:
    """See `calibration_jacobian`; ``turned``, ``moved``: standard deviations of a camera's pose in its rig.

    A camera turns about its centre, and errors are those of its frame: x = Exp(ω) (R x_rig + t) + τ.
    """
    shape = points.shape[:-1]
    parts = [np.zeros((*shape, 2, 0))]
    with np.errstate(all="ignore"):
        if isinstance(camera, Camera):
            if camera.focal_noise:
                from_centre = camera.project(points) - (camera.cx, camera.cy)
                parts.append(camera.focal_noise / camera.focal * from_centre[..., None])
            if camera.centre_noise:
                parts.append(np.broadcast_to(camera.centre_noise * np.eye(2), (*shape, 2, 2)))
        if turned or moved:
            by_point = camera.jacobian(points)
            parts += [-turned * by_point @ cross_matrix(points)] * (turned > 0.0) + [moved * by_point] * (moved > 0.0)
    return np.concatenate(parts, axis=-1)


def calibration_noise(
    camera: CameraModel, target: Floats, size: float, distances: Sequence[float], axes: Floats
) -> Floats:
    """Standard deviation (n',) of a coordinate of detections (n', 2 or 3) by what a pose leaves of the errors, px.

    A principal point that is off turns the body, and what a single camera has is taken up altogether. Cameras that see
    the same body contradict each other. So for each camera, a body amidst its detections is moved to where it fits
    best, in the images of all cameras that see all of it.

    Parameters
    ----------
    camera : CameraModel
    target : (n', 2 or 3) array
    size : float
        Of the body.
    distances : sequence of float
        At which it may be from each camera; the one that leaves most counts.
    axes : (a, 3) array
        About which it may turn, in the frame of the camera or of the rig.
    """
    known = camera if isinstance(camera, Rig) else Rig([(camera, np.eye(3), np.zeros(3))])
    rows = target if isinstance(camera, Rig) else np.column_stack([target, np.zeros(len(target))])
    ahead, looking, out = list[Floats](), list[int](), np.zeros(len(target))
    for k, own in enumerate(known.cameras):
        rays = own.seen_bearings(np.ascontiguousarray(rows[rows[:, 2] == k, :2]))
        rays = rays[np.isfinite(rays).all(axis=1)]
        if len(rays):
            ahead.append(rays.mean(axis=0) @ known.rotations[k])
            looking.append(k)
    if not looking:
        return out
    # corners of a cube: from points on three axes, a change of distance would leave nothing of a focal length's error
    arms = np.array(list(product((-1.0, 1.0), repeat=3))) / math.sqrt(3.0)
    about = np.tile(arms, (len(known.views), 1))
    image = RigImage(known, len(arms), np.zeros((len(known.views), 2)), np.zeros(0, np.int64))
    away = np.reshape(distances, (-1, 1, 1))
    places = known.centres[looking] + away * ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    sizes = np.minimum(size, NEAR * away)[..., None]
    points = sizes * about + places[:, :, None]  # (distances, looking cameras, sightings, 3)
    with np.errstate(all="ignore"):
        shown = image.sees(points) & (image.in_image(image.project(points)) >= 0.5)
        by_point, errors = sizes[..., None] * image.jacobian(points), calibration_jacobian(image, points)
        by_pose = np.concatenate([-by_point @ (cross_matrix(about) @ axes.T), by_point], axis=-1)
    seen = np.asarray(shown.reshape(*points.shape[:2], -1, len(arms)).all(axis=-1))
    seen[:, np.arange(len(looking)), looking] = True
    used = np.repeat(seen, 2 * len(arms), axis=-1)[..., None]
    by_pose, errors = (np.where(used, one.reshape(*used.shape[:3], -1), 0.0) for one in (by_pose, errors))
    turned = by_pose.swapaxes(-1, -2)
    left = errors - by_pose @ (np.linalg.pinv(turned @ by_pose, hermitian=True) @ (turned @ errors))
    each = (left**2).sum(axis=-1).reshape(*seen.shape, -1).mean(axis=-1)
    for number, k in enumerate(looking):
        out[rows[:, 2] == k] = np.sqrt(each[:, number, k].max())
    return out
