"""Steps of the filter of a motion, compiled: see `rootmatch.tracking.motion_filter`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.elimination import factorise, invert_factored
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.prior_terms import combine_axes, fill_arc_motion, turn_covariance
from rootmatch.problems.pose_fit.reference_point import STRAIGHT

SMALL = 1e-6
"""Angle in radians below which the series of sine and cosine are cut after the first term."""


@part
def fill_rotation(x, y, z, turn):  # type: ignore[no-untyped-def]
    """Rotation matrix (3, 3) of a rotation vector."""
    angle = math.sqrt(x * x + y * y + z * z)
    s, c = 1.0, 0.5
    if angle > SMALL:
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    turn[1, 0], turn[1, 1], turn[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    turn[2, 0], turn[2, 1], turn[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)


@part
def carry_covariance(matrix, F, turn, out):  # type: ignore[no-untyped-def]
    """Transpose of the transition times a matrix (p + 12, p + 12), into ``out``; twice, that of a covariance."""
    rows = matrix.shape[0]
    first = rows - 12
    for column in range(rows):
        for i in range(6):
            now = matrix[i, column]
            if i < 3:
                now = turn[i, 0] * matrix[0, column] + turn[i, 1] * matrix[1, column] + turn[i, 2] * matrix[2, column]
            for p in range(3):
                change = F[p, 1] * matrix[first + i, column] + F[p, 2] * matrix[first + 6 + i, column]
                out[column, i if p == 0 else first - 6 + 6 * p + i] = F[p, 0] * now + change
        for i in range(6, first):
            out[column, i] = matrix[i, column]


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def move_ahead(transition, added, state, out):  # type: ignore[no-untyped-def]
    """A later state.

    The p rows of a pose are those of its covariance, see `rootmatch.problems.pose_fit.pose.Pose`; the first six move.

    Parameters
    ----------
    transition, added : (3, 3) arrays
        Of position, velocity and acceleration, and the covariance that an acceleration of unit variance adds.
    state : tuple
        Rotation (3, 3), position (3,), velocity with acceleration (12,), the covariance (p + 12, p + 12) of pose and
        motion, and variances (p,): of the acceleration, and what is added to those of the other rows of the pose.
    out : tuple
        The first four of these, filled.
    """
    F, added, state, out = borrow((transition, added, state, out))
    R, t, motion, P, variances = state
    turned, moved, faster, covariance = out
    turn, half, first = np.empty((3, 3)), np.empty(P.shape), P.shape[0] - 12
    for i in range(6):
        velocity, acceleration = motion[i], motion[6 + i]
        faster[i] = F[1, 1] * velocity + F[1, 2] * acceleration
        faster[6 + i] = F[2, 1] * velocity + F[2, 2] * acceleration
        if i >= 3:
            moved[i - 3] = t[i - 3] + F[0, 1] * velocity + F[0, 2] * acceleration
    x = F[0, 1] * motion[0] + F[0, 2] * motion[6]
    y = F[0, 1] * motion[1] + F[0, 2] * motion[7]
    z = F[0, 1] * motion[2] + F[0, 2] * motion[8]
    fill_rotation(x, y, z, turn)
    for i in range(3):
        for j in range(3):
            turned[i, j] = turn[i, 0] * R[0, j] + turn[i, 1] * R[1, j] + turn[i, 2] * R[2, j]
    carry_covariance(P, F, turn, half)
    carry_covariance(half, F, turn, covariance)
    for p in range(3):
        for q in range(3):
            row, column = (0 if p == 0 else first - 6 + 6 * p), (0 if q == 0 else first - 6 + 6 * q)
            for i in range(6):
                covariance[row + i, column + i] += added[p, q] * variances[i]
    for i in range(6, first):
        covariance[i, i] += variances[i]


@part
def bend_step(P, step, along, out):  # type: ignore[no-untyped-def]
    """A predicted covariance as it is where a step (p,) takes the body, into ``out``, and the step ``along`` its arc.

    What its points leave open may stay as it is in the body's frame, or in the camera's: it is in either, see
    `rootmatch.problems.pose_fit.reference_point.covariance_in_either_axes`.
    """
    rows, size = P.shape[0], step.shape[0]
    for i in range(rows):
        for j in range(rows):
            out[i, j] = P[i, j]
    for i in range(size):
        along[i] = step[i]
    if P[0, 0] + P[1, 1] + P[2, 2] < STRAIGHT * STRAIGHT:
        return
    fill_arc_motion(along)
    turn, turned = np.empty((3, 3)), np.empty((rows, rows))
    fill_rotation(step[0], step[1], step[2], turn)
    turn_covariance(P, turn, size, turned)
    combine_axes(P, turned, np.empty((rows, rows)), np.empty(rows), out)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def take_pose(before, step, fitted, out):  # type: ignore[no-untyped-def]
    """The motion and its covariance after a pose whose fit includes its prediction.

    Parameters
    ----------
    before : tuple
        Velocity with acceleration (12,), and the covariance (p + 12, p + 12) of pose and motion.
    step : (p,) array
        From the predicted pose to the fitted one.
    fitted : (p, p) array
        Covariance of that.
    out : tuple
        As ``before``, the inverse (p, p) of the covariance of the predicted pose, and the covariance before that step,
        about where it leads: see `bend_step`; filled.

    Returns
    -------
    left, squared : float
        How many of the p variances are left, and the χ² of the step.
    """
    before, step, fitted, out = borrow((before, step, fitted, out))
    motion, given = before
    faster, covariance, inverse, P = out
    size, straight = step.shape[0], step
    step = np.empty(size)
    bend_step(given, straight, step, P)
    root = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            root[i, j] = P[i, j]
    factorise(root, size, 1e-300)
    invert_factored(root, size, inverse)
    gain, removed = np.empty((12, size)), np.empty((12, size))
    left, squared = 0.0, 0.0
    for p in range(size):
        for q in range(size):
            left += fitted[p, q] * inverse[q, p]
            squared += step[p] * inverse[p, q] * step[q]
            covariance[p, q] = fitted[p, q]
    for i in range(12):
        faster[i] = motion[i]
        for p in range(size):
            gain[i, p] = 0.0
            for q in range(size):
                gain[i, p] += P[size + i, q] * inverse[q, p]
            faster[i] += gain[i, p] * step[p]
    for i in range(12):
        for p in range(size):
            of_pose, removed[i, p] = 0.0, 0.0
            for q in range(size):
                of_pose += gain[i, q] * fitted[q, p]
                removed[i, p] += gain[i, q] * (P[q, p] - fitted[q, p])
            covariance[size + i, p] = covariance[p, size + i] = of_pose
        for j in range(i + 1):
            rest = 0.5 * (P[size + i, size + j] + P[size + j, size + i])
            for p in range(size):
                rest -= 0.5 * (removed[i, p] * gain[j, p] + removed[j, p] * gain[i, p])
            covariance[size + i, size + j] = covariance[size + j, size + i] = rest
    return left, squared
