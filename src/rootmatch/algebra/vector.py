"""Vectors in space as tuples of three numbers, for scalar kernels, which have no arrays; and rotations of them."""

from __future__ import annotations

import math

from rootmatch.algebra.directions import tangent_basis_at
from rootmatch.jit.decorators import part, scalar


@scalar
def dot(a, b):  # type: ignore[no-untyped-def]
    """The scalar product of two vectors; a fourth number of either does not count."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@scalar
def cross(a, b):  # type: ignore[no-untyped-def]
    """The vector product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@scalar
def scale_vector(f, a):  # type: ignore[no-untyped-def]
    """The vector f a."""
    return f * a[0], f * a[1], f * a[2]


@scalar
def add_vectors(a, b):  # type: ignore[no-untyped-def]
    """The vector a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@scalar
def difference(a, b):  # type: ignore[no-untyped-def]
    """The vector a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@scalar
def combination(f, a, g, b):  # type: ignore[no-untyped-def]
    """The vector f a + g b."""
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
def rotate_vector_about_y(c, s, a):  # type: ignore[no-untyped-def]
    """A vector rotated about the y axis by the angle with cosine c and sine s."""
    return c * a[0] + s * a[2], a[1], c * a[2] - s * a[0]


@scalar
def slope_about_y(a):  # type: ignore[no-untyped-def]
    """Derivative of a vector that is rotated about the y axis, by the angle."""
    return a[2], 0.0, -a[0]


@scalar
def symmetric_adjugate(symmetric):  # type: ignore[no-untyped-def]
    """Adjugate of a symmetric matrix [[a b c] [b d e] [c e f]], given as (a, b, c, d, e, f), and its determinant."""
    a, b, c, d, e, f = symmetric
    adjugate = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    return adjugate, a * adjugate[0] + b * adjugate[1] + c * adjugate[2]


@scalar
def symmetric_times(symmetric, v):  # type: ignore[no-untyped-def]
    """Product of such a symmetric matrix and a vector."""
    a, b, c, d, e, f = symmetric
    x, y, z = v
    return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z


tangent_basis = scalar(tangent_basis_at)


@part
def fill_tilted_rotation(turn, tilt, R):  # type: ignore[no-untyped-def]
    """Rotation about y, and then about a horizontal vector by its length."""
    c, s = math.cos(turn), math.sin(turn)
    x, z = tilt[0], tilt[1]
    angle2 = x * x + z * z
    a, b = 1.0, 0.5
    if angle2 > 1e-12:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    # the rotation of (x, 0, z): 1 + a [v] + b [v]²
    r00, r01, r02 = 1.0 - b * z * z, -a * z, b * x * z
    r20, r21, r22 = b * x * z, a * x, 1.0 - b * x * x
    R[0, 0], R[0, 1], R[0, 2] = r00 * c - r02 * s, r01, r00 * s + r02 * c
    R[1, 0], R[1, 1], R[1, 2] = a * z * c + a * x * s, 1.0 - b * angle2, a * z * s - a * x * c
    R[2, 0], R[2, 1], R[2, 2] = r20 * c - r22 * s, r21, r20 * s + r22 * c
