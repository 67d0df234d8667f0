"""Proposals of the upright two-point problem: a pair's turn and place carry every other point into the camera."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import cross, dot, tangents
from rootmatch.jit.decorators import part, scalar
from rootmatch.problems.up2p.resultant import faces, roots, sinusoid

NEARLY = 1.01
"""A pair whose equation noise has left without a solution is still solved when γ² is below so many times α² + β²."""
VAGUE2 = 1e-2
"""Variance, in radians², of a prediction beyond which it says nothing about where the point is."""


def coordinates(t, sets, others):  # type: ignore[no-untyped-def]
    """Differences of the other points to each pair's first, and the normals as they are."""
    points, normals = t.points.T, t.normals.T
    place = points[others] - points[sets[:, 0], None]
    return np.concatenate([place, normals[others]], axis=2), np.ascontiguousarray(normals[sets])


@scalar
def turns(t, i0, i1, j0, j1):  # type: ignore[no-untyped-def]
    """Cosine and sine of both turns of a pair; NaN where there is none."""
    p = t.points
    u = t.rays
    return turns_of(
        p[0, i1] - p[0, i0], p[1, i1] - p[1, i0], p[2, i1] - p[2, i0],
        u[0, j0], u[1, j0], u[2, j0], u[0, j1], u[1, j1], u[2, j1],
    )  # fmt: skip


