"""Residuals and Jacobians in units of a noise that the sightings of a point share, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import part


@part
def whitening_scratch(images):  # type: ignore[no-untyped-def]
    """What `whiten_one` writes into, for so many images."""
    size = 2 * images
    return np.empty((size, size)), np.empty((size, 3)), np.empty((size, 3)), np.empty(images, np.int64)


@part
def whiten_one(k, pose, assignments, at, image, spread, scratch, white):  # type: ignore[no-untyped-def]
    """The matches of the k-th assignment (C n,) in one of some poses, whitened: by the Cholesky factors of S.

    S are the covariances of all sightings of a point, J Σ Jᵀ beside those of the detections.

    Parameters
    ----------
    k, pose : int
    assignments : (K, C n) int64 array
    at : tuple
        Of `rootmatch.model.linearised.Linearised`: pixels, jacobian, by_position and rotation.
    image : tuple
        As `rootmatch.model.compiled.evidence.weigh` takes it.
    spread : tuple
        Covariances of the points (n, 3, 3) in the body's frame and of the detections (n', 2, 2), px², in the place of
        their σ; each without rows if there are none.
    scratch : tuple
        Of `whitening_scratch`.
    white : tuple
        Jacobians (K, C n, 2, 6), residuals (K, C n, 2) and ½ log |S| (K, C n), by which `weigh_one` goes; those of the
        matches are filled.
    """
    pixels, jacobian, by_position, rotation = at
    target, sigma = image[0], image[1]
    of_points, of_detections = spread
    factor, by_point, turned, sightings = scratch
    rows, residuals, log_spreads = white
    count = assignments.shape[1] // sightings.shape[0]
    for point in range(count):
        seen = 0
        for camera in range(sightings.shape[0]):
            if assignments[k, camera * count + point] >= 0:
                sightings[seen] = camera * count + point
                seen += 1
        for r in range(2 * seen):
            i, q = sightings[r // 2], r % 2
            j = assignments[k, i]
            if of_points.shape[0] > 0:
                for b in range(3):
                    by_point[r, b] = 0.0
                    for a in range(3):
                        by_point[r, b] += by_position[pose, i, q, a] * rotation[pose, a, b]
                for b in range(3):
                    turned[r, b] = 0.0
                    for a in range(3):
                        turned[r, b] += by_point[r, a] * of_points[point, a, b]
            for t in range(r + 1):
                value = 0.0
                if of_points.shape[0] > 0:
                    for b in range(3):
                        value += turned[r, b] * by_point[t, b]
                if t // 2 == r // 2:
                    if of_detections.shape[0] > 0:
                        value += of_detections[j, q, t % 2]
                    elif t == r:
                        value += sigma[j] * sigma[j]
                for u in range(t):
                    value -= factor[r, u] * factor[t, u]
                factor[r, t] = math.sqrt(max(value, 1e-300)) if t == r else value / factor[t, t]
            residual = target[j, q] - pixels[pose, i, q]
            for u in range(r):
                residual -= factor[r, u] * residuals[k, sightings[u // 2], u % 2]
            residuals[k, i, q] = residual / factor[r, r]
            for a in range(6):
                value = jacobian[pose, i, q, a]
                for u in range(r):
                    value -= factor[r, u] * rows[k, sightings[u // 2], u % 2, a]
                rows[k, i, q, a] = value / factor[r, r]
            log_spreads[k, i] = math.log(factor[r, r]) + (0.0 if q == 0 else log_spreads[k, i])
