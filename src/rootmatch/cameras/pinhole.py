"""The pinhole camera: bearings of pixels and their noise, and projection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError


@dataclass(frozen=True)
class Camera:
    """A calibrated pinhole camera without distortion.

    The camera frame is x right, y down, z forward; a point ``(X, Y, Z)`` of that frame projects to the pixel
    ``(fx X / Z + cx, fy Y / Z + cy)``.

    Parameters
    ----------
    fx, fy : float
        Focal lengths in pixels, positive.
    cx, cy : float
        Principal point in pixels.

    Raises
    ------
    InputError
        If a number is not finite or a focal length is not positive.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            try:
                value = float(getattr(self, name))
            except (TypeError, ValueError):
                raise InputError(f"camera: {name} is {getattr(self, name)!r}; give a number of pixels") from None
            if not np.isfinite(value):
                raise InputError(f"camera: {name} is {value}; give a finite number of pixels")
            object.__setattr__(self, name, value)
        for name in ("fx", "fy"):
            if getattr(self, name) <= 0.0:
                raise InputError(
                    f"camera: focal length {name} is {getattr(self, name):g}; give a positive number of pixels"
                )

    @classmethod
    def from_matrix(cls, K: ArrayLike) -> Camera:
        """Make a camera of the 3×3 intrinsic matrix ``K`` (no skew, last row 0 0 1).

        Raises
        ------
        InputError
            If the matrix is not 3×3 or is not of the form ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``.
        """
        matrix = np.asarray(K, dtype=float)
        if matrix.shape != (3, 3):
            raise InputError(f"camera matrix: shape {matrix.shape} given, (3, 3) expected")
        if not np.all(np.isfinite(matrix)) or matrix[2, 2] == 0.0:
            raise InputError("camera matrix: NaN, infinity or a last entry of 0; give [fx 0 cx; 0 fy cy; 0 0 1]")
        matrix = matrix / matrix[2, 2]
        other = abs(matrix[0, 1]) + abs(matrix[1, 0]) + abs(matrix[2, 0]) + abs(matrix[2, 1])
        if other > 1e-9 * abs(matrix[0, 0]):
            raise InputError("camera matrix: skew, or a last row other than 0 0 1; undistort to a camera without skew")
        return cls(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The (3, 3) intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def bearings(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Unit rays (…, 3) in the camera frame of pixels (…, 2)."""
        points = np.asarray(pixels, dtype=float)
        rays = np.empty((*points.shape[:-1], 3))
        rays[..., 0] = (points[..., 0] - self.cx) / self.fx
        rays[..., 1] = (points[..., 1] - self.cy) / self.fy
        rays[..., 2] = 1.0
        unit: NDArray[np.float64] = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit

    def angular_noise(self, pixels: ArrayLike, sigma: ArrayLike) -> NDArray[np.float64]:
        """Standard deviation in radians, on each of two axes across the ray, of pixels (m, 2) known to ``sigma`` px.

        An off-centre pixel subtends a smaller angle along the radius than across it; returned is the isotropic angle of
        the same area, so that noise propagation needs nothing but products of bearings.
        """
        points = np.asarray(pixels, dtype=float)
        u = (points[..., 0] - self.cx) / self.fx
        v = (points[..., 1] - self.cy) / self.fy
        cosine = 1.0 / np.sqrt(1.0 + u * u + v * v)
        # du dv = dΩ / cos³, hence the area of a pixel in steradians is cos³ / (fx fy)
        angle: NDArray[np.float64] = np.asarray(sigma, dtype=float) * np.sqrt(cosine**3 / (self.fx * self.fy))
        return angle

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Pixels (…, 2) of points (…, 3) in the camera frame; does not check that they are in front of the camera."""
        xyz = np.asarray(points, dtype=float)
        return np.stack(
            [self.fx * xyz[..., 0] / xyz[..., 2] + self.cx, self.fy * xyz[..., 1] / xyz[..., 2] + self.cy], axis=-1
        )


def check_camera(camera: object, name: str = "camera") -> None:
    """Refuse anything but a camera, such as its matrix."""
    if not isinstance(camera, Camera):
        raise InputError(
            f"{name}: {type(camera).__name__} given; give a Camera, Camera(fx, fy, cx, cy) or Camera.from_matrix(K)"
        )
