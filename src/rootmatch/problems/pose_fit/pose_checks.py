"""Checks of a pose: a rotation and the one nearest to it, finite numbers, a covariance; the axes of cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats
from rootmatch.errors import InputError, quote_value

AXES = {
    "opencv": np.eye(3),
    "opengl": np.diag([1.0, -1.0, -1.0]),
    "openxr": np.diag([1.0, -1.0, -1.0]),
    "ros": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
"""Rotations from OpenCV's camera axes (x right, y down, z forward): to x right, y up, z backward; and to x forward,
y left, z up, as REP 103 has a body's."""

ROUNDED = 1e-3
"""Deviation of RᵀR from the identity that is put down to rounding, as of a matrix in single precision or in a file."""
ASYMMETRIC = 1e-6
"""Relative asymmetry, and negative eigenvalue over the largest, of a covariance that is put down to rounding."""


def nearest_covariance(matrix: Floats) -> Floats | None:
    """The covariance nearest to a matrix that is one up to rounding, which is large where points determine little.

    None if they do not determine the pose at all: no number of the covariance can be believed then.
    """
    matrix = 0.5 * (matrix + matrix.T)
    if not np.all(np.isfinite(matrix)):
        return None
    scaled, unit = _standardised_covariance(matrix)
    if not np.all(np.isfinite(scaled)):
        return None
    values, vectors = np.linalg.eigh(scaled)
    if values[0] >= 0.0:
        return matrix
    return np.asarray(unit * ((vectors * np.maximum(values, 0.0)) @ vectors.T))


def _standardised_covariance(covariance: Floats) -> tuple[Floats, Floats]:
    """A covariance over the products of standard deviations, and these: angles and lengths have units of their own."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.outer(deviation, deviation)
    return covariance / np.where(unit > 0.0, unit, 1.0), unit


def check_numbers(value: ArrayLike, name: str, expected: str) -> Floats:
    """An array of finite numbers; ``name`` and what was ``expected`` go into the error."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"pose: {name} is not an array of numbers; give {expected}") from None
    if not np.all(np.isfinite(array)):
        raise InputError(f"pose: {name} holds NaN or infinity; give {expected}")
    return array


def check_rotation(value: ArrayLike, mirrored: bool) -> Floats:
    """The rotation, or reflection, nearest to a matrix that is one up to rounding."""
    R = check_numbers(value, "R", "a rotation matrix (3, 3)")
    if R.shape not in ((3, 3), (2, 2)):
        raise InputError(f"pose: R of shape {R.shape} given; give a rotation matrix (3, 3), or (2, 2) in a plane")
    off = float(np.abs(R.T @ R - np.eye(len(R))).max())
    if off > ROUNDED or (len(R) == 3 and np.linalg.det(R) < 0.0 and not mirrored):
        why = f"RᵀR is {off:.2g} off the identity" if off > ROUNDED else "its determinant is −1, a reflection"
        raise InputError(f"pose: R is not a rotation, {why}; give an orthonormal matrix with determinant 1")
    if off > 1e-12:
        u, _, vt = np.linalg.svd(R)
        R = u @ vt
    return R


def check_covariance(value: ArrayLike, dimension: int) -> Floats:
    """A symmetric covariance without negative eigenvalues."""
    size = 6 if dimension == 3 else 3
    covariance = check_numbers(value, "covariance", f"a matrix ({size}, {size})")
    if covariance.shape not in ((size, size), (size + 1, size + 1)):
        raise InputError(f"pose: covariance of shape {covariance.shape} given, ({size}, {size}) expected")
    _, unit = _standardised_covariance(covariance)
    if np.any(np.abs(covariance - covariance.T) > ASYMMETRIC * np.maximum(unit, np.abs(covariance))):
        raise InputError("pose: the covariance is not symmetric; give cov(a, b) = cov(b, a)")
    covariance = 0.5 * (covariance + covariance.T)
    minimum = float(np.linalg.eigvalsh(_standardised_covariance(covariance)[0])[0])
    if np.any(np.diag(covariance) < 0.0) or minimum < -ASYMMETRIC:
        raise InputError("pose: the covariance has a negative eigenvalue; give a positive semidefinite one")
    return covariance


def quaternion_to_rotation(value: ArrayLike, order: str) -> Floats:
    """The rotation of a unit quaternion whose numbers are in an order, ``"xyzw"`` or ``"wxyz"``."""
    from scipy.spatial.transform import Rotation  # slow to import, rarely needed

    if order not in ("xyzw", "wxyz"):
        raise InputError(f'pose: order {quote_value(order)} given; give "xyzw" or "wxyz"')
    q = check_numbers(value, "quaternion", "4 numbers")
    if q.shape != (4,):
        raise InputError(f"pose: a quaternion of shape {q.shape} given, (4,) expected")
    if abs(float(np.linalg.norm(q)) - 1.0) > ROUNDED:
        raise InputError(f"pose: a quaternion of length {np.linalg.norm(q):.4g} given; give one of length 1")
    return np.asarray(Rotation.from_quat(np.roll(q, -1) if order == "wxyz" else q).as_matrix())
