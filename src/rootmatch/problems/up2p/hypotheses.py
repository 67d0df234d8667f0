"""Hypotheses of the upright two-point problem: a pair's rotation and depths carry every other point into the camera."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import (
    column,
    column4,
    combination,
    difference,
    rotate_vector_about_y,
    scale_vector,
    tangent_basis,
)
from rootmatch.jit.decorators import part, scalar
from rootmatch.problems.kernels import STRIDE
from rootmatch.problems.limits import VAGUE2
from rootmatch.problems.p3p.prediction import store_prediction
from rootmatch.problems.up2p.prediction import depths, prediction, rotations, solve_pair, tilt_covariance
from rootmatch.problems.up2p.quadratic import is_facing


def coordinates(t, sets, others):  # type: ignore[no-untyped-def]
    """Differences of the other points to each pair's first, and the normals as they are."""
    rows = np.concatenate([t.points.T, t.normals.T], axis=1)  # with their cosines
    every = np.concatenate([t.points, t.normals])[:, others]
    every[:3] -= t.points[:, sets[:, 0], None]
    return np.ascontiguousarray(every.swapaxes(0, 1)), np.ascontiguousarray(rows[sets, 3:])


@part
def solve(t, i, j, scratch):  # type: ignore[no-untyped-def]
    """Both rotations for every second image."""
    u = t.rays
    # read before the loop, which would not vectorise if it read them
    between, a = difference(column(t.points, i[1]), column(t.points, i[0])), column(u, j[0])
    for k in range(scratch.shape[1]):
        scratch[0, k], scratch[1, k], scratch[2, k], scratch[3, k] = rotations(between, a, column(u, k))


@scalar
def known(t, grid, i, j):  # type: ignore[no-untyped-def]
    """The pair's difference, the first point's bearing, in the grid's basis too, and that basis."""
    b = grid.basis
    between = difference(column(t.points, i[1]), column(t.points, i[0]))
    return between, column(t.rays, j[0]), column(grid.rays, j[0]), column(b, 0), column(b, 1), column(b, 2)


@scalar
def hypothesis(t, grid, before, last, scratch, root):  # type: ignore[no-untyped-def]
    """The first point and the three rotated axes of the world in the camera at one root."""
    between, a, ray, x, y, z = before
    two = 2 * (root & 1)
    c, s = scratch[two, last], scratch[two + 1, last]
    first, second = depths(a, column(t.rays, last), rotate_vector_about_y(c, s, between))
    # comparisons with NaN are false
    return (
        (root < 2) & (first > 0.0) & (second > 0.0),
        scale_vector(first, ray) + combination(c, x, -s, z) + y + combination(s, x, c, z),
    )


@part
def predictions(t, i, j, root, out):  # type: ignore[no-untyped-def]
    """Where every source point is predicted, its covariance, and whether it can be visible."""
    p, m = t.points, t.normals
    a, b, origin = column(t.rays, j[0]), column(t.rays, j[1]), column(p, i[0])
    between = difference(column(p, i[1]), origin)
    c1, s1, c2, s2 = rotations(between, a, b)
    c, s = (c1, s1) if root == 0 else (c2, s2)
    first, second, pair = solve_pair(c, s, between, a, b, t.variance[j[0]], t.variance[j[1]])
    if not (root < 2 and first > 0.0 and second > 0.0):
        return False
    if not (is_facing(c, s, column4(m, i[0]), a) and is_facing(c, s, column4(m, i[1]), b)):
        return False
    tilt = t.tilt_variance[0]
    for k in range(out.shape[1]):
        e = difference(column(p, k), origin)
        bearing, (s11, s12, s22) = prediction(pair, e)
        if tilt > 0.0:
            t11, t12, t22 = tilt_covariance(pair, e, tilt)
            s11, s12, s22 = s11 + t11, s12 + t12, s22 + t22
        one, two = tangent_basis(bearing[0], bearing[1], bearing[2])
        store_prediction((bearing, one, two, (s11, s12, s22)), out, k)
        out[12, k] = 1.0 if s11 + s22 < VAGUE2 and is_facing(c, s, column4(m, k), bearing) else 0.0
    return True


@scalar
def point_position(flat, k):  # type: ignore[no-untyped-def]
    """Position of a point."""
    return flat[k], flat[STRIDE + k], flat[2 * STRIDE + k]


@scalar
def point_normal(flat, k):  # type: ignore[no-untyped-def]
    """Normal of a point, and the cosine of its view angle."""
    return flat[3 * STRIDE + k], flat[4 * STRIDE + k], flat[5 * STRIDE + k], flat[6 * STRIDE + k]


@part
def complete(t, flat, count, j, root, out):  # type: ignore[no-untyped-def]
    """Predicted bearings of many points at once, in loops that fill whole vectors; see `CompletionKernels.predict`."""
    a, b = column(t.rays, j[0]), column(t.rays, j[1])
    origin = point_position(flat, 0)
    between = difference(point_position(flat, 1), origin)
    c1, s1, c2, s2 = rotations(between, a, b)
    c, s = (c1, s1) if root == 0 else (c2, s2)
    first, second, pair = solve_pair(c, s, between, a, b, t.variance[j[0]], t.variance[j[1]])
    if not (first > 0.0 and second > 0.0):
        return False
    if not (is_facing(c, s, point_normal(flat, 0), a) and is_facing(c, s, point_normal(flat, 1), b)):
        return False
    for k in range(count):
        bearing, (s11, s12, s22) = prediction(pair, difference(point_position(flat, k), origin))
        visible = is_facing(c, s, point_normal(flat, k), bearing)
        out[k], out[STRIDE + k], out[2 * STRIDE + k] = bearing
        out[3 * STRIDE + k], out[4 * STRIDE + k], out[5 * STRIDE + k] = s11, s12, s22
        out[6 * STRIDE + k] = 1.0 if s11 + s22 < VAGUE2 and visible else 0.0
    tilt = t.tilt_variance[0]
    if tilt > 0.0:
        for k in range(count):
            t11, t12, t22 = tilt_covariance(pair, difference(point_position(flat, k), origin), tilt)
            s11, s22 = out[3 * STRIDE + k] + t11, out[5 * STRIDE + k] + t22
            out[4 * STRIDE + k] += t12
            out[3 * STRIDE + k], out[5 * STRIDE + k] = s11, s22
            if not s11 + s22 < VAGUE2:
                out[6 * STRIDE + k] = 0.0
    return True
