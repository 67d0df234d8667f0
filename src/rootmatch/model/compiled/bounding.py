"""The covariance of a predicted pose as its density takes it, compiled: see `rootmatch.model.pose_density.Gaussian`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.model.compiled.evidence import inverted


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def bound(covariance, position, least, out):  # type: ignore[no-untyped-def]
    """A covariance (6, 6) that is no more certain than ``least`` in any direction, and its inverse, into ``out``.

    Parameters
    ----------
    covariance, position : (6, 6) and (3,) arrays
        Of a pose; the distance is the unit of its translations.
    least : float
        Standard deviation.
    out : tuple
        Two arrays (6, 6), filled.

    Returns
    -------
    float
        Logarithm of the determinant.
    """
    covariance, position, out = borrowed((covariance, position, out))
    bounded, precision = out
    squared = position[0] * position[0] + position[1] * position[1] + position[2] * position[2]
    distance = max(math.sqrt(squared), 1e-300)
    scale, scratch = np.empty(6), np.empty(6)
    for i in range(6):
        floor = least if i < 3 else least * distance
        scale[i] = math.sqrt(max(covariance[i, i], floor * floor))
    for i in range(6):
        for j in range(6):
            bounded[i, j] = covariance[i, j]
        bounded[i, i] += least * scale[i] * scale[i]
    return inverted(bounded, np.empty((6, 6)), scratch, precision)
