"""Visibility of a body's points in a pose: in front of the camera, within the image, and facing the camera."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats

FULLY = 0.5
"""Cosine between a normal and the direction to the camera up to which a point is as visible as from its front, if no
view angle is given: that is then the same for all points, and its cosine lies anywhere below. A round value."""
EDGES = 8
"""View angles over which a mean is taken if none is given; nearer ones are hardly told apart, as `EDGE` is half of
their distance."""
BARELY = 0.02
"""Visibility, relative to that, of a point that is only just hidden: normals are not exact. A round value."""
SLACK = 0.15
"""Cosine beyond the view angle, or beyond a right angle, from which a point is not seen: five deviations of the
edge, or 9° beyond the right angle. Like that edge it is blurred by what a pose leaves open of its direction: after an
occlusion that is 15°, and a point that only the most probable pose hides may well be seen. A round value."""
UNSEEN = 1e-9
"""Visibility of such a point: less than any detection is worth."""
EDGE = 0.03
"""Standard deviation of the edge of a view angle, in cosines. A round value: 2° at 70°."""
LOGISTIC = 1.702
"""Slope of the logistic curve nearest to the normal distribution's integral: within 0.01 everywhere."""


def facing_cosines(normals: Floats | None, positions: Floats, rotation: Floats) -> Floats | None:
    """Cosines (…, n) between normals (n, 3) and the direction to the camera; NaN for a zero normal.

    ``positions`` (…, n, 3) are as seen from the camera, ``rotation`` (…, 3, 3) is the pose's. None without normals.
    """
    if normals is None:
        return None
    length = np.linalg.norm(normals, axis=1) * np.linalg.norm(positions, axis=-1)
    along = -((normals @ rotation.swapaxes(-1, -2)) * positions).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(length > 0.0, along / length, np.nan))
