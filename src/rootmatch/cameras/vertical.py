"""A measured direction, such as gravity's, and the rotation that brings it onto the y axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError

Vector = Sequence[float] | NDArray[np.float64]


def unit_direction(vector: ArrayLike, name: str) -> NDArray[np.float64]:
    """The direction (3,) of a vector as a unit vector.

    Raises
    ------
    InputError
        If it has not three finite numbers, or its length is 0.
    """
    try:
        direction = np.asarray(vector, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: {vector!r} given, three numbers x,y,z expected") from None
    if direction.shape != (3,):
        raise InputError(f"{name}: shape {direction.shape} given, three numbers x,y,z expected")
    if not np.all(np.isfinite(direction)):
        raise InputError(f"{name}: it holds NaN or infinity; give three finite numbers")
    length = float(np.linalg.norm(direction))
    if length < 1e-12:
        raise InputError(f"{name}: its length is 0; give a direction such as 0,1,0")
    return direction / length


def plain_direction(vector: ArrayLike, name: str) -> tuple[float, ...]:
    """A checked direction as plain numbers, of its own length: a problem that holds it can be compared and hashed.

    Raises
    ------
    InputError
        As `unit_direction`.
    """
    unit_direction(vector, name)
    return tuple(float(value) for value in np.asarray(vector, dtype=float))


def turn_to_y(direction: ArrayLike, name: str = "direction") -> NDArray[np.float64]:
    """The smallest rotation (3, 3) that turns ``direction`` onto (0, 1, 0); half a turn about x for (0, −1, 0)."""
    d = unit_direction(direction, name)
    cosine = d[1]
    across2 = d[0] * d[0] + d[2] * d[2]
    if cosine < 0.0 and across2 == 0.0:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.array([-d[2], 0.0, d[0]])  # d × y
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    # 1 / (1 + cos); near -y that sum cancels, so there it is (1 - cos) / sin^2
    factor = 1.0 / (1.0 + cosine) if cosine > 0.0 else (1.0 - cosine) / across2
    rotation: NDArray[np.float64] = np.eye(3) + cross + factor * cross @ cross
    return rotation
