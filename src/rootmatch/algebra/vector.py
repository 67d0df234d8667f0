"""Vectors in space: component by component for scalar kernels, which have no arrays, and as arrays for NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.jit.decorators import scalar

Floats = NDArray[np.float64]


@scalar
def dot(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Scalar product."""
    return ax * bx + ay * by + az * bz


@scalar
def cross(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Vector product."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@scalar
def combination(f, a, g, b):  # type: ignore[no-untyped-def]
    """The vector f a + g b of two vectors (x, y, z)."""
    return f * a[0] + g * b[0], f * a[1] + g * b[1], f * a[2] + g * b[2]


@scalar
def column(array, i):  # type: ignore[no-untyped-def]
    """Vector i of an array (3, n)."""
    return array[0, i], array[1, i], array[2, i]


@scalar
def column4(array, i):  # type: ignore[no-untyped-def]
    """Column i of an array (4, n): a normal and the cosine of its view angle."""
    return array[0, i], array[1, i], array[2, i], array[3, i]


@scalar
def rotated_about_y(c, s, x, y, z):  # type: ignore[no-untyped-def]
    """A vector rotated about the y axis by the angle with cosine c and sine s."""
    return c * x + s * z, y, c * z - s * x


def tangent_basis_of(x: Any, y: Any, z: Any) -> Any:
    """Two unit vectors orthogonal to a unit vector and to each other, without a branch (Duff et al. 2017).

    The three are right-handed in this order: first × second = (x, y, z). Plain Python, for a single vector;
    `tangent_basis` is the same as a kernel, `tangent_bases` serves arrays.
    """
    sign = 1.0 if z >= 0.0 else -1.0
    w = -1.0 / (sign + z)
    v = x * y * w
    return (1.0 + sign * x * x * w, sign * v, -sign * x), (v, sign + y * y * w, -y)


tangent_basis = scalar(tangent_basis_of)


def tangent_bases(vectors: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (…, 3) orthogonal to unit vectors (…, 3) and to each other; right-handed like `tangent_basis`.

    Not the same vectors: these begin with the axis to which each vector is least aligned, which NumPy has as a lookup.
    """
    axis = np.eye(3)[np.abs(vectors).argmin(axis=-1)]
    first = np.cross(vectors, axis)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return first, np.cross(vectors, first)
