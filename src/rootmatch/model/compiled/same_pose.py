"""Whether two poses are one within their covariances, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.elimination import factorise, solve_lower
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part

TINY = 1e-12
"""Added to the diagonal of a correlation of poses, which may be singular where a vertical is exact."""
ALIKE = 2.0
"""Trace of the turn between two poses, of 60°, below which they are not one whatever their covariances."""


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def is_same_pose(first, second, moved, limit):  # type: ignore[no-untyped-def]
    """Whether the step from the second pose to the first one, less another step, is within a limit.

    Parameters
    ----------
    first, second : tuple
        Rotation (3, 3), position (3,) and covariance (6, 6).
    moved : (6,) array
        A step (ω, τ) from the second pose.
    limit : float
        In standard deviations of both poses together.
    """
    first, second, moved = borrow((first, second, moved))
    return is_near(first, second, moved, limit)


@part
def is_near(first, second, moved, limit):  # type: ignore[no-untyped-def]
    """As `is_same_pose`."""
    R, place, covariance = first
    S, other, more = second
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += R[i, j] * S[i, j]
    if trace < ALIKE:
        return False
    step, scale = np.empty(6), np.empty(6)
    for i in range(3):
        # the antisymmetric part of R Sᵀ
        j, k = (i + 1) % 3, (i + 2) % 3
        step[i], step[3 + i] = 0.0, place[i] - other[i]
        for q in range(3):
            step[i] += 0.5 * (R[k, q] * S[j, q] - R[j, q] * S[k, q])
    for i in range(6):
        scale[i] = math.sqrt(covariance[i, i] + more[i, i])
        step[i] = (step[i] - moved[i]) / scale[i]
        if not abs(step[i]) < limit:  # no coordinate is farther off than all together
            return False
    root = np.empty((6, 6))
    for i in range(6):
        for j in range(i + 1):
            root[i, j] = (covariance[i, j] + more[i, j]) / (scale[i] * scale[j]) + (TINY if i == j else 0.0)
    factorise(root, 6, TINY * TINY)
    return solve_lower(root, 6, step) < limit * limit
