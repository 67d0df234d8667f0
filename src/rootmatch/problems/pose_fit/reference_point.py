"""Poses and their covariances about another point of the body than its origin, and in its axes; how large it is."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.rotation import move_along_arc
from rootmatch.arrays import Floats, cache_by_identity, cache_by_values
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver

KEPT_POINTS = 1000
"""Points of a body up to which what frame after frame asks of them is kept. A round value; it bounds memory."""

RIDGE = 1e-13
"""Added to the unit diagonal of a scaled sum, so that it has an inverse where a part of the pose is exact."""
STRAIGHT = 0.02
"""Standard deviation of a rotation, in radians, up to which what it moves goes straight on. A round value."""


def body_radius(source: Floats) -> float:
    """Root mean square distance of a body's points (n, 3) from their centre."""
    centred = source - source.sum(axis=0) / len(source)
    return math.sqrt(float(np.vdot(centred, centred)) / len(source))


def centre_points(source: Floats) -> tuple[Floats, Floats, float]:
    """Centre (3,) of a body's points (n, 3), the points about it, and their `body_radius`: shared, to be read."""
    return _kept_about_centre(source) if len(source) <= KEPT_POINTS else _compute_centred_points(source)


def _compute_centred_points(source: Floats) -> tuple[Floats, Floats, float]:
    centre = source.mean(axis=0)
    return centre, source - centre, body_radius(source)


_kept_about_centre = cache_by_identity(64)(cache_by_values(64)(_compute_centred_points))


def pose_about_point(
    R: Floats, t: Floats, covariance: Floats, point: Floats, scale: float = 1.0
) -> tuple[Floats, Floats]:
    """Position (3,) of a point of the body in the target's frame, and the covariance of the pose with it for t.

    Parameters
    ----------
    R, t : (3, 3) and (3,) float64
        x' = scale · R x + t.
    covariance : (6, 6) or (7, 7) float64
        Of a left rotation perturbation in radians, of ``t``, and of the scale where it is estimated.
    point : (3,) float64
        In the body's frame; minus the point returns from it to the origin.
    scale : float
    """
    # copies: what is read-only or of another layout is another type to a kernel
    pose = np.array(R, order="C"), np.array(t), np.array(covariance, order="C"), float(scale)
    out = np.empty(3), np.empty(covariance.shape)
    move_reference_point(pose, np.array(point), out)
    return out


def add_arc_curvature(covariance: Floats) -> Floats:
    """The covariance of a pose, with the square of what first order leaves out of where a rotation takes its position.

    A pose that is free to turn about a line has its position on an arc, τ = A ω + ½ ω × A ω: a covariance of first
    order is that of the tangent. The second term has the moments of a quadratic form of normal errors.

    Parameters
    ----------
    covariance : (6, 6) or (7, 7) float64
        Of a left rotation perturbation ω in radians, of the position, and of the scale where it is estimated.

    Returns
    -------
    (6, 6) or (7, 7) float64
        That of the same errors; the same array where rotations are known to `STRAIGHT`.
    """
    if covariance[0, 0] + covariance[1, 1] + covariance[2, 2] < STRAIGHT**2:
        return covariance
    turns = covariance[:3, :3]
    values, vectors = np.linalg.eigh(turns)
    # Gauss and Hermite's nodes on each principal axis: 0 and ± √3 σ, of which the latter weigh a sixth
    each = np.sqrt(3.0 * np.maximum(values, 0.0))[:, None] * vectors.T
    each = np.concatenate([each, -each])
    moved = each @ np.linalg.lstsq(turns, covariance[:3, 3:6])[0]
    left = (move_along_arc(each, moved) - moved) / math.sqrt(6.0)
    out = covariance.copy()
    out[3:6, 3:6] += left.T @ left
    return out


def covariance_in_either_axes(covariance: Floats, turned: Floats) -> Floats:
    """Covariance of a prediction in whose axes is uncertain whether they turn with the body.

    What earlier frames left open may turn with the body, as a rotation about a line of its points does, or stay with
    the camera, as a distance does. If it is taken to turn and does not, the next frame seems to tell it. So the
    covariance is as large as either says: A (A + B)⁻¹ A + B (A + B)⁻¹ B, which is A if both are the same, the larger
    one where they differ by far, and in between (a² + b²) / (a + b), their contraharmonic mean.

    Parameters
    ----------
    covariance, turned : (p, p) arrays
        A and B, about the same pose: with axes that stayed, and with those that turned with the body.
    """
    scale = np.sqrt(np.maximum(covariance.diagonal() + turned.diagonal(), 1e-300))
    unit = scale[:, None] * scale
    each = np.array([covariance, turned]) / unit
    inverse = np.linalg.inv(each[0] + each[1] + RIDGE * np.eye(len(scale)))
    out = (each @ inverse @ each).sum(axis=0) * unit
    return np.asarray(0.5 * (out + out.T))


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def move_reference_point(pose, point, out):  # type: ignore[no-untyped-def]
    """`pose_about_point`, compiled: R, t, covariance and scale, the point, and what they give, filled."""
    pose, point, out = borrow((pose, point, out))
    R, t, covariance, scale = pose
    moved, changed = out
    size = covariance.shape[0]
    x, y, z = scale * point[0], scale * point[1], scale * point[2]
    a = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
    b = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
    c = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    moved[0], moved[1], moved[2] = t[0] + a, t[1] + b, t[2] + c
    # S C Sᵀ, where S adds ω × arm to τ, and the arm times the relative error of the scale
    for q in range(size):
        for p in range(size):
            changed[p, q] = covariance[p, q]
        u, v, w = covariance[0, q], covariance[1, q], covariance[2, q]
        changed[3, q] += v * c - w * b
        changed[4, q] += w * a - u * c
        changed[5, q] += u * b - v * a
        if size > 6:
            longer = covariance[6, q] / scale
            changed[3, q] += longer * a
            changed[4, q] += longer * b
            changed[5, q] += longer * c
    for p in range(size):
        u, v, w = changed[p, 0], changed[p, 1], changed[p, 2]
        changed[p, 3] += v * c - w * b
        changed[p, 4] += w * a - u * c
        changed[p, 5] += u * b - v * a
        if size > 6:
            longer = changed[p, 6] / scale
            changed[p, 3] += longer * a
            changed[p, 4] += longer * b
            changed[p, 5] += longer * c
