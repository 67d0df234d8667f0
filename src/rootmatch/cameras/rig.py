"""A rig: several calibrated cameras on one body that take their images at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats, as_floats, as_points, cache_by_identity
from rootmatch.cameras.base import CameraModel, check_deviation, image_membership
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.vertical import warn_of_degrees
from rootmatch.errors import InputError

ORTHONORMAL = 1e-6
"""Deviation of R Rᵀ from the identity up to which R counts as a rotation: that of a file's digits."""


FORMS = "for a rig, give (pixels, camera index of each) or a list of arrays (m, 2), one per camera"
"""How the detections of a rig may be given, for errors."""


@dataclass(frozen=True)
class Rig(CameraModel):
    """Several cameras with fixed poses on one body.

    Its detections are given as rows of x, y and the index of the camera, as a pair ``(pixels, index)`` of arrays (n',
    2) and (n',), or as a list of arrays (m, 2), one for each camera (``[]`` if it detects nothing), which are numbered
    as after ``np.concatenate``, one camera after the other. The pose of a match takes the points into the frame of the
    rig, ``x_rig = R X + t``, in which its cameras are given.

    Parameters
    ----------
    views : sequence of (camera, R, t)
        Each camera with its pose in the rig, ``x_camera = R x_rig + t``: R (3, 3), t (3,) in the unit of the points.
    sizes : sequence of (width, height), optional
        Sizes of the images, in pixels; by default those of the cameras, if all have one. A pose then does not expect
        points outside the images; without sizes, every point in front of a camera counts as visible.
    rotation_noise, position_noise : float or (C,) array
        Standard deviations of the poses of all cameras, or of each: of a rotation about each axis, in radians, and of
        the camera's centre along each axis, in the unit of t. They are 0 by default; use 0 for a camera whose frame is
        that of the rig. How well focal lengths and principal points are known is stated for each `rootmatch.Camera`.

    Raises
    ------
    InputError
        If there is no camera, if a camera's detections are not pixels, if R is not a rotation or t not a vector, or if
        sizes are not a pair of positive numbers for each camera, or a standard deviation is negative.
    """

    views: tuple[tuple[CameraModel, Any, Any], ...]
    sizes: tuple[tuple[float, float], ...] | None
    rotation_noise: tuple[float, ...]
    position_noise: tuple[float, ...]
    dimension = 3
    """A pixel and the index of its camera."""

    def __init__(
        self,
        views: Sequence[tuple[CameraModel, ArrayLike, ArrayLike]],
        sizes: ArrayLike | None = None,
        *,
        rotation_noise: ArrayLike = 0.0,
        position_noise: ArrayLike = 0.0,
    ) -> None:
        try:
            given: list[tuple[Any, ...]] = [tuple(view) for view in views]
        except TypeError:
            raise InputError(f"rig: {type(views).__name__} given; give a list of (camera, R, t)") from None
        if not given:
            raise InputError("rig: no camera given; give a list of (camera, R, t)")
        kept, own = [], list[tuple[float, float]]()
        for k, view in enumerate(given):
            if len(view) != 3:
                raise InputError(f"rig: {len(view)} entries for camera {k}; give (camera, R, t)")
            camera, R, t = view
            if not isinstance(camera, CameraModel) or camera.dimension != 2:
                raise InputError(f"rig: {type(camera).__name__} given for camera {k}; give a Camera with pixels")
            rotation, translation = _numbers(R, (3, 3), f"R of camera {k}"), _numbers(t, (3,), f"t of camera {k}")
            if np.abs(rotation @ rotation.T - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(rotation) < 0.0:
                raise InputError(f"rig: R of camera {k} is not a rotation; give R and t with x_camera = R x_rig + t")
            if camera.size is not None and isinstance(camera, Camera):
                own.append(camera.size)
                camera = replace(camera, size=None)  # which is in one place then
            kept.append((camera, tuple(map(tuple, rotation.tolist())), tuple(translation.tolist())))
        object.__setattr__(self, "views", tuple(kept))
        if sizes is None and len(own) == len(kept):
            sizes = own
        if sizes is not None:
            pairs = _numbers(sizes, (len(kept), 2), "sizes")
            if (pairs <= 0.0).any():
                raise InputError(f"rig: an image of size {pairs.min():g} given; give width and height in pixels")
            sizes = tuple((width, height) for width, height in pairs.tolist())
        object.__setattr__(self, "sizes", sizes)
        turned = _deviations(rotation_noise, len(kept), "rotation_noise", "radians")
        warn_of_degrees("rotation_noise", max(turned))
        object.__setattr__(self, "rotation_noise", turned)
        moved = _deviations(position_noise, len(kept), "position_noise", "the unit of t")
        object.__setattr__(self, "position_noise", moved)

    def with_views(self, views: Sequence[tuple[CameraModel, ArrayLike, ArrayLike]]) -> Rig:
        """A rig with as many other cameras, or other poses of them, and the same sizes and standard deviations."""
        return Rig(views, self.sizes, rotation_noise=self.rotation_noise, position_noise=self.position_noise)

    @property
    def cameras(self) -> tuple[CameraModel, ...]:
        """The cameras, C of them."""
        return tuple(view[0] for view in self.views)

    @cached_property
    def is_uncertain(self) -> bool:
        """Whether a camera, or its pose, is not exact."""
        return any((*self.rotation_noise, *self.position_noise)) or any(one.is_uncertain for one in self.cameras)

    @cached_property
    def rotations(self) -> Floats:
        """R (C, 3, 3) of the cameras in the rig."""
        return np.array([view[1] for view in self.views])

    @cached_property
    def translations(self) -> Floats:
        """Translations (C, 3) from the rig to the cameras."""
        return np.array([view[2] for view in self.views])

    @cached_property
    def centres(self) -> Floats:
        """Centres (C, 3) of the cameras in the rig's frame."""
        return np.asarray(-np.einsum("cji,cj->ci", self.rotations, self.translations))

    @property
    def focal(self) -> float:
        """Mean focal length."""
        return float(np.mean([camera.focal for camera in self.cameras]))

    def joined(self, target: Any) -> Any:
        """Rows of x, y and index (n', 3) of detections: of such rows, of ``(pixels, index)`` or of a list by camera.

        Raises
        ------
        InputError
            If an index names no camera, if there is not one for each pixel, or a list has no array for each camera.
        """
        if isinstance(target, tuple | list) and len(target):
            shapes = [_shape(one) for one in target]
            if len(target) == 2 and len(shapes[1]) == 1 and shapes != [(3,), (3,)] and shapes[1] != (0,):
                pixels = as_floats(target[0], "target", f"pixels (n', 2); {FORMS}")
                index = as_floats(target[1], "target", f"an index of the camera for each pixel; {FORMS}")
                if pixels.ndim != 2 or pixels.shape[1] != 2 or len(pixels) != len(index):
                    raise InputError(
                        f"target: pixels of shape {pixels.shape} and camera indices of shape {index.shape} given; "
                        "give (n', 2) and (n',)"
                    )
                target = np.column_stack([pixels, index])
            elif (0,) in shapes or max(map(len, shapes)) > 1:
                target = self._join_cameras(target)
        rows = as_floats(target, "target", f"rows of x, y and the index of the camera; {FORMS}")
        if rows.ndim in (2, 3) and rows.shape[-1] == 2:
            raise InputError(f"target: shape {rows.shape} given; {FORMS}")
        if rows.ndim == 2 and rows.shape[1] == 3:
            index = rows[:, 2]
            wrong = ~((index >= 0) & (index < len(self.views)) & (index % 1 == 0))
            if wrong.any():
                k = int(np.flatnonzero(wrong)[0])
                raise InputError(
                    f"target: point {k} is of camera {rows[k, 2]:g}; the rig has {len(self.views)}, counted from 0"
                )
        return rows

    def _join_cameras(self, target: Sequence[ArrayLike]) -> Floats:
        """Rows of x, y and index (n', 3) of a list of arrays (m, 2), one for each camera."""
        if len(target) != len(self.views):
            raise InputError(
                f"target: {len(target)} arrays given, and the rig has {len(self.views)} cameras; give one per "
                "camera, [] for one without detections"
            )
        rows = [np.zeros((0, 3))]
        for k, one in enumerate(target):
            pixels = as_points(one, 2, f"target of camera {k}")
            pixels = pixels.reshape(0, 2) if pixels.shape == (0,) else pixels
            if pixels.ndim != 2 or pixels.shape[1] != 2:
                raise InputError(f"target: shape {pixels.shape} given for camera {k}, (m, 2) expected; {FORMS}")
            rows.append(np.column_stack([pixels, np.full(len(pixels), float(k))]))
        return np.concatenate(rows)

    def bearings(self, pixels: ArrayLike) -> Floats:
        """Unit rays (m, 3) in the rig's frame of rows (m, 3) of x, y and index; they begin at different centres."""
        rows = np.asarray(pixels, dtype=float)
        out = np.empty((len(rows), 3))
        for k, (camera, rotation) in enumerate(zip(self.cameras, self.rotations, strict=True)):
            own = rows[:, 2] == k
            out[own] = camera.bearings(rows[own, :2]) @ rotation
        return out

    def angular_noise(self, pixels: ArrayLike, sigma: ArrayLike, rays: Floats | None = None) -> Floats:
        """Isotropic noise of the rays in radians; see `CameraModel.angular_noise`."""
        rows = np.asarray(pixels, dtype=float)
        spread = np.broadcast_to(np.asarray(sigma, dtype=float), rows.shape[:-1])
        out = np.empty(rows.shape[:-1])
        for k, camera in enumerate(self.cameras):
            own = rows[:, 2] == k
            out[own] = camera.angular_noise(rows[own, :2], spread[own])
        return out

    def chart(self, pixels: Floats, sigma: Floats) -> tuple[CameraModel, Floats, Floats]:
        """The images side by side; see `CameraModel.chart`."""
        return self, pixels[:, :2] + self.offsets(pixels)[pixels[:, 2].astype(np.int64)], sigma

    def offsets(self, pixels: Floats) -> Floats:
        """Offset (C, 2) of each camera's image in a common plane on which the images do not overlap."""
        found, missing = _offsets(pixels), len(self.views)
        return np.concatenate([found, np.zeros((missing - len(found), 2))]) if len(found) < missing else found

    def expects(self, k: int, pixels: Floats) -> Floats:
        """How far pixels (…, 2) of camera k are expected in its image: 1 well within, 0 well outside, ½ on the rim."""
        return np.ones(pixels.shape[:-1]) if self.sizes is None else image_membership(pixels, self.sizes[k])

    def project(self, points: ArrayLike) -> Floats:
        """A rig has as many images of a point as cameras."""
        raise InputError("rig: a point has an image in each camera; project with Rig.cameras, rotations, translations")

    def sees(self, points: ArrayLike) -> Bools:
        """Refused, as `project` is: a rig has several images."""
        raise InputError("rig: each camera sees different points; ask each of Rig.cameras")

    def jacobian(self, points: ArrayLike) -> Floats:
        """Refused, as `project` is: a rig has several images."""
        return self.project(points)


@cache_by_identity(4)
def _offsets(pixels: Floats) -> Floats:
    """`Rig.offsets` up to the last camera that detects anything, found once for all bodies of a frame."""
    camera = pixels[:, 2].astype(np.int64)
    low = np.full((camera.max(initial=-1) + 1, 2), np.inf)
    high = -low
    np.minimum.at(low, camera, pixels[:, :2])
    np.maximum.at(high, camera, pixels[:, :2])
    shown = low[:, :1] <= high[:, :1]
    low, width = np.where(shown, low, 0.0), np.where(shown[:, 0], high[:, 0] - low[:, 0], 0.0)
    offsets = -low
    offsets[1:, 0] += width[:-1].cumsum() * shown[1:, 0]
    return offsets


def _shape(value: ArrayLike) -> tuple[int, ...]:
    """The shape of an array; two lengths of −1 for lists that are none."""
    try:
        return np.shape(value)
    except ValueError:
        return -1, -1


def _deviations(value: ArrayLike, count: int, name: str, unit: str) -> tuple[float, ...]:
    """A standard deviation of each of so many cameras, of one for all or one for each."""
    given = np.array(value, object)
    each = [value] * count if given.ndim == 0 else list(given.ravel())
    if len(each) != count:
        raise InputError(f"rig: {len(each)} of {name} given; give one number, or one for each of {count} cameras")
    return tuple(check_deviation(one, f"rig: {name}", unit) for one in each)


def _numbers(value: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"rig: {name} is not an array of numbers; give shape {shape}") from None
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise InputError(
            f"rig: {name} has shape {array.shape}, or holds NaN or infinity; give finite numbers of shape {shape}"
        )
    return array
