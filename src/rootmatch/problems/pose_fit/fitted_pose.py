"""A `Pose` of what a fit has found, in the frame and unit of the caller."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.arrays import Floats, Integers
from rootmatch.problems.limits import GATE
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_checks import nearest_covariance


def to_callers_frame(
    rotation: Floats, translation: Floats, covariance: Floats, *, axes: Floats, centre: Floats, unit: float
) -> tuple[Floats, Floats]:
    """Translation and covariance of a fit whose points were taken about their centre and in a unit of their own.

    ``covariance``: of rotations about the ``axes`` (a, 3), of the translation, and of what else was fitted; returned is
    that of rotations about all three axes, of the translation, and of the rest.
    """
    a, size, turned = len(axes), len(covariance), rotation @ centre
    change = np.zeros((size + 3 - a, size))
    change[:3, :a], change[3:6, a : a + 3], change[6:, a + 3 :] = axes.T, unit * np.eye(3), np.eye(size - a - 3)
    change[3:6, :a] = cross_matrix(turned) @ axes.T  # t = u t' − R c, so τ = u τ' − ω × R c
    return unit * translation - turned, change @ covariance @ change.T


def make_pose_of_fit(
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
