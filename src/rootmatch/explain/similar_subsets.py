"""Points of a body that look like a few others of it: four LEDs of a ring, read from the other end.

A near symmetry maps much of a body onto itself. An image that shows a few points only is also explained by a pose in
which a few others lie where those do, and neither the search nor the fit need have met it.
"""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats, Integers, kept_by_values
from rootmatch.problems.pose_fit.reference_point import body_radius

TOLERANCE = 0.15
"""Difference of two distances, over the body's radius, up to which a few points may be taken for others: depths are
known to about a tenth of it where few points are seen. A round value."""
MOST = 24
"""Sets of points that look alike, those of the least differences, for each few points. A round value."""
MOST_POINTS = 64
"""Number of a body's points beyond which they are not compared."""


def twins_of_few(points: Floats, few: Integers) -> Integers:
    """For each way in which some points look like others, the point (K, n) that takes the place of each; −1 for none.

    Parameters
    ----------
    points : (n, 3) array
        All points of the body.
    few : (m,) int64 array
        Indices of three or more of them. The identity is not among the answers.
    """
    if len(points) > MOST_POINTS:
        return np.empty((0, len(points)), np.int64)
    found = _alike(points, tuple(few.tolist()))
    images = np.full((len(found), len(points)), -1, np.int64)
    images[:, few] = found
    return images


@kept_by_values(256)
def _alike(places: Floats, few: tuple[int, ...]) -> Integers:
    """Indices (K, m) of the points that look like some (m,), the most alike first."""
    between = np.linalg.norm(places[:, None] - places, axis=2)
    most = TOLERANCE * body_radius(places)
    rows, worst = np.arange(len(places))[:, None], np.zeros(len(places))
    for m in range(1, len(few)):
        # (K, n): how far each point is from being as far from those chosen as the next one is from its own
        off = np.abs(between[rows] - between[few[m], list(few[:m])][None, :, None]).max(axis=1)
        np.put_along_axis(off, rows, np.inf, axis=1)
        k, point = np.nonzero(off <= most)
        rows, worst = np.hstack([rows[k], point[:, None]]), np.maximum(worst[k], off[k, point])
    others = np.flatnonzero((rows != np.array(few)).any(axis=1))
    return rows[others[np.argsort(worst[others], kind="stable")[:MOST]]]
