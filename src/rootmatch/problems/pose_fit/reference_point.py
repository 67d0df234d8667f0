"""Poses and their covariances about another point of the body than its origin, and how large it is."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver


def body_radius(source: Floats) -> float:
    """Root mean square distance of a body's points (n, 3) from their centre."""
    centred = source - source.sum(axis=0) / len(source)
    return math.sqrt(float(np.vdot(centred, centred)) / len(source))


def about_point(R: Floats, t: Floats, covariance: Floats, point: Floats) -> tuple[Floats, Floats]:
    """Position (3,) of a point of the body in the camera frame, and the covariance (6, 6) of rotation and position.

    Parameters
    ----------
    R, t : (3, 3) and (3,) float64
        X_camera = R X + t.
    covariance : (6, 6) float64
        Of a left rotation perturbation in radians and of ``t``.
    point : (3,) float64
        In the body's frame; minus the point returns from it to the origin.
    """
    # copies: what is read-only or of another layout is another type to a kernel
    pose = np.array(R, order="C"), np.array(t), np.array(covariance, order="C")
    out = np.empty(3), np.empty((6, 6))
    refer(pose, np.array(point), out)
    return out


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def refer(pose, point, out):  # type: ignore[no-untyped-def]
    """`about_point`, compiled: R, t and covariance, the point, and what they give, filled."""
    pose, point, out = borrowed((pose, point, out))
    R, t, covariance = pose
    moved, changed = out
    x, y, z = point[0], point[1], point[2]
    a = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
    b = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
    c = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    moved[0], moved[1], moved[2] = t[0] + a, t[1] + b, t[2] + c
    # S C Sᵀ, where S adds ω × arm to τ
    for q in range(6):
        for p in range(6):
            changed[p, q] = covariance[p, q]
        u, v, w = covariance[0, q], covariance[1, q], covariance[2, q]
        changed[3, q] += v * c - w * b
        changed[4, q] += w * a - u * c
        changed[5, q] += u * b - v * a
    for p in range(6):
        u, v, w = changed[p, 0], changed[p, 1], changed[p, 2]
        changed[p, 3] += v * c - w * b
        changed[p, 4] += w * a - u * c
        changed[p, 5] += u * b - v * a
