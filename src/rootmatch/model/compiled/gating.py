"""Detections about the predicted images of points, compiled: what `rootmatch.model.prediction` assigns by."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.assigning import fill_assignment
from rootmatch.model.compiled.evidence import LOG_2PI


@part
def project_pose_covariance(jacobian, covariance, i):  # type: ignore[no-untyped-def]
    """Covariance (a, b; b, c) of the pixel of point i by that of the pose (6, 6)."""
    a, b, c = 0.0, 0.0, 0.0
    for p in range(6):
        first, second = 0.0, 0.0
        for q in range(6):
            first += covariance[p, q] * jacobian[i, 0, q]
            second += covariance[p, q] * jacobian[i, 1, q]
        a += jacobian[i, 0, p] * first
        b += jacobian[i, 0, p] * second
        c += jacobian[i, 1, p] * second
    return a, b, c


@part
def squared_mahalanobis(a, b, c, variance, x, y):  # type: ignore[no-untyped-def]
    """χ² and determinant of a detection (x, y) off a prediction of the covariance (a, b; b, c).

    All terms are nonnegative: the determinant of a spread of rank one, far wider than the noise, is pure rounding error
    of either sign.
    """
    determinant = max(a * c - b * b, 0.0) + variance * (a + c + variance)
    across = max(c * x * x - 2.0 * b * x * y + a * y * y, 0.0)
    return (across + variance * (x * x + y * y)) / determinant, determinant


@part
def add_covariance(a, b, c, known, k):  # type: ignore[no-untyped-def]
    """The covariance (a, b; b, c) of a pixel with the k-th of some others (m, 2, 2), if there are any."""
    if known.shape[0] > 0:
        return a + known[k, 0, 0], b + known[k, 0, 1], c + known[k, 1, 1]
    return a, b, c


@part
def fill_gates(points, covariance, image, limits, out):  # type: ignore[no-untyped-def]
    """As `gate`."""
    pixels, jacobian, of_points, visible = points
    target, sigma, blur, log_clutter, log_weights = image
    squared_gate, rate, hidden = limits
    candidates, gains, assignment = out
    unique = True
    owner = np.full(target.shape[0], -1, np.int64)
    for i in range(pixels.shape[0]):
        assignment[i] = -1
        a, b, c = project_pose_covariance(jacobian, covariance, i)
        a, b, c = add_covariance(a, b, c, of_points, i)
        a, c = max(a, 0.0), max(c, 0.0)
        chance = min(rate * visible[i], 0.999)
        shown = math.log(chance) - math.log1p(-chance)
        seen = visible[i] > hidden
        for j in range(target.shape[0]):
            x, y = target[j, 0] - pixels[i, 0], target[j, 1] - pixels[i, 1]
            spread = add_covariance(a, b, c, blur, j)
            squared, determinant = squared_mahalanobis(*spread, sigma[j] * sigma[j], x, y)
            gain = shown - 0.5 * (squared + math.log(determinant)) - LOG_2PI - log_clutter[j]
            near = seen and squared <= squared_gate
            if log_weights.shape[0] > 0:
                gain += log_weights[i, j]
                near = near and log_weights[i, j] > -math.inf
            candidates[i, j], gains[i, j] = near, gain
            if near and gain > 0.0:
                if assignment[i] >= 0 or owner[j] >= 0:
                    unique = False
                assignment[i], owner[j] = j, i
    if not unique:
        fill_assignment(candidates, gains, assignment)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def gate(points, covariance, image, limits, out):  # type: ignore[no-untyped-def]
    """Candidates about one pose, and what each gains as a match.

    Parameters
    ----------
    points : tuple
        Pixels (n, 2), jacobian (n, 2, 6), their covariances (n, 2, 2) by the model points, empty if exact, and
        visibility (n,).
    covariance : (6, 6) array
        Of the pose.
    image : tuple
        Detections (n', 2), their σ (n',) and what their covariances have beyond it (n', 2, 2), empty if nothing;
        log-density (n',) of clutter, and logarithms of the weights of matches (n, n'), −∞ where one is not allowed,
        empty if not given.
    limits : tuple of float
        Squared gate, the detection rate, and the least visibility of a point with candidates.
    out : tuple
        Candidates (n, n') bool, gains (n, n'), and the most probable one-to-one assignment (n,) of independent pairs;
        filled.
    """
    points, image, out, covariance = borrow((points, image, out, covariance))
    fill_gates(points, covariance, image, limits, out)
