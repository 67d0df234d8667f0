"""Hypotheses of the upright two-point problem: a pair's rotation and depths carry every other point into the camera."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import column, column4, rotated_about_y, tangent_basis
from rootmatch.jit.decorators import part, scalar
from rootmatch.problems.limits import VAGUE2
from rootmatch.problems.up2p.prediction import depths, prediction, rotations, solved_pair, tilt_covariance
from rootmatch.problems.up2p.quadratic import faces


def coordinates(t, sets, others):  # type: ignore[no-untyped-def]
    """Differences of the other points to each pair's first, and the normals as they are."""
    rows = np.concatenate([t.points.T, t.normals.T], axis=1)  # with their cosines
    every = rows[others]
    every[..., :3] -= rows[sets[:, 0], None, :3]
    return every, np.ascontiguousarray(rows[sets, 3:])


@scalar
def rotations_of(t, i0, i1, j0, j1):  # type: ignore[no-untyped-def]
    """`rotations` of a pair of correspondences."""
    p = t.points
    u = t.rays
    return rotations(
        p[0, i1] - p[0, i0], p[1, i1] - p[1, i0], p[2, i1] - p[2, i0],
        u[0, j0], u[1, j0], u[2, j0], u[0, j1], u[1, j1], u[2, j1],
    )  # fmt: skip


@part
def solve(t, i, j, scratch):  # type: ignore[no-untyped-def]
    """Both rotations for every second image."""
    p, u = t.points, t.rays
    # read before the loop, which would not vectorise if it read them
    dx, dy, dz = p[0, i[1]] - p[0, i[0]], p[1, i[1]] - p[1, i[0]], p[2, i[1]] - p[2, i[0]]
    ax, ay, az = column(u, j[0])
    for k in range(scratch.shape[1]):
        scratch[0, k], scratch[1, k], scratch[2, k], scratch[3, k] = rotations(
            dx, dy, dz, ax, ay, az, u[0, k], u[1, k], u[2, k]
        )  # fmt: skip


@scalar
def known(t, grid, i, j):  # type: ignore[no-untyped-def]
    """The pair's difference, the first point's bearing, in the grid's basis too, and that basis."""
    p = t.points
    u, r, b = t.rays, grid.rays, grid.basis
    return (
        p[0, i[1]] - p[0, i[0]], p[1, i[1]] - p[1, i[0]], p[2, i[1]] - p[2, i[0]],
        u[0, j[0]], u[1, j[0]], u[2, j[0]], r[0, j[0]], r[1, j[0]], r[2, j[0]],
        b[0, 0], b[0, 1], b[0, 2], b[1, 0], b[1, 1], b[1, 2], b[2, 0], b[2, 1], b[2, 2],
    )  # fmt: skip


@scalar
def hypothesis(t, grid, before, last, scratch, root):  # type: ignore[no-untyped-def]
    """The first point and the three rotated axes of the world in the camera at one root."""
    dx, dy, dz, ax, ay, az, rx, ry, rz, b00, b01, b02, b10, b11, b12, b20, b21, b22 = before
    two = 2 * (root & 1)
    c, s = scratch[two, last], scratch[two + 1, last]
    u = t.rays
    px, py, pz = rotated_about_y(c, s, dx, dy, dz)
    first, second = depths(ax, ay, az, u[0, last], u[1, last], u[2, last], px, py, pz)
    # comparisons with NaN are false
    return (root < 2) & (first > 0.0) & (second > 0.0), (
        first * rx, first * ry, first * rz,
        c * b00 - s * b02, c * b10 - s * b12, c * b20 - s * b22,
        b01, b11, b21,
        s * b00 + c * b02, s * b10 + c * b12, s * b20 + c * b22,
    )  # fmt: skip


@part
def predictions(t, i, j, root, out):  # type: ignore[no-untyped-def]
    """Where every source point is predicted, its covariance, and whether it can be visible."""
    c1, s1, c2, s2 = rotations_of(t, i[0], i[1], j[0], j[1])
    c, s = (c1, s1) if root == 0 else (c2, s2)
    p, m = t.points, t.normals
    a, b = column(t.rays, j[0]), column(t.rays, j[1])
    X, Y, Z = column(p, i[0])
    d = (p[0, i[1]] - X, p[1, i[1]] - Y, p[2, i[1]] - Z)
    first, second, pair = solved_pair(c, s, d, a, b, t.variance[j[0]], t.variance[j[1]])
    if not (root < 2 and first > 0.0 and second > 0.0):
        return False
    if not (faces(c, s, column4(m, i[0]), a[0], a[1], a[2]) and faces(c, s, column4(m, i[1]), b[0], b[1], b[2])):
        return False
    tilt = t.tilt_variance[0]
    for k in range(out.shape[1]):
        ex, ey, ez = p[0, k] - X, p[1, k] - Y, p[2, k] - Z
        x, y, z, s11, s12, s22 = prediction(pair, ex, ey, ez)
        if tilt > 0.0:
            t11, t12, t22 = tilt_covariance(pair, ex, ey, ez, tilt)
            s11, s12, s22 = s11 + t11, s12 + t12, s22 + t22
        e, f = tangent_basis(x, y, z)
        out[0, k], out[1, k], out[2, k] = x, y, z
        out[3, k], out[4, k], out[5, k] = e
        out[6, k], out[7, k], out[8, k] = f
        out[9, k], out[10, k], out[11, k] = s11, s12, s22
        visible = faces(c, s, column4(m, k), x, y, z)
        out[12, k] = 1.0 if s11 + s22 < VAGUE2 and visible else 0.0
    return True
