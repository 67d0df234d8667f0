"""Measurements of a point: the coordinates in a problem's equations, and their noise.

A measurement converts points as the caller gives them (pixels, points in space) into the coordinates for which the
equations hold symbols, and says how the noise of the given numbers moves those coordinates.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats
from rootmatch.cameras.base import CameraModel, check_camera
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.errors import InputError


@dataclass(frozen=True)
class Measurement(ABC):
    """Coordinates of one point and their noise; see the subclasses."""

    letters: ClassVar[tuple[str, ...]]
    """Names of the coordinates."""
    noise_dimensions: ClassVar[int]
    """Independent directions in which noise moves them; 0 if they are exact."""
    common: ClassVar[int] = 0
    """How many of the coordinates, the last ones, are exact and the same for all points."""

    @property
    @abstractmethod
    def dimension(self) -> int:
        """Numbers in a row of the points as the caller gives them."""

    @property
    def coordinates(self) -> int:
        """How many coordinates the equations see."""
        return len(self.letters)

    def names(self, letter: str, slot: int) -> list[str]:
        """Names of the coordinates of the point in a slot; common ones have the same name in every slot."""
        own = self.coordinates - self.common
        return [f"{letter}{slot if k < own else ''}{name}" for k, name in enumerate(self.letters)]

    @property
    def key(self) -> str:
        """Key of a derivation: it depends on the shape of the measurement, not on the camera."""
        return f"{type(self).__name__}{''.join(self.letters)}{self.noise_dimensions}"

    @abstractmethod
    def measure(self, points: ArrayLike) -> Floats:
        """Coordinates (…, c) of points (…, dimension)."""

    @abstractmethod
    def spread(self, points: ArrayLike, sigma: Floats) -> Floats:
        """Derivatives (n, c, noise_dimensions) of the coordinates in unit noise, for points known to sigma (n,)."""

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Random points (count, dimension) of ordinary size, as a caller might give them."""
        return rng.uniform(-1.0, 1.0, (count, self.dimension))


