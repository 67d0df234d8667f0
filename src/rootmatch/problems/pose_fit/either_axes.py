"""The covariance of a prediction about a pose that is turned from it."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats

RIDGE = 1e-13
"""Added to the unit diagonal of a scaled sum, so that it has an inverse where a part of the pose is exact."""


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
