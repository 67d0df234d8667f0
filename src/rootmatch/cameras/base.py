"""What the problems need of a camera, whatever its model: bearings of detections, their noise, and projection."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.algebra.rotation import cross
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.errors import InputError, UnseenPixelError, quote_value

RIM = 0.05
"""Part of an image's width on both sides of its rim where a predicted point is less and less expected in it: the pose
is not exact. A round value."""


class CameraModel(ABC):
    """A calibrated camera: a map between detections and directions of its frame (x right, y down, z forward)."""

    size: tuple[float, float] | None = None
    """Width and height of the image in pixels, if they are known."""

    @property
    @abstractmethod
    def dimension(self) -> int:
        """Numbers in a row of the detections: 2 of a pixel, 3 of a unit ray."""

    @property
    @abstractmethod
    def focal(self) -> float:
        """Units of a detection's noise per radian, on the optical axis: pixels, or 1 where noise is in radians."""

    @property
    def is_uncertain(self) -> bool:
        """Whether it states that its calibration is not exact."""
        return False

    @abstractmethod
    def bearings(self, pixels: ArrayLike) -> Floats:
        """Unit rays (…, 3) in the camera frame of detections (…, 2).

        Raises `InputError` for a detection that no direction projects to.
        """

    @abstractmethod
    def project(self, points: ArrayLike) -> Floats:
        """Detections (…, 2) of points (…, 3) in the camera frame; see `sees` for those that have none."""

    @abstractmethod
    def sees(self, points: ArrayLike) -> Bools:
        """Whether the model holds at points (…, 3) of the camera frame: in front of the lens and within its field."""

    def shows(self, pixels: ArrayLike) -> Bools:
        """Whether each of the detections (…, 2) is the image of some direction, so that `bearings` accepts it."""
        return np.ones(np.shape(pixels)[:-1], np.bool_)

    def seen_bearings(self, pixels: Floats) -> Floats:
        """As `bearings` of detections (m, 2), but NaN for those that no direction projects to."""
        try:
            return self.bearings(pixels)
        except UnseenPixelError:
            shown, rays = self.shows(pixels), np.full((len(pixels), 3), np.nan)
            rays[shown] = self.bearings(pixels[shown])
            return rays

    @abstractmethod
    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives (…, 2, 3) of the detections of points (…, 3) in the camera frame by these points."""

    def axes(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """Rays (…, 3) of detections, of any length, and how such a ray moves with the detection, (…, 3, 2)."""
        rays = self.bearings(pixels)
        return rays, _tangent_axes(rays, self.jacobian(rays))

    def angular_noise(self, pixels: ArrayLike, sigma: ArrayLike, rays: Floats | None = None) -> Floats:
        """Standard deviation in radians, on each of two axes across the ray, of pixels (m, 2) known to ``sigma`` px.

        A pixel off the centre subtends different angles along the radius and across it; returned is the isotropic angle
        of the same area, so that noise propagation needs nothing but products of bearings. ``rays`` (m, 3): the
        `bearings` of the pixels, if these are known.
        """
        area = self.steradians(self.bearings(pixels) if rays is None else rays)
        angle: Floats = np.asarray(sigma, dtype=float) * np.sqrt(area)
        return angle

    def steradians(self, points: ArrayLike) -> Floats:
        """Solid angle (…,) of one pixel in the directions of points (…, 3) of the camera frame."""
        xyz = np.asarray(points, dtype=float)
        jacobian = self.jacobian(xyz / np.linalg.norm(xyz, axis=-1, keepdims=True))
        first, second = jacobian[..., 0, :], jacobian[..., 1, :]
        # across the ray alone, as a point that moves along its ray stays on its pixel
        area: Floats = 1.0 / np.maximum(np.linalg.norm(cross(first, second), axis=-1), 1e-300)
        return area

    def chart(self, pixels: Floats, sigma: Floats) -> tuple[CameraModel, Floats, Floats]:
        """A camera whose detections are points of a plane: itself, or one in which unit rays are such points.

        Returns
        -------
        camera : CameraModel
        pixels : (m, 2) array
            The detections in its image.
        sigma : (m,) array
            Their standard deviations there.
        """
        return self, pixels, sigma

    def from_centre(self, points: Floats) -> Floats:
        """Points (…, n, 3) of the camera frame as seen from its centre: themselves, but for the cameras of a rig."""
        return points

    def in_image(self, pixels: Floats) -> Floats:
        """How far the images (…, n, 2) of n points are expected in the image, from 0 to 1; 1 if its size is unknown."""
        return np.ones(pixels.shape[:-1]) if self.size is None else image_membership(pixels, self.size)

    def image_areas(self, target: Floats) -> Floats | None:
        """Area (C,) in px² of the image, or of each of several, in which detections (n', 2) lie, if it is known."""
        return None

    def images(self) -> list[Integers]:
        """Which detections lie in which of several images that share a plane; none where there is but one image."""
        return []


def image_membership(pixels: Floats, size: tuple[float, float]) -> Floats:
    """How far pixels (…, 2) are expected in an image of a size: 1 well within, 0 well outside, ½ on the rim."""
    within = np.minimum(pixels, np.array(size) - pixels).min(axis=-1)
    return np.asarray(np.clip(0.5 + 0.5 * within / (RIM * size[0]), 0.0, 1.0))


def _tangent_axes(rays: Floats, jacobian: Floats) -> Floats:
    """Derivatives (…, 3, 2) of unit rays (…, 3) by their pixels, from the derivatives (…, 2, 3) of pixels by rays."""
    gram = jacobian @ jacobian.swapaxes(-1, -2)
    a, b, d = gram[..., 0, 0], gram[..., 0, 1], gram[..., 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    inverse: Floats = jacobian.swapaxes(-1, -2) @ adjugate / (a * d - b * b)[..., None, None]
    return inverse


def check_camera(camera: object, name: str = "camera", rigs: bool = False) -> None:
    """Refuse anything but a camera, such as its matrix; ``rigs``: whether one of several cameras will do."""
    if not isinstance(camera, CameraModel):
        raise InputError(
            f"{name}: {type(camera).__name__} given; give a Camera, Camera(fx, fy, cx, cy) or Camera.from_matrix(K)"
        )
    if not rigs and hasattr(camera, "views"):
        raise InputError(f"{name}: a Rig given, but only P3P and UP2P take one; give a single camera")
    if getattr(camera, "camera", None) is not None:
        raise InputError(f"{name}: Bearings(camera) given, which describes measurements; give the camera itself")


def check_deviation(value: Any, name: str, unit: str) -> float:
    """A standard deviation of a calibration; of 0, what it belongs to is exact."""
    try:
        sigma = float(value)
    except (TypeError, ValueError, OverflowError):
        sigma = math.nan
    if not 0.0 <= sigma < math.inf:
        raise InputError(f"{name} is {quote_value(value)}; give a standard deviation in {unit}, 0 if it is exact")
    return sigma