@scalar
def turns_of(dx, dy, dz, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Cosine and sine of both turns that a difference d between the points of two bearings allows."""
    alpha, beta, gamma = sinusoid(dx, dy, dz, ax, ay, az, bx, by, bz)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    solved = gamma * gamma <= NEARLY * (alpha * alpha + beta * beta)
    # the nearest approach is no turn yet: its length is below 1
    length = 1.0 / np.sqrt(c1 * c1 + s1 * s1)
    length = length if solved else np.nan
    return c1 * length, s1 * length, c2 * length, s2 * length


@part
def solve(t, i, j, scratch):  # type: ignore[no-untyped-def]
    """Both turns for every second image."""
    for k in range(scratch.shape[1]):
        scratch[0, k], scratch[1, k], scratch[2, k], scratch[3, k] = turns(t, i[0], i[1], j[0], k)


@scalar
def depths(c, s, dx, dy, dz, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Depths of both points along their bearings, and the turned difference between them."""
    px, py, pz = c * dx + s * dz, dy, c * dz - s * dx
    ab = dot(ax, ay, az, bx, by, bz)
    ap = dot(ax, ay, az, px, py, pz)
    bp = dot(bx, by, bz, px, py, pz)
    inverse = 1.0 / (1.0 - ab * ab)
    return (ab * bp - ap) * inverse, (bp - ab * ap) * inverse, px, py, pz


@scalar
def known(t, raster, i, j):  # type: ignore[no-untyped-def]
    """The pair's difference, the first point's bearing, in the raster's basis too, and that basis."""
    p = t.points
    u, r, b = t.rays, raster.rays, raster.basis
    return (
        p[0, i[1]] - p[0, i[0]], p[1, i[1]] - p[1, i[0]], p[2, i[1]] - p[2, i[0]],
        u[0, j[0]], u[1, j[0]], u[2, j[0]], r[0, j[0]], r[1, j[0]], r[2, j[0]],
        b[0, 0], b[0, 1], b[0, 2], b[1, 0], b[1, 1], b[1, 2], b[2, 0], b[2, 1], b[2, 2],
    )  # fmt: skip


@scalar
def hypothesis(t, raster, before, last, scratch, root):  # type: ignore[no-untyped-def]
    """The first point and the three turned axes of the world as the camera has them at one root."""
    dx, dy, dz, ax, ay, az, rx, ry, rz, b00, b01, b02, b10, b11, b12, b20, b21, b22 = before
    two = 2 * (root & 1)
    c, s = scratch[two, last], scratch[two + 1, last]
    u = t.rays
    first, second, _, _, _ = depths(c, s, dx, dy, dz, ax, ay, az, u[0, last], u[1, last], u[2, last])
    # comparisons with NaN are false
    return (root < 2) & (first > 0.0) & (second > 0.0), (
        first * rx, first * ry, first * rz,
        c * b00 - s * b02, c * b10 - s * b12, c * b20 - s * b22,
        b01, b11, b21,
        s * b00 + c * b02, s * b10 + c * b12, s * b20 + c * b22,
    )  # fmt: skip


@scalar
def response(w, qx, qz, k, l, inverse, first, second, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]  # noqa: E741
    """Partials of the predicted point's component along w in the bearings a and b, and in a tilt of both (x and z).

    w · ∂place/∂a = λ (w − g) and w · ∂place/∂b = μ g, of which what lies across the bearing counts.
    """
    wx, wy, wz = w
    along = dot(wx, wy, wz, ax, ay, az) * inverse
    about = (wx * qz - wz * qx) * inverse
    gx, gy, gz = along * k[0] + about * l[0], along * k[1] + about * l[1], along * k[2] + about * l[2]
    hx, hy, hz = first * (wx - gx), first * (wy - gy), first * (wz - gz)
    gx, gy, gz = second * gx, second * gy, second * gz
    # a tilt ω moves a by ω × a and b by ω × b
    ux, _, uz = cross(ax, ay, az, hx, hy, hz)
    vx, _, vz = cross(bx, by, bz, gx, gy, gz)
    ha = dot(hx, hy, hz, ax, ay, az)
    gb = dot(gx, gy, gz, bx, by, bz)
    return (hx - ha * ax, hy - ha * ay, hz - ha * az), (gx - gb * bx, gy - gb * by, gz - gb * bz), ux + vx, uz + vz


@part
def predictions(t, i, j, root, out):  # type: ignore[no-untyped-def]
    """Where every source point must be seen, its covariance, and whether it can be seen.

    Both points keep to their bearings: λ a + R Δ = μ b, so a change of the bearings moves λ, μ and θ by the inverse of
    the matrix (a, −b, R'Δ). A tilt of the vertical turns all three bearings together.
    """
    c1, s1, c2, s2 = turns(t, i[0], i[1], j[0], j[1])
    c, s = (c1, s1) if root == 0 else (c2, s2)
    p = t.points
    u = t.rays
    ax, ay, az = u[0, j[0]], u[1, j[0]], u[2, j[0]]
    bx, by, bz = u[0, j[1]], u[1, j[1]], u[2, j[1]]
    X, Y, Z = p[0, i[0]], p[1, i[0]], p[2, i[0]]
    first, second, px, _, pz = depths(c, s, p[0, i[1]] - X, p[1, i[1]] - Y, p[2, i[1]] - Z, ax, ay, az, bx, by, bz)
    if not (root < 2 and first > 0.0 and second > 0.0):
        return False
    m = t.normals
    if not (
        faces(c, s, m[0, i[0]], m[1, i[0]], m[2, i[0]], ax, ay, az)
        and faces(c, s, m[0, i[1]], m[1, i[1]], m[2, i[1]], bx, by, bz)
    ):
        return False
    va, vb, tilt = t.variance[j[0]], t.variance[j[1]], t.tilt_variance[0]
    # first and last row of the adjugate of the matrix (a, −b, R'Δ), R'Δ = (p_z, 0, −p_x)
    k = cross(-bx, -by, -bz, pz, 0.0, -px)
    l = cross(ax, ay, az, -bx, -by, -bz)  # noqa: E741
    inverse = 1.0 / dot(k[0], k[1], k[2], ax, ay, az)
    for d in range(out.shape[1]):
        ex, ey, ez = p[0, d] - X, p[1, d] - Y, p[2, d] - Z
        qx, qy, qz = c * ex + s * ez, ey, c * ez - s * ex
        x, y, z = first * ax + qx, first * ay + qy, first * az + qz
        length = 1.0 / np.sqrt(dot(x, y, z, x, y, z))
        x, y, z = x * length, y * length, z * length
        e, f = tangents(x, y, z)
        a1, b1, t1x, t1z = response(e, qx, qz, k, l, inverse, first * length, second * length, ax, ay, az, bx, by, bz)
        a2, b2, t2x, t2z = response(f, qx, qz, k, l, inverse, first * length, second * length, ax, ay, az, bx, by, bz)
        # the tilt turns what is seen as well
        r1x, _, r1z = cross(x, y, z, *e)
        r2x, _, r2z = cross(x, y, z, *f)
        t1x, t1z, t2x, t2z = t1x - r1x, t1z - r1z, t2x - r2x, t2z - r2z
        out[0, d], out[1, d], out[2, d] = x, y, z
        out[3, d], out[4, d], out[5, d] = e
        out[6, d], out[7, d], out[8, d] = f
        out[9, d] = va * dot(*a1, *a1) + vb * dot(*b1, *b1) + tilt * (t1x * t1x + t1z * t1z)
        out[10, d] = va * dot(*a1, *a2) + vb * dot(*b1, *b2) + tilt * (t1x * t2x + t1z * t2z)
        out[11, d] = va * dot(*a2, *a2) + vb * dot(*b2, *b2) + tilt * (t2x * t2x + t2z * t2z)
        seen = faces(c, s, m[0, d], m[1, d], m[2, d], x, y, z)
        out[12, d] = 1.0 if out[9, d] + out[11, d] < VAGUE2 and seen else 0.0
    return True
