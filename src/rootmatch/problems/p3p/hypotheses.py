"""Proposals of the perspective three-point problem: a triple's solutions carry every other point into the camera."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import cross
from rootmatch.jit.decorators import part, scalar
from rootmatch.problems.p3p.joint import (
    VAGUE2,
    affine_coordinates,
    affine_frame,
    looks_back,
    predict,
    solution_frame,
    triple_faces,
)
from rootmatch.problems.p3p.roots import ratio_pairs, solve_all


def coordinates(t, sets, others):  # type: ignore[no-untyped-def]
    """Affine coordinates in each triple's frame of the other points, of their normals and of its own normals."""
    points, normals = t.points.T, t.normals.T
    origin = points[sets[:, 0]]
    e, f = points[sets[:, 1]] - origin, points[sets[:, 2]] - origin
    across = np.cross(e, f)
    with np.errstate(divide="ignore", invalid="ignore"):  # points on one line: nothing is found at infinity
        across2 = 1.0 / (across * across).sum(axis=1)
        ee, ff, ef = (e * e).sum(axis=1) * across2, (f * f).sum(axis=1) * across2, (e * f).sum(axis=1) * across2
        # rows: α, β, γ of a difference to the origin
        frame = np.stack(
            [
                ff[:, None] * e - ef[:, None] * f,
                ee[:, None] * f - ef[:, None] * e,
                across * across2[:, None],
            ],
            axis=2,
        )
        place = (points[others] - origin[:, None]) @ frame
        return np.concatenate([place, normals[others] @ frame], axis=2), normals[sets] @ frame


@part
def solve(t, i, j, scratch):  # type: ignore[no-untyped-def]
    """Depth ratios x = b/a and y = c/a at the four roots for every third image."""
    s = t.distance2
    h = t.versine
    A, B, C = s[i[0], i[1]], s[i[1], i[2]], s[i[0], i[2]]
    solve_all(A, B, C, h[j[0], j[1]], h[j[1]], h[j[0]], scratch)


@scalar
def known(t, raster, i, j):  # type: ignore[no-untyped-def]
    """|ab|², the versine between the bearings of a and b, and these bearings in the raster's basis."""
    u = raster.rays  # a solution does not depend on how the camera is turned
    return (
        t.distance2[i[0], i[1]], t.versine[j[0], j[1]],
        u[0, j[0]], u[1, j[0]], u[2, j[0]], u[0, j[1]], u[1, j[1]], u[2, j[1]],
    )  # fmt: skip


@scalar
def hypothesis(t, raster, before, last, scratch, root):  # type: ignore[no-untyped-def]
    """The triple as the camera has it at one root: point a, the vectors to b and to c, and their product."""
    A, h, ax, ay, az, bx, by, bz = before
    x, y = scratch[2 * root, last], scratch[2 * root + 1, last]
    u = raster.rays
    depth = np.sqrt(A / ((x - 1.0) * (x - 1.0) + 2.0 * h * x))
    ox, oy, oz = depth * ax, depth * ay, depth * az
    depth_b, depth_c = depth * x, depth * y
    ex, ey, ez = depth_b * bx - ox, depth_b * by - oy, depth_b * bz - oz
    fx, fy, fz = depth_c * u[0, last] - ox, depth_c * u[1, last] - oy, depth_c * u[2, last] - oz
    gx, gy, gz = cross(ex, ey, ez, fx, fy, fz)
    return (x > 0.0) & (y > 0.0), (ox, oy, oz, ex, ey, ez, fx, fy, fz, gx, gy, gz)


@part
def predictions(t, i, j, root, out):  # type: ignore[no-untyped-def]
    """Where every source point must be seen, its covariance, and whether it can be seen."""
    s = t.distance2
    h = t.versine
    u = t.rays
    A = s[i[0], i[1]]
    hab = h[j[0], j[1]]
    ratios = ratio_pairs(A, s[i[1], i[2]], s[i[0], i[2]], hab, h[j[1], j[2]], h[j[0], j[2]])
    x, y = ratios[0], ratios[1]
    for r in range(1, 4):
        if root == r:
            x, y = ratios[2 * r], ratios[2 * r + 1]
    if not (x > 0.0 and y > 0.0):
        return False
    ax, ay, az = u[0, j[0]], u[1, j[0]], u[2, j[0]]
    bx, by, bz = u[0, j[1]], u[1, j[1]], u[2, j[1]]
    cx, cy, cz = u[0, j[2]], u[1, j[2]], u[2, j[2]]
    affine = affine_frame(t, i[0], i[1], i[2])
    frame = solution_frame(A, x, y, hab, ax, ay, az, bx, by, bz, cx, cy, cz)
    if not triple_faces(t, affine, frame, i, ax, ay, az, bx, by, bz, cx, cy, cz):
        return False
    va, vb, vc = t.variance[j[0]], t.variance[j[1]], t.variance[j[2]]
    for d in range(out.shape[1]):
        alpha, beta, gamma = affine_coordinates(affine, t.points[0, d], t.points[1, d], t.points[2, d])
        (
            out[0, d], out[1, d], out[2, d], out[3, d], out[4, d], out[5, d],
            out[6, d], out[7, d], out[8, d], out[9, d], out[10, d], out[11, d],
        ) = predict(alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz, va, vb, vc)  # fmt: skip
        hidden = looks_back(t, affine, frame, d, out[0, d], out[1, d], out[2, d]) > 0.0
        out[12, d] = 1.0 if out[9, d] + out[11, d] < VAGUE2 and not hidden else 0.0
    return True
