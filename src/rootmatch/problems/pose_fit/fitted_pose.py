"""A `Pose` of what a fit has found."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.problems.limits import GATE
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_checks import nearest_covariance

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def fitted_pose(
    R: Floats,
    t: Floats,
    covariance: Floats,
    *,
    chi2: float,
    dof: int,
    points: Integers,
    predicted: Floats,
    residuals: Floats,
    sigma: Floats,
    scale: float = 1.0,
    focal: float | None = None,
) -> Pose:
    """A pose with what its fit says; ``sigma`` (m,) of each of the residuals on one axis."""
    return Pose(
        R,
        t,
        nearest_covariance(covariance),
        scale=scale,
        focal=focal,
        chi2=chi2,
        dof=dof,
        rms=float(np.sqrt((residuals**2).mean())),
        rms_sigma=float(np.sqrt(chi2 / dof)) if dof > 0 else float("nan"),
        points=points,
        predicted=predicted,
        residuals=residuals,
        inliers=points[residuals <= GATE * sigma],
        mirrored=bool(np.linalg.det(R) < 0.0),
    )
