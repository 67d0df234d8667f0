"""Vectors in space, component by component for scalar kernels, which have no arrays."""

from __future__ import annotations

from rootmatch.algebra.directions import tangent_basis_of
from rootmatch.jit.decorators import scalar


@scalar
def dot(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """The scalar product of two vectors."""
    return ax * bx + ay * by + az * bz


@scalar
def cross(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """The vector product of two vectors."""
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


tangent_basis = scalar(tangent_basis_of)
