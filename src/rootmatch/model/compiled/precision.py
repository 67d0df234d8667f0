"""The precision of a predicted pose, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.model.compiled.evidence import LOG_2PI, inverted


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def invert_prediction(covariance, position, exact, out):  # type: ignore[no-untyped-def]
    """Logarithm of √|2πC| of the covariance C of a pose, which is bounded from below.

    Parameters
    ----------
    covariance : (6, 6) array
    position : (3,) array
    exact : float
        Least standard deviation: in radians, relative to the distance, and relative to other directions.
    out : tuple
        Bounded covariance and its inverse, (6, 6) each; filled.
    """
    covariance, position, out = borrowed((covariance, position, out))
    bounded, inverse = out
    scale = np.empty(6)
    distance2 = position[0] * position[0] + position[1] * position[1] + position[2] * position[2]
    distance = max(math.sqrt(distance2), 1e-300)
    for p in range(6):
        least = exact * (1.0 if p < 3 else distance)
        scale[p] = math.sqrt(max(covariance[p, p], least * least))
    for p in range(6):
        for q in range(6):
            bounded[p, q] = covariance[p, q]
        bounded[p, p] += exact * scale[p] * scale[p]
    return 0.5 * (6.0 * LOG_2PI + inverted(bounded, np.empty((6, 6)), scale, inverse))
