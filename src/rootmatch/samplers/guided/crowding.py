"""How crowded detections are: for their noise, and where they are predicted."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.cameras.stereographic import Stereographic

VAGUE = 7.5
"""Standard deviations of the noise by which the prediction of a small minimal set may miss."""
CROWDING = 1.5
"""How much denser clutter is taken to be than detections are on average.

Detections crowd about the visible object, and predictions fall there too: chance hits one more often than the mean
density says. On the safe side: it lowers the evidence of a hit.
"""
MIN_COSINE = 0.05
"""Cosine to the mean bearing below which a detection is off the plane on which a uniform density is measured: 87°."""


def crowding(rays: Floats, sigma: Floats) -> float:
    """Number of other detections within reach of a vague prediction of one.

    The mean over the more crowded half of them, since clutter is mostly elsewhere.

    Parameters
    ----------
    rays : (n', 3) array
        Unit rays of the detections.
    sigma : (n',) array
        Their standard deviations in radians.
    """
    if len(rays) < 2:
        return 0.0
    from scipy.spatial import cKDTree  # slow to import, and only large objects need it

    reach = VAGUE * float(np.median(sigma))
    others = cKDTree(rays).query_ball_point(rays, reach, return_length=True) - 1
    return float(np.sort(others)[len(others) // 2 :].mean())


def uniform_density(rays: Floats) -> Floats:
    """Detections in a steradian about each (n',), were they uniform: in a second image they are all over it.

    ``rays``: (3, n') unit rays.
    """
    rotated = Stereographic.about(rays.T).basis @ rays
    ahead = rotated[2] > MIN_COSINE
    positions, count = rotated[:2, ahead] / rotated[2, ahead], int(ahead.sum())
    # the bounding box of uniform points, corrected for being too small
    area = float(np.prod(np.ptp(positions, axis=1))) * ((count + 1) / max(count - 1, 1)) ** 2 if count > 1 else 1.0
    # an area of the plane is seen under this angle
    return np.asarray(count / max(area, 1e-12) / np.where(ahead, rotated[2], 1.0) ** 3, np.float64)
