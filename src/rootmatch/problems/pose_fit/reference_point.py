"""Poses and their covariances about another point of the body than its origin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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
    arm = R @ point
    x, y, z = arm.tolist()
    change = np.eye(6)
    change[3:, :3] = (0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)  # faster than `cross_matrix`, which takes many
    return t + arm, change @ covariance @ change.T
