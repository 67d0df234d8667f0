"""Detections that poses of minimal sets predict in one image or in those of all cameras of a rig, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.model.compiled.evidence import LOG_2PI, inverted
from rootmatch.model.compiled.gating import deviation


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def gather(points, sources, image, limits, out):  # type: ignore[no-untyped-def]
    """What each of K poses predicts, the sightings that gain most first come first served.

    Parameters
    ----------
    points : tuple
        Pixels (K, C n, 2), jacobian (K, C n, 2, 6), and visibility (K, C n).
    sources : (K, C n) int64 array
        Detection of each of the three points that a pose is of, −1 elsewhere.
    image : tuple
        Detections (n', 2), their σ (n',), log-density (n',) of clutter, logarithms of the weights of matches (C n, n'),
        −∞ where one is not allowed, no rows if not given, and the number (n',) of the camera of each.
    limits : tuple
        Number of cameras, squared gate, detection rate, and the least visibility of a point with candidates.
    out : tuple
        Assignments (K, C n) and log-odds (K,) against clutter; filled. −∞ for a pose that its three do not determine.
    """
    points, sources, image, out = borrowed((points, sources, image, out))
    pixels, jacobian, visible = points
    target, sigma, log_clutter, log_weights, camera_of = image
    cameras, squared_gate, rate, hidden = limits
    assignments, gains = out
    n = pixels.shape[1] // cameras
    normal, covariance, factor = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    scale, used = np.empty(6), np.zeros(target.shape[0], np.bool_)
    for k in range(pixels.shape[0]):
        normal[:] = 0.0
        used[:] = False
        seen = True
        for i in range(sources.shape[1]):
            j = sources[k, i]
            assignments[k, i] = j
            if j < 0:
                continue
            used[j] = True
            seen = seen and visible[k, i] > hidden
            weight = 1.0 / (sigma[j] * sigma[j])
            for p in range(6):
                for q in range(6):
                    first = jacobian[k, i, 0, p] * jacobian[k, i, 0, q]
                    normal[p, q] += weight * (first + jacobian[k, i, 1, p] * jacobian[k, i, 1, q])
        gains[k] = -math.inf
        if not seen or not abs(inverted(normal, factor, scale, covariance)) < math.inf:
            continue
        total = 0.0
        for camera in range(cameras):
            hits, gain, missed = 0, 0.0, 0.0
            for i in range(camera * n, (camera + 1) * n):
                if not visible[k, i] > hidden:
                    continue
                chance = min(rate * visible[k, i], 0.999)
                missed += math.log1p(-chance)
                shown = math.log(chance) - math.log1p(-chance)
                if sources[k, i] >= 0:
                    hits += 1
                    gain += shown
                    continue
                a, b, c = 0.0, 0.0, 0.0
                for p in range(6):
                    first, second = 0.0, 0.0
                    for q in range(6):
                        first += covariance[p, q] * jacobian[k, i, 0, q]
                        second += covariance[p, q] * jacobian[k, i, 1, q]
                    a += jacobian[k, i, 0, p] * first
                    b += jacobian[k, i, 0, p] * second
                    c += jacobian[k, i, 1, p] * second
                a, c = max(a, 0.0), max(c, 0.0)
                best, found = 0.0, -1
                for j in range(target.shape[0]):
                    if used[j] or camera_of[j] != camera:
                        continue
                    x, y = target[j, 0] - pixels[k, i, 0], target[j, 1] - pixels[k, i, 1]
                    squared, determinant = deviation(a, b, c, sigma[j] * sigma[j], x, y)
                    value = shown - 0.5 * (squared + math.log(determinant)) - LOG_2PI - log_clutter[j]
                    if log_weights.shape[0] > 0:
                        value += log_weights[i, j]
                    if squared <= squared_gate and value > best:
                        best, found = value, j
                if found >= 0:
                    assignments[k, i], used[found] = found, True
                    gain += best
                    hits += 1
            if hits > 0:  # what a camera shows nothing of may be beyond its image
                total += gain + missed
        gains[k] = total
