"""How crowded detections are: for their noise, and where they are predicted."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats

VAGUE = 7.5
"""Standard deviations of the noise by which the prediction of a small minimal set may miss."""
CROWDING = 1.5
"""How much denser clutter is taken to be than detections are on average.

Detections crowd about the visible object, and predictions fall there too: chance hits one more often than the mean
density says. On the safe side: it lowers the evidence of a hit.
"""


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
