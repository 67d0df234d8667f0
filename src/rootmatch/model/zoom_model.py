"""The image of a body in an upright camera of unknown focal length: the model of an image with one more parameter.

The vertical is exact, so only the turn about it is unknown of a rotation, and its tilt is idle. Here the tilt about the
camera's x axis holds the logarithm φ of the focal length over `usual_focal`: a pose (R, t) and φ are stored as
Cᵀ Rx(φ) C R, with the rotation C of the camera onto a frame whose y is the vertical. A pose then has six parameters as
any other, whose covariances, steps, changes and comparisons are those of `rootmatch.model.evidence`: a turn about the
tilted vertical, which is that about the vertical itself, φ, a third rotation that moves nothing, and the position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rootmatch.algebra.rotation import cross, cross_matrix, rotation_about_y
from rootmatch.arrays import Floats
from rootmatch.cameras.pinhole import Camera
from rootmatch.model.compiled.evidence import LOG_2PI
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.linearised import Linearised
from rootmatch.model.pose_density import TURNS, Broad, PoseDensity, Terms
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_checks import nearest_covariance
from rootmatch.problems.pose_fit.prior_residuals import Upright
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.problems.up2pf.focal_lengths import MAX_LOG, ZOOM, usual_focal


@dataclass(frozen=True, eq=False)
class ZoomDensity(PoseDensity):
    """Any turn about the vertical, any place as of `Broad`, and a logarithm of the focal length that is normal."""

    upright: Upright
    broad: Broad

    def components(self, rotation: Floats, position: Floats) -> Terms:
        """See `PoseDensity.components`; rotations hold focal lengths."""
        log_zoom, _ = decode_zoom(self.upright, rotation)
        across, along = self.upright.camera[0], rotation @ self.upright.world[1]
        idle = cross(np.broadcast_to(across, along.shape), along)
        precision, slope = np.zeros((len(rotation), 6, 6)), np.zeros((len(rotation), 6))
        precision[:, :3, :3] = (
            across[:, None] * across / ZOOM**2
            + along[:, :, None] * along[:, None] * (2.0 * math.pi / TURNS**2)
            + idle[:, :, None] * idle[:, None]
        )
        slope[:, :3] = -log_zoom[:, None] / ZOOM**2 * across
        precision[:, 3:, 3:], log_position = self.broad.position_terms(position)
        # the idle rotation has a normal distribution of its own, which integrates to 1
        peak = -math.log(TURNS) - math.log(ZOOM) - LOG_2PI
        terms = Terms(precision, slope, (log_zoom / ZOOM) ** 2, log_position + peak)
        return Terms(*(one[:, None] for one in terms))


def encode_zoom(upright: Upright, rotation: Floats, log_zoom: Floats) -> Floats:
    """Rotations (…, 3, 3) that hold logarithms (…) of focal lengths over the usual one, of upright ones."""
    c, s = np.cos(log_zoom), np.sin(log_zoom)
    tilt = np.zeros((*c.shape, 3, 3))
    tilt[..., 0, 0], tilt[..., 1, 1], tilt[..., 2, 2] = 1.0, c, c
    tilt[..., 1, 2], tilt[..., 2, 1] = -s, s
    return np.asarray(upright.camera.T @ tilt @ upright.camera @ rotation)


def decode_zoom(upright: Upright, rotation: Floats) -> tuple[Floats, Floats]:
    """The logarithms (K,) of focal lengths that rotations (K, 3, 3) hold, and the nearest upright rotations."""
    turned = upright.camera @ rotation @ upright.world.T
    log_zoom = np.arctan2(turned[:, 2, 1], turned[:, 1, 1])
    c, s = np.cos(log_zoom)[:, None], np.sin(log_zoom)[:, None]
    last = c * turned[:, 2] - s * turned[:, 1]  # the third row without the tilt
    cosine, sine = turned[:, 0, 0] + last[:, 2], turned[:, 0, 2] - last[:, 0]
    size = np.maximum(np.hypot(cosine, sine), 1e-300)
    level = rotation_about_y(cosine / size, sine / size)
    return np.clip(log_zoom, -MAX_LOG, MAX_LOG), upright.camera.T @ level @ upright.world


@dataclass(frozen=True, eq=False)
class ZoomModel(DetectionModel):
    """A body and its image in an upright camera; see `DetectionModel`, whose rotations here hold focal lengths.

    Parameters
    ----------
    upright : Upright
        The vertical, exact.
    """

    camera: Camera
    upright: Upright = field(kw_only=True)

    @classmethod
    def of(cls, centre: Floats, upright: Upright, points: Floats, target: Floats, **told: object) -> ZoomModel:
        """The model of points (n, 3) and pixels (n', 2) by the principal point and the vertical."""
        focal = usual_focal(centre, target)
        camera, prior = Camera(focal, focal, *centre.tolist()), ZoomDensity(upright, Broad(body_radius(points)))
        return cls(camera, points, target, upright=upright, prior=prior, **told)  # type: ignore[arg-type]

    @cached_property
    def scene_for_kernels(self) -> None:
        """NumPy projects the points."""
        return None

    def encode_focal(self, rotation: Floats, log_focal: Floats) -> Floats:
        """Rotations (…, 3, 3) as this model stores them, of upright ones with logarithms (…) of focal lengths."""
        log_zoom = np.clip(log_focal - math.log(self.camera.focal), -MAX_LOG, MAX_LOG)
        return encode_zoom(self.upright, rotation, log_zoom)

    def linearise_about(self, rotation: Floats, position: Floats) -> Linearised:
        """See `DetectionModel.linearised`; rotations are brought back to those that hold a focal length."""
        log_zoom, level = decode_zoom(self.upright, np.asarray(rotation))
        own = encode_zoom(self.upright, level, log_zoom)
        focal = self.camera.focal * np.exp(log_zoom)
        turned = self.centred_body[0] @ level.swapaxes(-1, -2)
        places = turned + position[:, None]
        depth = places[..., 2]
        with np.errstate(all="ignore"):
            image = focal[:, None, None] * places[..., :2] / depth[..., None]
            by_position = np.zeros((*depth.shape, 2, 3))
            by_position[..., 0, 0] = by_position[..., 1, 1] = focal[:, None] / depth
            by_position[..., 2] = -image / depth[..., None]
        seen = (depth > 0.0) & np.isfinite(image).all(axis=-1) & np.isfinite(by_position).all(axis=(-1, -2))
        image, by_position = np.where(seen[..., None], image, 0.0), np.where(seen[..., None, None], by_position, 0.0)
        vertical, across, along = self.upright.camera[1], self.upright.camera[0], own @ self.upright.world[1]
        moved = cross(np.broadcast_to(vertical, turned.shape), turned)
        by_turn = (by_position @ moved[..., None])[..., 0]
        jacobian = np.empty((*image.shape, 6))
        jacobian[..., :3] = by_turn[..., None] * along[:, None, None] + image[..., None] * across
        jacobian[..., 3:] = by_position
        return Linearised(
            pixels=image + np.array(self.camera.numbers[2:]),
            jacobian=jacobian,
            by_position=by_position,
            seen=seen,
            cosine=None,
            expected=seen.astype(float),
            rotation=own,
            position=np.array(position, float),
        )

    def pose_of_origin(self, rotation: Floats, position: Floats, covariance: Floats) -> Pose:
        """See `DetectionModel.pose_of_origin`: with the focal length, which has the last row of the covariance."""
        log_zoom, level = decode_zoom(self.upright, rotation[None])
        R, focal = level[0], self.camera.focal * math.exp(float(log_zoom[0]))
        change = np.zeros((7, 6))
        change[:3, :3] = np.outer(self.upright.camera[1], rotation @ self.upright.world[1])
        change[3:6, :3] = cross_matrix(R @ self.centre) @ change[:3, :3]  # the origin is t − R c
        change[3:6, 3:] = np.eye(3)
        change[6, :3] = focal * self.upright.camera[0]
        return Pose(R, position - R @ self.centre, nearest_covariance(change @ covariance @ change.T), focal=focal)
