"""Predictions from a completed up2p pair for many points at once, in loops that fill whole vectors."""

from __future__ import annotations

from rootmatch.algebra.vector import column, difference
from rootmatch.jit.decorators import part, scalar
from rootmatch.problems.kernels import STRIDE
from rootmatch.problems.limits import VAGUE2
from rootmatch.problems.up2p.prediction import prediction, rotations, solve_pair, tilt_covariance
from rootmatch.problems.up2p.quadratic import is_facing


@scalar
def point_position(flat, k):  # type: ignore[no-untyped-def]
    """Position of a point."""
    return flat[k], flat[STRIDE + k], flat[2 * STRIDE + k]


@scalar
def point_normal(flat, k):  # type: ignore[no-untyped-def]
    """Normal of a point, and the cosine of its view angle."""
    return flat[3 * STRIDE + k], flat[4 * STRIDE + k], flat[5 * STRIDE + k], flat[6 * STRIDE + k]


@part
def predict(t, flat, count, j, root, out):  # type: ignore[no-untyped-def]
    """Predicted bearings of points and their covariances; see `CompletionKernels`."""
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
