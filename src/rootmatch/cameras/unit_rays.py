"""A camera whose detections are unit rays already, with noise in radians."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.algebra.directions import tangent_bases
from rootmatch.arrays import Bools, Floats
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.stereographic import Stereographic
from rootmatch.errors import InputError


class UnitRays(CameraModel):
    """Detections are directions (m, 3) of the camera frame, of any length but 0; all around is seen."""

    focal = 1.0

    @property
    def dimension(self) -> int:
        """A ray has three coordinates."""
        return 3

    def bearings(self, pixels: ArrayLike) -> Floats:
        """The rays, made unit ones; see `CameraModel.bearings`."""
        rays = np.asarray(pixels, dtype=float)
        size = np.linalg.norm(rays, axis=-1, keepdims=True)
        if not np.all(size > 0.0):
            raise InputError("bearings: a ray of length 0; give directions")
        return np.asarray(rays / size)

    def project(self, points: ArrayLike) -> Floats:
        """Unit rays (…, 3) to points (…, 3)."""
        return self.bearings(points)

    def sees(self, points: ArrayLike) -> Bools:
        """Everything."""
        return np.asarray(np.linalg.norm(np.asarray(points, dtype=float), axis=-1) > 0.0)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives (…, 3, 3) of the unit rays to points."""
        xyz = np.asarray(points, dtype=float)
        size = np.linalg.norm(xyz, axis=-1)[..., None, None]
        rays = xyz / size[..., 0]
        return np.asarray((np.eye(3) - rays[..., :, None] * rays[..., None, :]) / size)

    def axes(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """Unit rays and two axes across each, in radians."""
        rays = self.bearings(pixels)
        return rays, np.stack(tangent_bases(rays), axis=-1)

    def angular_noise(self, pixels: ArrayLike, sigma: ArrayLike, rays: Floats | None = None) -> Floats:
        """Noise is in radians already."""
        return np.broadcast_to(np.asarray(sigma, dtype=float), np.asarray(pixels).shape[:-1]).copy()

    def chart(self, pixels: Floats, sigma: Floats) -> tuple[CameraModel, Floats, Floats]:
        """The stereographic chart of the rays; see `CameraModel.chart`."""
        rays = self.bearings(pixels)
        camera = Stereographic.about(rays)
        plane = camera.project(rays)
        return camera, plane, np.asarray(sigma * (1.0 + 0.25 * (plane * plane).sum(axis=-1)))
