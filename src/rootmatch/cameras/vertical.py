"""A measured direction, such as gravity, and the rotation that maps it onto the y axis."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.algebra.rotation import rotation_onto_y
from rootmatch.errors import InputError, InputWarning

Vector = Sequence[float] | NDArray[np.float64]
IN_BOTH_FRAMES = "one direction, such as down, in the camera frame and in that of the points: 0,1,0 if y points down"
IN_BOTH_IMAGES = (
    "a direction that both images share, such as gravity from an accelerometer, (0, 1, 0) for level cameras, or a "
    "vanishing point. Two images without one are not supported: match descriptors and use a five-point solver "
    "(OpenCV's findEssentialMat, PoseLib)"
)

WIDE = 0.35
"""Standard deviation of an angle, in radians, from which it is said what that is in degrees: 20°. A round value."""


def warn_of_degrees(name: str, sigma: float, stacklevel: int = 4) -> None:
    """Warn of a standard deviation of an angle in radians that may be meant in degrees."""
    if sigma >= WIDE:
        told = f"{name}: σ of {sigma:g} radians given, {np.degrees(sigma):.0f}°"
        meant = f"degrees for radians? For {sigma:g}° give np.radians({sigma:g})"
        warnings.warn(f"{told}; {meant}", InputWarning, stacklevel=stacklevel)


def unit_direction(vector: ArrayLike, name: str) -> NDArray[np.float64]:
    """The direction (3,) of a vector as a unit vector.

    Raises `InputError` if it does not have three finite numbers, or its length is 0.
    """
    try:
        direction = np.asarray(vector, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}: {str(vector)[:60]} given, three numbers x,y,z expected") from None
    if direction.shape != (3,):
        raise InputError(f"{name}: shape {direction.shape} given, three numbers x,y,z expected")
    if not np.all(np.isfinite(direction)):
        raise InputError(f"{name}: it holds NaN or infinity; give three finite numbers")
    length = float(np.linalg.norm(direction))
    if length < 1e-12:
        raise InputError(f"{name}: its length is 0; give a direction such as 0,1,0")
    return direction / length


def check_direction(vector: ArrayLike, name: str, problem: str, needed: str = IN_BOTH_FRAMES) -> tuple[float, ...]:
    """A direction that has no default, as a tuple of floats: not normalised, and a problem that holds it is hashable.

    ``needed`` says in the message what the problem needs if nothing is given.
    """
    if np.size(vector) == 0:
        raise InputError(f"{name}: none given; {problem} needs {needed}")
    unit_direction(vector, name)
    return tuple(float(value) for value in np.asarray(vector, dtype=float))


def rotation_to_vertical(direction: ArrayLike, name: str = "direction") -> NDArray[np.float64]:
    """The smallest rotation (3, 3) that takes ``direction`` onto (0, 1, 0); by 180° about x for (0, −1, 0)."""
    if isinstance(direction, tuple):
        return _cached_rotation(direction, name)
    return rotation_onto_y(unit_direction(direction, name))


@lru_cache(maxsize=16)
def _cached_rotation(direction: tuple[float, ...], name: str) -> NDArray[np.float64]:
    """The rotation of a direction that is asked for again and again, as a problem's; not to be written to."""
    rotation = rotation_onto_y(unit_direction(direction, name))
    rotation.setflags(write=False)
    return rotation
