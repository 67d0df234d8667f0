"""Kernels of congruent and similar triangles: three points against three by the distances between them.

With the scale s between the sets, a triple has three equations F_ij = e_ij − s d_ij = 0 of target distances e and
source distances d. Their covariance needs nothing but the noise of the points and the angles of both triangles, which
are functions of the distances again: ∂F_ij moves along the sides, and two sides meet at an angle. With a known scale
all three are constraints; an unknown one is projected out and leaves two, the shape of the triangle.
"""

from __future__ import annotations

import math
from typing import Any

from rootmatch.algebra.vector import dot, symmetric_adjugate, symmetric_times
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.kernels import ResidualKernels
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.pairs import edge_kernel_of_pairs, slab_kernel_of_rows

FLAT = 1e-9
"""Determinant of the equations' correlation below which three points are on a line, whose equations depend.
Not tuned: rounding."""


@scalar
def cosine(a, b, c):  # type: ignore[no-untyped-def]
    """Cosine of the angle between sides a and b of a triangle, opposite c."""
    return (a * a + b * b - c * c) / (2.0 * a * b)


@scalar
def covariance(s, d01, d02, d12, e01, e02, e12, u0, u1, u2, v0, v1, v2):  # type: ignore[no-untyped-def]
    """Covariance (11, 12, 13, 22, 23, 33) of F01, F02, F12 for variances u of the source and v of the target."""
    q = s * s
    w0, w1, w2 = v0 + q * u0, v1 + q * u1, v2 + q * u2
    c0 = v0 * cosine(e01, e02, e12) + q * u0 * cosine(d01, d02, d12)
    c1 = v1 * cosine(e01, e12, e02) + q * u1 * cosine(d01, d12, d02)
    c2 = v2 * cosine(e02, e12, e01) + q * u2 * cosine(d02, d12, d01)
    return w0 + w1, c0, c1, w0 + w2, c2, w1 + w2


@scalar
def joint_chi2(scale, d01, d02, d12, e01, e02, e12, u0, u1, u2, v0, v1, v2):  # type: ignore[no-untyped-def]
    """χ² of all constraints."""
    s = scale if scale > 0.0 else (d01 * e01 + d02 * e02 + d12 * e12) / (d01 * d01 + d02 * d02 + d12 * d12)
    matrix = covariance(s, d01, d02, d12, e01, e02, e12, u0, u1, u2, v0, v1, v2)
    adjugate, determinant = symmetric_adjugate(matrix)
    sides, off = (d01, d02, d12), (e01 - s * d01, e02 - s * d02, e12 - s * d12)
    by_scale = symmetric_times(adjugate, sides)
    along = dot(off, by_scale)
    free = 0.0 if scale > 0.0 else along * along / dot(sides, by_scale)
    chi2 = (dot(off, symmetric_times(adjugate, off)) - free) / determinant
    known = determinant > FLAT * matrix[0] * matrix[3] * matrix[5]
    return max(chi2, 0.0) if known and chi2 < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@scalar
def normalised_squared(scale, d01, d02, d12, e01, e02, e12, u0, u1, u2, v0, v1, v2):  # type: ignore[no-untyped-def]
    """Square of d02 e01 − d01 e02, the resultant of the first two equations in s, over its variance."""
    s = (d01 * e01 + d02 * e02) / (d01 * d01 + d02 * d02)
    a, b, _, d, _, _ = covariance(s, d01, d02, d12, e01, e02, e12, u0, u1, u2, v0, v1, v2)
    value = d02 * e01 - d01 * e02
    ratio = value * value / (d02 * d02 * a - 2.0 * d01 * d02 * b + d01 * d01 * d)
    return ratio if ratio >= 0.0 and ratio < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@scalar
def twice_area(points, a, b, c):  # type: ignore[no-untyped-def]
    """Twice the signed area of three points of a plane."""
    x, y = points[0], points[1]
    return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])


def triangle_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual of the whole triangle."""

    @scalar
    def at(t, a, b, c, k, l, m):  # type: ignore[no-untyped-def]  # noqa: E741
        d, e = t.source, t.target
        u, v = t.source_variance, t.target_variance
        result = value(
            t.scale[0], d[a, b], d[a, c], d[b, c], e[k, l], e[k, m], e[l, m], u[a], u[b], u[c], v[k], v[l], v[m]
        )
        mirrored = twice_area(t.source_points, a, b, c) * twice_area(t.target_points, k, l, m) < 0.0
        return math.sqrt(UNINFORMATIVE * UNINFORMATIVE if mirrored else result)

    @scalar
    def pair(t, i, j, order):  # type: ignore[no-untyped-def]
        a, b, c = order
        return at(t, i[a], i[b], i[c], j[a], j[b], j[c])

    @kernel
    def row(t, i, j, last, line):  # type: ignore[no-untyped-def]
        for k in range(line.shape[0]):
            line[k] = at(t, i[0], i[1], last, j[0], j[1], k)

    edge = edge_kernel_of_pairs(pair, 2)
    return ResidualKernels(edge, slab_kernel_of_rows(row, edge))


def resultant_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual that compares the linear polynomials d x − e of two sides alone."""

    @scalar
    def pair(t, i, j, order):  # type: ignore[no-untyped-def]
        a, b, c = order
        return value(t.source[i[a], i[b]], -t.target[j[a], j[b]], t.source[i[a], i[c]], -t.target[j[a], j[c]])

    @kernel
    def row(t, i, j, last, line):  # type: ignore[no-untyped-def]
        d01, d02, e01 = t.source[i[0], i[1]], t.source[i[0], last], t.target[j[0], j[1]]
        for k in range(line.shape[0]):
            line[k] = value(d01, -e01, d02, -t.target[j[0], k])

    edge = edge_kernel_of_pairs(pair, 2)
    return ResidualKernels(edge, slab_kernel_of_rows(row, edge))
