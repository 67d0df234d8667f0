"""The images of a rig as one plane, in which every camera has a sighting of every point.

A sighting is a point as one camera sees it: it has one place in the plane, as a point has in one image. All sightings
share the pose of the body in the rig, so what is written for one camera serves for a rig.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.rig import Rig
from rootmatch.errors import InputError


@dataclass(frozen=True, eq=False)
class RigImage(CameraModel):
    """A rig as one camera of the sightings (C n) of n points, those of the first camera first."""

    rig: Rig
    count: int
    """Number of points, n."""
    offsets: Floats
    """(C, 2) where each camera's image lies in the common plane."""
    camera_of: Integers
    """(n',) camera of each detection."""
    unit: float = 1.0
    """Length of a unit of the points, in that of the rig."""
    dimension = 2

    @property
    def focal(self) -> float:
        """Mean focal length."""
        return self.rig.focal

    def bearings(self, pixels: ArrayLike) -> Floats:
        """Unknown without the camera."""
        raise InputError("rig: give the camera of each pixel")

    def to_camera_frame(self, positions: Floats, k: int) -> Floats:
        """Sightings (…, C n, 3) of the rig's frame that belong to camera k, in its frame, (…, n, 3)."""
        own = positions[..., k * self.count : (k + 1) * self.count, :]
        return np.asarray(own @ self.rig.rotations[k].T + self.rig.translations[k] / self.unit)

    def project(self, points: ArrayLike) -> Floats:
        """Pixels (…, C n, 2) of sightings (…, C n, 3)."""
        return np.concatenate([camera.project(own) + self.offsets[k] for k, camera, own in self._own(points)], axis=-2)

    def sees(self, points: ArrayLike) -> Bools:
        """Whether each sighting (…, C n, 3) is seen by its camera."""
        return np.concatenate([camera.sees(own) for _, camera, own in self._own(points)], axis=-1)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives (…, C n, 2, 3) of their pixels by the sightings (…, C n, 3)."""
        parts = [camera.jacobian(own) @ self.rig.rotations[k] for k, camera, own in self._own(points)]
        return np.concatenate(parts, axis=-3)

    def _own(self, points: ArrayLike) -> Iterator[tuple[int, CameraModel, Floats]]:
        """The number of each camera, the camera, and those of the sightings (…, C n, 3) that are its own."""
        positions = np.asarray(points, dtype=float)
        for k, camera in enumerate(self.rig.cameras):
            yield k, camera, self.to_camera_frame(positions, k)

    def from_centre(self, points: Floats) -> Floats:
        """Sightings (…, C n, 3), each as from the centre of its own camera."""
        return points - np.repeat(self.rig.centres / self.unit, self.count, axis=0)

    def in_image(self, pixels: Floats) -> Floats:
        """How far the pixels (…, C n, 2) of sightings are expected in the images of their cameras."""
        parts = np.split(pixels, len(self.offsets), axis=-2)
        return np.concatenate([self.rig.expects(k, own - self.offsets[k]) for k, own in enumerate(parts)], axis=-1)

    def image_areas(self, target: Floats) -> Floats | None:
        """See `CameraModel.image_areas`: by the cameras' sizes where those are given."""
        if self.rig.sizes is not None:
            return np.asarray(np.prod(self.rig.sizes, axis=1), np.float64)
        every = [
            camera.image_areas(target[own] - offset)
            for camera, own, offset in zip(self.rig.cameras, self.images(), self.offsets, strict=True)
        ]
        known = [one for one in every if one is not None]
        return np.concatenate(known) if len(known) == len(every) else None

    def images(self) -> list[Integers]:
        """The detections of each camera."""
        return [(self.camera_of == k).nonzero()[0] for k in range(len(self.offsets))]
