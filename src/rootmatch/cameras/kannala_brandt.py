"""The fisheye lens of Kannala and Brandt (2006), as OpenCV's `fisheye` module and COLMAP's OPENCV_FISHEYE have it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.cameras.lens import Lens, coefficients, first_positive_root, increasing_root


@dataclass(frozen=True)
class KannalaBrandt(Lens):
    """The image of a direction at an angle θ to the optical axis lies at θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸).

    Parameters
    ----------
    values : sequence of 4 floats
        k1 to k4.

    Notes
    -----
    The angle goes beyond 90°, as far as the polynomial increases: directions beside and behind the camera are seen.
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", coefficients(self.values, (4,), "fisheye distortion"))

    @cached_property
    def angle(self) -> float:
        """Largest angle to the optical axis, at most π."""
        k1, k2, k3, k4 = self.values
        return float(min(np.sqrt(first_positive_root([9.0 * k4, 7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])), np.pi))

    @cached_property
    def radius(self) -> float:
        """See `Lens.radius`."""
        return float(self._radial(np.array([self.angle]))[0][0])

    def image(self, points: Floats) -> Floats:
        """See `Lens.image`."""
        across = np.hypot(points[..., 0], points[..., 1])
        return np.asarray(points[..., :2] * self._scale(across, points[..., 2])[0][..., None])

    def jacobian(self, points: Floats) -> Floats:
        """See `Lens.jacobian`."""
        z = points[..., 2]
        across = np.hypot(points[..., 0], points[..., 1])
        scale, slope = self._scale(across, z)
        unit = points[..., :2] / np.where(across > 0.0, across, 1.0)[..., None]
        squared = across * across + z * z
        along = np.concatenate([z[..., None] * unit, -across[..., None]], axis=-1) * (slope / squared)[..., None]
        out = unit[..., :, None] * along[..., None, :]
        out[..., :2] += scale[..., None, None] * (np.eye(2) - unit[..., :, None] * unit[..., None, :])
        return np.asarray(out)

    def sees(self, points: Floats) -> Bools:
        """See `Lens.sees`."""
        return np.asarray(np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2]) < self.angle)

    def rays(self, image: Floats) -> Floats:
        """See `Lens.rays`."""
        distance = np.linalg.norm(image, axis=-1)
        flat = distance.reshape(-1)
        angle = increasing_root(self._radial, flat, self.angle, flat).reshape(distance.shape)
        angle = np.where(distance < self.radius, angle, np.nan)
        unit = image / np.where(distance > 0.0, distance, 1.0)[..., None]
        return np.concatenate([np.sin(angle)[..., None] * unit, np.cos(angle)[..., None]], axis=-1)

    def _radial(self, angle: Floats) -> tuple[Floats, Floats]:
        """Distance from the principal point of directions at some angles (m,) to the axis, and its derivative."""
        k1, k2, k3, k4 = self.values
        s = angle * angle
        value = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        return value, 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))

    def _scale(self, across: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Image over distance from the axis, and the derivative of the image's radius by the angle."""
        value, slope = self._radial(np.arctan2(across, z))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(across > 1e-150, value / across, 1.0 / z)
        return scale, slope
