"""The density of detections on the sphere about the second camera, against which a correspondence is judged."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.problems.points import TwoViews
from rootmatch.samplers.guided.detection_grid import mean_basis

LEAST_COSINE = 0.05
"""Cosine to the mean bearing below which a detection is off the plane on which densities are measured: 87°."""


def detection_density(views: TwoViews) -> NDArray[np.float64]:
    """Detections in a steradian about each (n',), were they uniform: in a second image they are all over it."""
    rotated = mean_basis(views.target) @ views.target
    ahead = rotated[2] > LEAST_COSINE
    positions, count = rotated[:2, ahead] / rotated[2, ahead], int(ahead.sum())
    # the bounding box of uniform points, corrected for being too small
    area = float(np.prod(np.ptp(positions, axis=1))) * ((count + 1) / max(count - 1, 1)) ** 2 if count > 1 else 1.0
    # an area of the plane is seen under this angle
    return np.asarray(count / max(area, 1e-12) / np.where(ahead, rotated[2], 1.0) ** 3, np.float64)
