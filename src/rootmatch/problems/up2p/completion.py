"""Predictions from a completed up2p pair for many points at once, in loops that fill whole vectors."""

from __future__ import annotations

from rootmatch.algebra.vector import column
from rootmatch.jit.decorators import part, scalar
from rootmatch.problems.kernels import STRIDE
from rootmatch.problems.limits import VAGUE2
from rootmatch.problems.up2p.prediction import prediction, rotations, solved_pair, tilt_covariance
from rootmatch.problems.up2p.quadratic import faces


@scalar
def normal_of(flat, k):  # type: ignore[no-untyped-def]
    """Normal of a point, and the cosine of its view angle."""
    return flat[3 * STRIDE + k], flat[4 * STRIDE + k], flat[5 * STRIDE + k], flat[6 * STRIDE + k]


@part
def predict(t, flat, count, j, root, out):  # type: ignore[no-untyped-def]
    """Predicted bearings of points and their covariances; see `CompletionKernels`."""
    a, b = column(t.rays, j[0]), column(t.rays, j[1])
    X, Y, Z = flat[0], flat[STRIDE], flat[2 * STRIDE]
    d = (flat[1] - X, flat[STRIDE + 1] - Y, flat[2 * STRIDE + 1] - Z)
    c1, s1, c2, s2 = rotations(d[0], d[1], d[2], a[0], a[1], a[2], b[0], b[1], b[2])
    c, s = (c1, s1) if root == 0 else (c2, s2)
    first, second, pair = solved_pair(c, s, d, a, b, t.variance[j[0]], t.variance[j[1]])
    if not (first > 0.0 and second > 0.0):
        return False
    if not (faces(c, s, normal_of(flat, 0), a[0], a[1], a[2]) and faces(c, s, normal_of(flat, 1), b[0], b[1], b[2])):
        return False
    for k in range(count):
        x, y, z, s11, s12, s22 = prediction(pair, flat[k] - X, flat[STRIDE + k] - Y, flat[2 * STRIDE + k] - Z)
        visible = faces(c, s, normal_of(flat, k), x, y, z)
        out[k], out[STRIDE + k], out[2 * STRIDE + k] = x, y, z
        out[3 * STRIDE + k], out[4 * STRIDE + k], out[5 * STRIDE + k] = s11, s12, s22
        out[6 * STRIDE + k] = 1.0 if s11 + s22 < VAGUE2 and visible else 0.0
    tilt = t.tilt_variance[0]
    if tilt > 0.0:
        for k in range(count):
            t11, t12, t22 = tilt_covariance(pair, flat[k] - X, flat[STRIDE + k] - Y, flat[2 * STRIDE + k] - Z, tilt)
            s11, s22 = out[3 * STRIDE + k] + t11, out[5 * STRIDE + k] + t22
            out[4 * STRIDE + k] += t12
            out[3 * STRIDE + k], out[5 * STRIDE + k] = s11, s22
            if not s11 + s22 < VAGUE2:
                out[6 * STRIDE + k] = 0.0
    return True
