"""Two calibrated images that share one known direction, as a search for their relative pose reads them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class TwoViews(NamedTuple):
    """Bearings of two images, each rotated so that the common direction is y.

    A bearing q of the first and p of the second image of one point fulfil λ' p = λ R(θ) q + b t, with distances
    λ, λ' > 0, a rotation about y and a baseline of length b along the unit vector t.
    """

    source: NDArray[np.float64]
    """(3, n) unit bearings of the first image."""
    target: NDArray[np.float64]
    """(3, n') unit bearings of the second image."""
    source_variance: NDArray[np.float64]
    """(n,) variance of a bearing, radians² on each axis across it; that of the direction is part of it."""
    target_variance: NDArray[np.float64]
    """(n',) variance of a bearing on each axis, without that of the direction."""
    planar: bool
    """Whether the baseline is known to be across the common direction."""
