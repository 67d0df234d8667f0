"""The covariance of a prediction about a pose that is turned from it."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats


def in_either_axes(covariance: Floats, turned: Floats) -> Floats:
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
    first, second = covariance / unit, turned / unit
    both = np.linalg.pinv(first + second, hermitian=True)
    out = (first @ both @ first + second @ both @ second) * unit
    return np.asarray(0.5 * (out + out.T))
