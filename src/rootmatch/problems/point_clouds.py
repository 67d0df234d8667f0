"""Two point sets of one space, as a search for the motion between them reads them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class PointClouds(NamedTuple):
    """Points x and x' = scale · R x + t, both noisy."""

    source: NDArray[np.float64]
    """(n, k) points, k = 2 or 3."""
    target: NDArray[np.float64]
    """(n', k) points."""
    source_variance: NDArray[np.float64]
    """(n,) variance of a coordinate."""
    target_variance: NDArray[np.float64]
    """(n',) variance of a coordinate."""
    scaled: bool
    """Whether the scale is unknown; 1 otherwise."""
    mirror: bool
    """Whether R may be a reflection: in a plane, where that is asked for."""
