"""Detections beside points that have no match, compiled: what `rootmatch.model.image_alike` looks at first."""

from __future__ import annotations

import math

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.model.compiled.gating import project_pose_covariance


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_near_misses(points, mode, image, errors, limits, out):  # type: ignore[no-untyped-def]
    """About the most that points without a match gain by one that is near, if all points are off by some errors.

    Parameters
    ----------
    points : tuple
        Pixels (n, 2), their Jacobian (n, 2, 6) by the pose, and that (n, 2, 3) by the points' positions.
    mode : tuple
        Assignment (n,), visibility (n,), and covariance (6, 6) of the pose.
    image : tuple
        Detections (n', 2), their σ (n',), log-density (n',) of clutter, and whether each may be a match (n',); False
        for those of the assignment afterwards.
    errors : (W,) array
        Standard deviations of a coordinate of the points, the largest last.
    limits : tuple of float
        Least visibility of a point without a match, how many σ are near, and the logarithm of the odds of a point that
        is seen.
    out : (W, n) array
        What each of them gains, 0 where nothing is near, in the first columns; filled.

    Returns
    -------
    missed, free : int
        How many points have no match, and how many detections no point; 0 points if nothing is near any.
    """
    points, mode, image, errors, out = borrow((points, mode, image, errors, out))
    pixels, jacobian, by_position = points
    assignment, visible, covariance = mode
    target, sigma, log_clutter, left = image
    hidden, reach, seen = limits
    missed, free, near, widest = 0, 0, False, errors.shape[0] - 1
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0:
            left[assignment[i]] = False
    for j in range(target.shape[0]):
        free += 1 if left[j] else 0
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0 or not visible[i] > hidden:
            continue
        for w in range(errors.shape[0]):
            out[w, missed] = 0.0
        a, _, c = project_pose_covariance(jacobian, covariance, i)
        moved = 0.0
        for row in range(2):
            for axis in range(3):
                moved += 0.5 * by_position[i, row, axis] * by_position[i, row, axis]
        for j in range(target.shape[0]):
            if not left[j]:
                continue
            x, y, own = pixels[i, 0] - target[j, 0], pixels[i, 1] - target[j, 1], sigma[j] * sigma[j]
            squared, by_pose = x * x + y * y, 1.0 + 0.5 * (a + c) / own
            for w in range(errors.shape[0]):
                wide = errors[w] * errors[w] * moved + own
                if squared < reach * reach * wide * by_pose:
                    near = near or w == widest
                    gain = seen - log_clutter[j] - math.log(2.0 * math.pi * wide)
                    out[w, missed] = max(out[w, missed], gain)
        missed += 1
    return missed if near else 0, free
