"""The camera: focal lengths, principal point, and a lens if it is no ideal pinhole."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats, Integers, as_floats, cache_by_values
from rootmatch.cameras.base import CameraModel, check_deviation
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.lens import Lens
from rootmatch.errors import InputError, InputWarning, UnseenPixelError, quote_value

MIN_FOCAL, MAXIMUM = 1e-6, 1e18
"""Minimum focal length, and maximum of any of the four numbers, in pixels: far beyond any camera's."""

UNEQUAL = 1.25
"""Ratio of the focal lengths beyond which it is asked whether they are meant: pixels are square mostly. A round
value."""


@dataclass(frozen=True)
class Camera(CameraModel):
    """A calibrated camera: a pinhole, or one with a lens that distorts.

    The camera frame is x right, y down, z forward; without a lens a point ``(X, Y, Z)`` of that frame projects to the
    pixel ``(fx X / Z + cx, fy Y / Z + cy)``. The calibration determines where the centre of the upper left pixel lies,
    and the detections must use the same convention: (0, 0) for OpenCV, (0.5, 0.5) for COLMAP.

    Parameters
    ----------
    fx, fy : float
        Focal lengths in pixels, positive.
    cx, cy : float
        Principal point in pixels.
    lens : Lens, optional
        The lens model; see `from_opencv` and `from_opencv_fisheye`.
    size : (width, height), optional
        Size of the image in pixels. A pose then does not expect points outside it. Without a size, every point in front
        of the camera counts as visible, and the principal point is taken as the middle of the image.
    focal_noise, centre_noise : float
        Standard deviations in pixels of the calibration: of the focal length (fx and fy are off together) and of each
        coordinate of the principal point. Poses of `rootmatch.P3P` and `rootmatch.UP2P` allow for them; by default the
        camera is exact. To add them to an existing camera: ``dataclasses.replace(camera, focal_noise=2.0)``.

    Raises
    ------
    InputError
        If a number is not finite, a focal length or a size is not positive, or a standard deviation is negative.

    Warns
    -----
    InputWarning
        If the focal lengths differ by more than a quarter, as they do if the principal point was given first.
    """

    fx: float = None  # type: ignore[assignment]
    fy: float = None  # type: ignore[assignment] # so that a lone matrix has an error of its own
    cx: float = None  # type: ignore[assignment]
    cy: float = None  # type: ignore[assignment]
    lens: Lens | None = None
    size: tuple[float, float] | None = None
    focal_noise: float = field(default=0.0, kw_only=True)
    centre_noise: float = field(default=0.0, kw_only=True)
    dimension = 2

    def __post_init__(self) -> None:
        if self.cx is None or self.cy is None:
            raise InputError(
                "camera: give fx, fy, cx and cy, or a matrix to Camera.from_matrix(K), with coefficients of its lens "
                "to Camera.from_opencv(K, dist) or Camera.from_opencv_fisheye(K, D)"
            )
        for name in ("fx", "fy", "cx", "cy"):
            try:
                value = float(getattr(self, name))
            except (TypeError, ValueError):
                raise InputError(
                    f"camera: {name} is {quote_value(getattr(self, name))}; give a number of pixels"
                ) from None
            except OverflowError:
                raise InputError(f"camera: {name} has hundreds of digits; give a number of pixels") from None
            if not np.isfinite(value):
                raise InputError(f"camera: {name} is {value}; give a finite number of pixels")
            if abs(value) > MAXIMUM:
                raise InputError(f"camera: {name} is {value:g}, more than any camera has; give a number of pixels")
            object.__setattr__(self, name, value)
        for name in ("fx", "fy"):
            if getattr(self, name) <= 0.0:
                raise InputError(
                    f"camera: focal length {name} is {getattr(self, name):g}; give a positive number of pixels"
                )
            if getattr(self, name) < MIN_FOCAL:
                raise InputError(
                    f"camera: focal length {name} is {getattr(self, name):g} px, far below a pixel; "
                    "give it in pixels, not in metres"
                )
        if not 1.0 / UNEQUAL < self.fx / self.fy < UNEQUAL:
            told = f"camera: fx {self.fx:g} and fy {self.fy:g} differ widely; check the order: fx, fy, cx, cy"
            warnings.warn(told, InputWarning, stacklevel=3)
        for name in ("focal_noise", "centre_noise"):
            object.__setattr__(self, name, check_deviation(getattr(self, name), f"camera: {name}", "pixels"))
        if self.size is not None:
            object.__setattr__(self, "size", _check_size(self.size))
        if self.lens is not None and not isinstance(self.lens, Lens):
            raise InputError(
                f"camera: lens is {quote_value(self.lens)}; use Camera.from_opencv(K, dist) or "
                "Camera.from_opencv_fisheye(K, D)"
            )

    @property
    def is_uncertain(self) -> bool:
        """See `CameraModel.is_uncertain`."""
        return self.focal_noise + self.centre_noise > 0.0

    @classmethod
    def from_matrix(cls, K: ArrayLike, *, size: tuple[float, float] | None = None) -> Camera:
        """Make a camera from the 3×3 intrinsic matrix ``K`` (no skew, last row 0 0 1), and the size of its image.

        Raises
        ------
        InputError
            If the matrix is not 3×3 or is not of the form ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``.
        """
        try:
            matrix = np.asarray(K, dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise InputError("camera matrix: not a matrix of numbers; give [fx 0 cx; 0 fy cy; 0 0 1]") from None
        if matrix.shape != (3, 3):
            raise InputError(f"camera matrix: shape {matrix.shape} given, (3, 3) expected")
        if not np.all(np.isfinite(matrix)) or matrix[2, 2] == 0.0:
            raise InputError("camera matrix: NaN, infinity or 0 as its last entry; give [fx 0 cx; 0 fy cy; 0 0 1]")
        matrix = matrix / matrix[2, 2]
        other = abs(matrix[0, 1]) + abs(matrix[1, 0]) + abs(matrix[2, 0]) + abs(matrix[2, 1])
        if other > 1e-9 * abs(matrix[0, 0]):
            raise InputError(
                "camera matrix: it has skew, or a last row other than 0 0 1; undistort to one without skew"
            )
        return cls(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], size=size)

    @classmethod
    def from_opencv(
        cls, K: ArrayLike, dist: ArrayLike | None = None, *, size: tuple[float, float] | None = None
    ) -> Camera:
        """Make a camera from the results of ``cv2.calibrateCamera``.

        Detections are then raw pixels, as the camera took them.

        Parameters
        ----------
        K : (3, 3) array
            As in `from_matrix`.
        dist : (4,), (5,), (8,), (12,) or (14,) array
            Distortion coefficients in OpenCV's order: k1 k2 p1 p2[ k3[ k4 k5 k6[ s1 s2 s3 s4[ τx τy]]]]. None, empty
            or all zero: a pinhole.
        size : (width, height), optional
            Of the image, see `Camera`.

        Raises
        ------
        InputError
            If the matrix is not that of a camera, or the coefficients are not such a number of finite values.
        """
        camera = cls.from_matrix(K, size=size)
        if dist is None or (isinstance(dist, list | tuple | np.ndarray) and len(dist) == 0):
            return camera
        lens = Brown(dist)  # type: ignore[arg-type]
        return cls(*camera.numbers, lens, size) if any(lens.values) else camera

    @classmethod
    def from_opencv_fisheye(cls, K: ArrayLike, D: ArrayLike, *, size: tuple[float, float] | None = None) -> Camera:
        """Make a camera from the results of ``cv2.fisheye.calibrate``; COLMAP's OPENCV_FISHEYE is the same model.

        Directions beside and behind the camera are covered too, as far as the model holds; OpenCV itself projects only
        points in front of the camera.

        Parameters
        ----------
        K : (3, 3) array
            As in `from_matrix`.
        D : (4,) array
            k1 to k4 of Kannala and Brandt (2006).
        size : (width, height), optional
            Of the image, see `Camera`.

        Raises
        ------
        InputError
            As `from_opencv`.
        """
        return cls(*cls.from_matrix(K).numbers, KannalaBrandt(D), size)  # type: ignore[arg-type]

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """fx, fy, cx and cy."""
        return self.fx, self.fy, self.cx, self.cy

    @property
    def matrix(self) -> Floats:
        """The (3, 3) intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def focal(self) -> float:
        """Pixels per radian on the optical axis, the geometric mean of both directions."""
        return float(np.sqrt(self.fx * self.fy))

    def bearings(self, pixels: ArrayLike) -> Floats:
        """Unit rays (…, 3) in the camera frame of pixels (…, 2).

        Raises
        ------
        InputError
            For a pixel beyond the fold of the lens model, where no direction maps to.
        """
        rays = self._rays(pixels)
        unit: Floats = rays / np.sqrt((rays * rays).sum(axis=-1, keepdims=True))
        return unit

    def angular_noise(self, pixels: ArrayLike, sigma: ArrayLike, rays: Floats | None = None) -> Floats:
        """Isotropic noise of the rays in radians; see `CameraModel.angular_noise`."""
        if self.lens is not None:
            return super().angular_noise(pixels, sigma, rays)
        points = np.asarray(pixels, dtype=float)
        u = (points[..., 0] - self.cx) / self.fx
        v = (points[..., 1] - self.cy) / self.fy
        cosine = 1.0 / np.sqrt(1.0 + u * u + v * v)
        # du dv = dΩ / cos³, hence the area of a pixel in steradians is cos³ / (fx fy)
        angle: Floats = np.asarray(sigma, dtype=float) * np.sqrt(cosine**3 / (self.fx * self.fy))
        return angle

    def image_areas(self, target: Floats) -> Floats | None:
        """See `CameraModel.image_areas`; if its size is unknown the principal point is its middle.

        None if a detection lies outside of it.
        """
        width, height = size = self.size or (2.0 * self.cx, 2.0 * self.cy)
        return np.array([width * height], float) if ((target >= 0.0) & (target <= size)).all() else None

    def project(self, points: ArrayLike) -> Floats:
        """Pixels (…, 2) of points (…, 3) in the camera frame; does not check that the camera `sees` them."""
        xyz = check_rows(points, 3, "camera", "points")
        if self.lens is not None:
            return np.asarray(self.lens.image(xyz) * (self.fx, self.fy) + (self.cx, self.cy))
        return np.stack(
            [self.fx * xyz[..., 0] / xyz[..., 2] + self.cx, self.fy * xyz[..., 1] / xyz[..., 2] + self.cy], axis=-1
        )

    def sees(self, points: ArrayLike) -> Bools:
        """Whether points (…, 3) are in front of the camera; with a lens, where its model holds."""
        xyz = np.asarray(points, dtype=float)
        return np.asarray(xyz[..., 2] > 0.0) if self.lens is None else self.lens.sees(xyz)

    def shows(self, pixels: ArrayLike) -> Bools:
        """Whether some direction projects to pixels (…, 2): on the near side of the lens' fold."""
        if self.lens is None:
            return super().shows(pixels)
        return np.asarray(np.isfinite(self._lens_rays(self.lens, pixels)).all(axis=-1))

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives (…, 2, 3) of the pixels of points (…, 3) by these points."""
        xyz = np.asarray(points, dtype=float)
        if self.lens is not None:
            return np.asarray(self.lens.jacobian(xyz) * np.array([[self.fx], [self.fy]]))
        inverse = 1.0 / xyz[..., 2]
        out = np.zeros((*xyz.shape[:-1], 2, 3))
        out[..., 0, 0], out[..., 1, 1] = self.fx * inverse, self.fy * inverse
        out[..., 0, 2] = -self.fx * xyz[..., 0] * inverse * inverse
        out[..., 1, 2] = -self.fy * xyz[..., 1] * inverse * inverse
        return out

    def axes(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """Rays and their axes; see `CameraModel.axes`. Without a lens the rays end in the plane z = 1."""
        if self.lens is not None:
            return super().axes(pixels)
        rays = self._rays(pixels)
        axes = np.zeros((*rays.shape, 2))
        axes[..., 0, 0], axes[..., 1, 1] = 1.0 / self.fx, 1.0 / self.fy
        return rays, axes

    def _rays(self, pixels: ArrayLike) -> Floats:
        """Rays (…, 3) of pixels (…, 2): to the plane z = 1, or of any length where there is a lens."""
        points = check_rows(pixels, 2, "camera", "pixels")
        if self.lens is None:
            rays = np.empty((*points.shape[:-1], 3))
            rays[..., 0] = (points[..., 0] - self.cx) / self.fx
            rays[..., 1] = (points[..., 1] - self.cy) / self.fy
            rays[..., 2] = 1.0
            return rays
        rays = self._lens_rays(self.lens, points)
        beyond = np.isnan(rays).any(axis=-1)
        if beyond.any():
            beyond, flat = beyond.ravel(), points.reshape(-1, 2)
            told = describe_outside_circle(self, flat, beyond, np.arange(len(flat)), "pixel{}")
            raise UnseenPixelError(
                f"camera: {told}, where the lens shows nothing; remove such points, or calibrate up to the edge"
            )
        return rays

    def _lens_rays(self, lens: Lens, pixels: ArrayLike) -> Floats:
        """Rays (…, 3) of pixels (…, 2), NaN if the lens shows nothing."""
        return _lens_rays(lens, (np.asarray(pixels, dtype=float) - (self.cx, self.cy)) / (self.fx, self.fy)).copy()


@cache_by_values(64)
def _lens_rays(lens: Lens, image: Floats) -> Floats:
    """The inverse of a lens takes a millisecond, and several stages ask for the rays of one frame."""
    return lens.rays(image)


def check_rows(values: ArrayLike, size: int, to: str, name: str) -> Floats:
    """Rows (…, size) of numbers; what they are given to, and their name, go into the error."""
    rows = as_floats(values, to, f"{name} (…, {size})")
    if rows.shape[-1:] != (size,):
        raise InputError(f"{to}: {name} of shape {rows.shape} given; give (…, {size})")
    return rows


def describe_outside_circle(camera: Camera, pixels: Floats, unseen: Bools, index: Integers, name: str) -> str:
    """Which pixels (m, 2) lie outside of the image circle of a lens, in words.

    ``unseen``, ``index``: (m,), which do, and what each is counted as; ``name``: with ``{}`` for an s of the plural.
    """
    assert camera.lens is not None
    count, first = int(unseen.sum()), int(np.flatnonzero(unseen)[0])
    x, y = pixels[first]
    which = f"at index {index[first]}, ({x:g}, {y:g})"
    return (
        f"{count} of {len(pixels)} {name.format('s' * (len(pixels) > 1))}, {'the first ' * (count > 1)}{which}, "
        f"{'lies' if count == 1 else 'lie'} outside the lens's image circle "
        f"(radius {camera.lens.radius * camera.focal:.0f} px)"
    )


def _check_size(size: Any) -> tuple[float, float]:
    """Width and height in pixels."""
    try:
        width, height = (float(one) for one in size)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"camera: size is {quote_value(size)}; give width and height in pixels") from None
    if not (0.0 < width < math.inf and 0.0 < height < math.inf):
        raise InputError(f"camera: size is {quote_value(size)}; give a positive width and height in pixels")
    return width, height