@dataclass(frozen=True)
class Points(Measurement):
    """Points given by their coordinates, in a plane or in space.

    Parameters
    ----------
    size : int
        2 or 3 coordinates.
    noisy : bool
        Whether they carry noise; a model's points are exact.

    Raises
    ------
    InputError
        If ``size`` is neither 2 nor 3.
    """

    size: int = 3
    noisy: bool = False

    def __post_init__(self) -> None:
        if self.size not in (2, 3):
            raise InputError(f"Points: {self.size} coordinates given; 2 or 3 expected")

    @property
    def letters(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the coordinates."""
        return ("x", "y", "z")[: self.size]

    @property
    def noise_dimensions(self) -> int:  # type: ignore[override]
        """As many as coordinates, or none."""
        return self.size if self.noisy else 0

    @property
    def dimension(self) -> int:
        """As many as coordinates."""
        return self.size

    def measure(self, points: ArrayLike) -> Floats:
        """The points themselves."""
        return np.asarray(points, dtype=float)

    def spread(self, points: ArrayLike, sigma: Floats) -> Floats:
        """The noise of each coordinate apart."""
        axes: Floats = sigma[:, None, None] * np.eye(self.size)[:, : self.noise_dimensions]
        return axes


@dataclass(frozen=True)
class Bearings(Measurement, UnitRays):
    """Unit rays: those of pixels in a calibrated camera, or given as they are.

    ``Bearings(camera)`` is a measurement for `rootmatch.derive`. ``Bearings()`` is one too, and a camera for every
    problem that takes one: its detections are rays (m, 3) in the camera frame, in any direction, and their noise is in
    radians.

    Parameters
    ----------
    camera : Camera, optional
        Without one the points are rays already.
    turn : (3, 3) nested tuple, optional
        Rotation applied to the rays, for example one that brings a measured vertical onto the y axis
        (`rootmatch.cameras.vertical.rotation_to_vertical`, as ``tuple(map(tuple, R))``).

    Raises
    ------
    InputError
        If ``camera`` is not a camera.
    """

    camera: CameraModel | None = None
    turn: tuple[tuple[float, ...], ...] | None = None
    letters: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    noise_dimensions: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if self.camera is not None:
            check_camera(self.camera, "Bearings")

    @property
    def dimension(self) -> int:
        """A pixel has two coordinates, a ray three."""
        return 3 if self.camera is None else self.camera.dimension

    @property
    def _model(self) -> CameraModel:
        return UnitRays() if self.camera is None else self.camera

    def measure(self, points: ArrayLike) -> Floats:
        """Unit rays (…, 3) in the rotated camera frame."""
        rays: Floats = self._model.bearings(points) @ _as_matrix(self.turn).T
        return rays

    def spread(self, points: ArrayLike, sigma: Floats) -> Floats:
        """Derivatives of the unit ray in the two pixel coordinates, times sigma."""
        rays, axes = self._model.axes(points)
        size = np.linalg.norm(rays, axis=1)
        rays = rays / size[:, None]
        # the ray is v / |v|: what v moves, less the part along the ray, times 1 / |v|
        along = np.einsum("nc,ncd->nd", rays, axes)
        across = (axes - rays[:, :, None] * along[:, None, :]) * (sigma / size)[:, None, None]
        turned: Floats = np.einsum("ab,nbd->nad", _as_matrix(self.turn), across)
        return turned

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Detections within 30° of the optical axis."""
        uv = rng.uniform(-0.5, 0.5, (count, 2))
        return self._model.project(np.column_stack([uv, np.ones(count)]))


@dataclass(frozen=True)
class Uncalibrated(Measurement):
    """Rays of pixels in a camera whose focal length is unknown: the ray is w + f z.

    The equations see six coordinates: w = (wx, wy, wz), the position in the image across the optical axis in units of
    `unit` pixels, and z = (zx, zy, zz), the optical axis, the same for all points. Both are rotated by `turn`. The
    unknown f of the equations is then the focal length in units of `unit` pixels.

    Parameters
    ----------
    centre : two floats
        Principal point in pixels.
    turn : (3, 3) nested tuple, optional
        As for `Bearings`.
    unit : float
        Pixels; of the order of a focal length, which keeps the polynomials well scaled.
    """

    centre: tuple[float, float]
    turn: tuple[tuple[float, ...], ...] | None = None
    unit: float = 1000.0
    letters: ClassVar[tuple[str, ...]] = ("wx", "wy", "wz", "zx", "zy", "zz")
    noise_dimensions: ClassVar[int] = 2
    common: ClassVar[int] = 3

    @property
    def dimension(self) -> int:
        """A pixel has two coordinates."""
        return 2

    def measure(self, points: ArrayLike) -> Floats:
        """Coordinates (…, 6)."""
        across = (np.asarray(points, dtype=float) - np.asarray(self.centre, dtype=float)) / self.unit
        out = np.empty((*across.shape[:-1], 6))
        out[..., :3] = across @ _as_matrix(self.turn)[:, :2].T
        out[..., 3:] = _as_matrix(self.turn)[:, 2]
        return out

    def spread(self, points: ArrayLike, sigma: Floats) -> Floats:
        """The image moves w alone."""
        out = np.zeros((len(sigma), 6, 2))
        out[:, :3] = (sigma / self.unit)[:, None, None] * _as_matrix(self.turn)[:, :2]
        return out

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Pixels within half a unit of the centre."""
        pixels: Floats = np.asarray(self.centre, dtype=float) + rng.uniform(-0.5, 0.5, (count, 2)) * self.unit
        return pixels


def _as_matrix(turn: tuple[tuple[float, ...], ...] | None) -> Floats:
    return np.eye(3) if turn is None else np.asarray(turn, dtype=float)


def as_nested_tuples(matrix: Floats) -> tuple[tuple[float, ...], ...]:
    """A matrix as nested tuples, which frozen options can hold."""
    return tuple(tuple(row) for row in matrix.tolist())


def check_measurement(given: Any, name: str) -> Measurement:
    """Check an argument that must be a measurement."""
    if not isinstance(given, Measurement):
        raise InputError(f"{name}: {given!r} given; give Points(3), Bearings(camera) or Uncalibrated(centre)")
    return given
