"""Residuals of one assignment about a pose, compiled."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.model.compiled.projection import linearise_one


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def residual_sums(assignment, pose, body, views, image):  # type: ignore[no-untyped-def]
    """Squared deviation of detections from their images, and how far these move with the points.

    Parameters
    ----------
    assignment : (n,) int64 array
    pose : tuple
        Rotations (1, 3, 3), and positions (1, 3) of the centre.
    body, views, image : tuple
        As `rootmatch.model.compiled.settling.settle` takes them.

    Returns
    -------
    squared, moved : float
        In units of the noise: the sum of the squares, and the mean square by which a detection moves on an axis with a
        coordinate of its point.
    """
    assignment, pose, body, views, image = borrow((assignment, pose, body, views, image))
    n = assignment.shape[0]
    pixels, jacobian, by_position = np.empty((1, n, 2)), np.empty((1, n, 2, 6)), np.empty((1, n, 2, 3))
    rest = np.empty((1, n), np.bool_), np.empty((1, n)), np.empty((1, n))
    linearise_one(0, body, pose, views, (pixels, jacobian, by_position, rest[0], rest[1], rest[2]))
    target, sigma = image[0], image[1]
    squared, moved, count = 0.0, 0.0, 0
    for i in range(n):
        j = assignment[i]
        if j < 0:
            continue
        count += 1
        for row in range(2):
            off = (target[j, row] - pixels[0, i, row]) / sigma[j]
            squared += off * off
            for axis in range(3):
                by_point = by_position[0, i, row, axis] / sigma[j]
                moved += 0.5 * by_point * by_point
    return squared, moved / max(count, 1)
