"""Kalman updates of a prediction with single correspondences, compiled: see `rootmatch.model.prediction`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.evidence import LOG_2PI
from rootmatch.model.compiled.gating import add_covariance, project_pose_covariance, squared_mahalanobis

HIGHEST = 700.0
"""Logarithm of the largest ratio of densities: that of what is far beyond any doubt, and still a number."""


@part
def predict_pixel(jacobian, of_points, about, i):  # type: ignore[no-untyped-def]
    """Shift of the pixel of point i by a step, and its covariance (a, b; b, c) by that of the pose and the point's."""
    step, covariance = about
    u, v = 0.0, 0.0
    for p in range(6):
        u += jacobian[i, 0, p] * step[p]
        v += jacobian[i, 1, p] * step[p]
    a, b, c = add_covariance(*project_pose_covariance(jacobian, covariance, i), of_points, i)
    return u, v, a, b, c


@part
def explained_log_odds(points, about, image, shown, gains):  # type: ignore[no-untyped-def]
    """Log-odds of the points that are ``shown``, each with its likeliest detection: see `update_with_each`.

    ``gains`` (n',) become the most that a point gains by each detection.
    """
    pixels, jacobian, of_points, chance = points
    target, sigma, blur, log_clutter, log_weights = image
    score = 0.0
    for j in range(gains.shape[0]):
        gains[j] = 0.0
    for i in range(pixels.shape[0]):
        if not shown[i]:
            continue
        u, v, a, b, c = predict_pixel(jacobian, of_points, about, i)
        a, c = max(a, 0.0), max(c, 0.0)
        odds = math.log(max(chance[i], 1e-300)) - math.log(1.0 - chance[i])
        best, log_determinant, last = -math.inf, 0.0, -1.0
        for j in range(target.shape[0]):
            if log_weights.shape[0] > 0 and not log_weights[i, j] > -math.inf:
                continue
            variance = sigma[j] * sigma[j]
            x, y = target[j, 0] - pixels[i, 0] - u, target[j, 1] - pixels[i, 1] - v
            squared, determinant = squared_mahalanobis(*add_covariance(a, b, c, image[2], j), variance, x, y)
            # most images have one σ, and a logarithm takes longer than all the rest
            if variance != last or blur.shape[0] > 0:
                log_determinant, last = math.log(determinant), variance
            value = -0.5 * (squared + log_determinant) - LOG_2PI - log_clutter[j]
            best, gains[j] = max(best, value), max(gains[j], value + odds)
        score += math.log(1.0 - chance[i] + chance[i] * math.exp(min(best, HIGHEST)))
    return score


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def choose_pairs(points, about, image, candidates, limits, out):  # type: ignore[no-untyped-def]
    """Candidates of the points that tell most and cost least, as pairs.

    Parameters
    ----------
    points : tuple
        Pixels (n, 2), jacobian (n, 2, 6), their covariances (n, 2, 2) by the model points, empty if exact, and the
        chance (n,) that each is detected.
    about : tuple
        Step (6,) to the mean of the prediction, and its covariance (6, 6).
    image : tuple
        As for `rootmatch.model.compiled.gating.gate`.
    candidates : (n, n') bool array
        About the first prediction.
    limits : tuple
        Squared gate, and how many pairs are tried; of one point at least.
    out : (P, 2) int64 array
        Point and detection of each pair, P no smaller than that number and n'; filled.

    Returns
    -------
    int
        How many pairs there are.
    """
    points, about, image, candidates, out = borrow((points, about, image, candidates, out))
    pixels, jacobian, of_points, _ = points
    target, sigma, _, _, _ = image
    squared_gate, tried = limits
    n = pixels.shape[0]
    near, cost, counts = np.empty(candidates.shape, np.bool_), np.empty(n), np.zeros(n, np.int64)
    vaguest = 0.0
    for i in range(n):
        u, v, a, b, c = predict_pixel(jacobian, of_points, about, i)
        cost[i] = a + c
        vaguest = max(vaguest, a + c)
        a, c = max(a, 0.0), max(c, 0.0)
        for j in range(target.shape[0]):
            x, y = target[j, 0] - pixels[i, 0] - u, target[j, 1] - pixels[i, 1] - v
            spread = add_covariance(a, b, c, image[2], j)
            near[i, j] = candidates[i, j] and squared_mahalanobis(*spread, sigma[j] * sigma[j], x, y)[0] <= squared_gate
            counts[i] += 1 if near[i, j] else 0
    for i in range(n):
        # points that are still vague tell most; few candidates cost least
        cost[i] = counts[i] - cost[i] / (vaguest + 1e-300) if counts[i] > 0 else math.inf
    found = 0
    for _ in range(n):
        i = 0
        for other in range(1, n):
            if cost[other] < cost[i]:
                i = other
        if not cost[i] < math.inf or (found > 0 and found + counts[i] > tried):
            break
        cost[i] = math.inf
        for j in range(target.shape[0]):
            if near[i, j]:
                out[found, 0], out[found, 1] = i, j
                found += 1
    return found


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def update_with_each(points, about, image, candidates, pairs, out):  # type: ignore[no-untyped-def]
    """Predictions after an update with each of some pairs, and how much each explains.

    Parameters
    ----------
    points, about, image : tuple
        As in `choose_pairs`.
    candidates : (n, n') bool array
        As there; of points without any no detection is expected.
    pairs : (P, 2) int64 array
    out : tuple
        Steps (P, 6), covariances (P, 6, 6) and scores (P,), filled.
    """
    points, about, image, candidates, pairs, out = borrow((points, about, image, candidates, pairs, out))
    pixels, jacobian, of_points, _ = points
    step, covariance = about
    target, sigma, _, _, _ = image
    steps, covariances, scores = out
    gain, gains = np.empty((6, 2)), np.empty(target.shape[0])
    shown = np.zeros(pixels.shape[0], np.bool_)
    for i in range(shown.shape[0]):
        for j in range(target.shape[0]):
            shown[i] = shown[i] or candidates[i, j]
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        u, v, a, b, c = predict_pixel(jacobian, of_points, about, i)
        a, b, c = add_covariance(a, b, c, image[2], j)
        x, y = target[j, 0] - pixels[i, 0] - u, target[j, 1] - pixels[i, 1] - v
        variance = sigma[j] * sigma[j]
        determinant = max(a * c - b * b, 0.0) + variance * (a + c + variance)
        a, c = a + variance, c + variance
        x, y = (c * x - b * y) / determinant, (a * y - b * x) / determinant
        for p in range(6):
            gain[p, 0], gain[p, 1] = 0.0, 0.0
            for q in range(6):
                gain[p, 0] += covariance[p, q] * jacobian[i, 0, q]
                gain[p, 1] += covariance[p, q] * jacobian[i, 1, q]
        for p in range(6):
            e, f = gain[p, 0], gain[p, 1]
            steps[k, p] = step[p] + e * x + f * y
            e, f = (c * e - b * f) / determinant, (a * f - b * e) / determinant
            for q in range(6):
                covariances[k, p, q] = covariance[p, q] - e * gain[q, 0] - f * gain[q, 1]
        scores[k] = explained_log_odds(points, (steps[k], covariances[k]), image, shown, gains)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_explained(points, about, image, scores):  # type: ignore[no-untyped-def]
    """How much each of some predictions explains, to first order.

    Whichever is less, of the points or of the detections: of a body far away all points may have one detection.

    Parameters
    ----------
    points : tuple
        As in `choose_pairs`, for each of K poses.
    about : tuple
        Steps (K, 6) from these, and covariances (K, 6, 6).
    image : tuple
        As there.
    scores : (K,) array
        Filled: log-odds.
    """
    points, about, image, scores = borrow((points, about, image, scores))
    pixels, jacobian, of_points, chance = points
    steps, covariances = about
    shown, gains = np.ones(pixels.shape[1], np.bool_), np.empty(image[0].shape[0])
    for k in range(scores.shape[0]):
        own = pixels[k], jacobian[k], of_points[min(k, of_points.shape[0] - 1)], chance[k]
        scores[k] = explained_log_odds(own, (steps[k], covariances[k]), image, shown, gains)
        by_detections = 0.0
        for i in range(chance.shape[1]):
            by_detections += math.log(1.0 - chance[k, i])
        for j in range(gains.shape[0]):
            by_detections += gains[j]
        scores[k] = min(scores[k], by_detections)
