"""What else a pose explains without one of its matches, to first order, compiled: see `rootmatch.model.left_out`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.evidence import LOG_2PI
from rootmatch.model.compiled.gating import deviation, spread_by_pose, widened

DETERMINED = 1e-9
"""Determinant of I − H up to which a match alone determines some of the pose: nothing predicts its detection then."""


@part
def noise_of(view, i, j):  # type: ignore[no-untyped-def]
    """Covariance (a, b; b, c) of detection j as that of point i."""
    of_points, k, image = view[2:]
    a = c = image[1][j] * image[1][j]
    b = 0.0
    if of_points.shape[0] > 0:
        a, b, c = a + of_points[k, i, 0, 0], of_points[k, i, 0, 1], c + of_points[k, i, 1, 1]
    return widened(a, b, c, image[2], j)


@part
def leverage(spread, noise):  # type: ignore[no-untyped-def]
    """Largest eigenvalue of H = S N⁻¹, and the determinant of I − H, of the spread of a pixel by the pose and noise."""
    a, b, c = spread
    d, e, f = noise
    size = d * f - e * e
    trace, both = (a * f - 2.0 * b * e + c * d) / size, (a * c - b * b) / size
    return 0.5 * (trace + math.sqrt(max(trace * trace - 4.0 * both, 0.0))), 1.0 - trace + both


@part
def off(view, i, j, step):  # type: ignore[no-untyped-def]
    """How far detection j is from the pixel of point i after a step of the pose."""
    pixels, jacobian, target = view[0], view[1], view[4][0]
    x, y = target[j, 0] - pixels[i, 0], target[j, 1] - pixels[i, 1]
    for p in range(6):
        x -= jacobian[i, 0, p] * step[p]
        y -= jacobian[i, 1, p] * step[p]
    return x, y


@part
def gain_of(view, i, j, spread, step):  # type: ignore[no-untyped-def]
    """χ² of detection j about the prediction of point i, and what it gains but for the point's and its own worth."""
    a, b, c = spread
    d, e, f = noise_of(view, i, j)
    squared, size = deviation(a + d, b + e, c + f, 0.0, *off(view, i, j, step))
    log_weights = view[4][4]
    weight = log_weights[i, j] if log_weights.shape[0] > 0 else 0.0
    return squared, weight - 0.5 * (squared + math.log(size)) - LOG_2PI


@part
def follow(view, i, j, state, sign):  # type: ignore[no-untyped-def]
    """The step and covariance of a pose with one match more (1) or less (−1), in place."""
    step, covariance, along = state
    jacobian = view[1]
    x, y = off(view, i, j, step)
    d, e, f = noise_of(view, i, j)
    a, b, c = spread_by_pose(jacobian, covariance, i)
    d, e, f = d + sign * a, e + sign * b, f + sign * c
    size = sign * (d * f - e * e)
    d, e, f = f / size, -e / size, d / size  # ± the inverse
    for p in range(6):
        along[0, p], along[1, p] = 0.0, 0.0
        for q in range(6):
            along[0, p] += covariance[p, q] * jacobian[i, 0, q]
            along[1, p] += covariance[p, q] * jacobian[i, 1, q]
    for p in range(6):
        first, second = d * along[0, p] + e * along[1, p], e * along[0, p] + f * along[1, p]
        step[p] += first * x + second * y
        for q in range(6):
            covariance[p, q] -= first * along[0, q] + second * along[1, q]


@part
def best_match(view, state, odds, row, taken, barred):  # type: ignore[no-untyped-def]
    """The point and the detection, both free and not a barred pair, that gain most about a pose, and that; −1 if none.

    ``odds``: of each point, of each detection, and the squared gate.
    """
    shown, worth, squared_gate = odds
    step, covariance = state[:2]
    point, detection, best = -1, -1, 0.0
    for i in range(row.shape[0]):
        if row[i] >= 0 or not shown[i] > -math.inf:
            continue
        a, b, c = spread_by_pose(view[1], covariance, i)
        spread = max(a, 0.0), b, max(c, 0.0)
        for j in range(taken.shape[0]):
            if taken[j] or (i == barred[0] and j == barred[1]):
                continue
            squared, gain = gain_of(view, i, j, spread, step)
            gain += shown[i] + worth[j]
            if squared <= squared_gate and gain > best:
                point, detection, best = i, j, gain
    return point, detection, best


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def leave_out(assignments, points, covariances, image, limits, out):  # type: ignore[no-untyped-def]
    """Assignments without one match each, and with what the pose then gathers, one match after another.

    Parameters
    ----------
    assignments : (K, n) int64 array
    points : tuple
        Of K poses: pixels (K, n, 2), jacobian (K, n, 2, 6), covariances (K, n, 2, 2) of the pixels by the model points,
        empty if exact, visibility (K, n), and whether each is seen (K, n).
    covariances : (K, 6, 6) array
        Of the poses.
    image : tuple
        As for `rootmatch.model.compiled.mode_changes.changes_of`.
    limits : tuple
        The detection rate, NaN for the one that each assignment suggests; the least gain of all changes of an
        assignment; the fewest matches; the least leverage of a match that is left out; and the squared gate.
    out : tuple
        The assignments (M, n), the steps (M, 6) to their poses, and which each comes from (M,); filled.

    Returns
    -------
    int
        How many there are, at most M.
    """
    assignments, points, covariances, image, out = borrowed((assignments, points, covariances, image, out))
    pixels, jacobian, of_points, visible, seen = points
    log_clutter, log_counts, image_of = image[3], image[5], image[6]
    given, least_gain, least, least_leverage, squared_gate = limits
    changed, steps, of = out
    n, n_target, found = assignments.shape[1], image[0].shape[0], 0
    row, taken, worth, shown = np.empty(n, np.int64), np.empty(n_target, np.bool_), np.empty(n_target), np.empty(n)
    step, covariance, matches = np.empty(6), np.empty((6, 6)), np.empty(log_counts.shape[0], np.int64)
    state = step, covariance, np.empty((2, 6))
    for k in range(assignments.shape[0]):
        view = pixels[k], jacobian[k], of_points, k, image
        total, expected = 0, 0.0
        for c in range(matches.shape[0]):
            matches[c] = 0
        for i in range(n):
            expected += visible[k, i]
            if assignments[k, i] >= 0:
                matches[image_of[assignments[k, i]]] += 1
                total += 1
        if total <= least:
            continue
        rate = given if given >= 0.0 else (total + 0.5) / (max(expected, total) + 1.0)
        for i in range(n):
            chance = min(rate * visible[k, i], 0.999)
            shown[i] = math.log(chance) - math.log1p(-chance) if seen[k, i] and chance > 0.0 else -math.inf
        for j in range(n_target):
            count = max(matches[image_of[j]], 1)
            worth[j] = log_counts[image_of[j], count] - log_counts[image_of[j], count - 1] - log_clutter[j]
        for left in range(n):
            own = assignments[k, left]
            if own < 0 or found == changed.shape[0]:
                continue
            spread = spread_by_pose(jacobian[k], covariances[k], left)
            largest, without = leverage(spread, noise_of(view, left, own))
            if largest < least_leverage or without <= DETERMINED:
                continue
            for j in range(n_target):
                taken[j] = False
            for i in range(n):
                row[i] = assignments[k, i]
                if row[i] >= 0:
                    taken[row[i]] = True
            for p in range(6):
                step[p] = 0.0
                for q in range(6):
                    covariance[p, q] = covariances[k, p, q]
            row[left], taken[own] = -1, False
            follow(view, left, own, state, -1.0)
            gain = -gain_of(view, left, own, spread_by_pose(jacobian[k], covariance, left), step)[1]
            gain -= shown[left] + worth[own]
            other = False
            for _ in range(n):
                i, j, more = best_match(view, state, (shown, worth, squared_gate), row, taken, (left, own))
                if i < 0:
                    break
                follow(view, i, j, state, 1.0)
                row[i], taken[j], gain = j, True, gain + more
                other = other or (i != left and j != own)
            if other and gain > least_gain:  # otherwise it is a single change, see `changes_of`
                for i in range(n):
                    changed[found, i] = row[i]
                for p in range(6):
                    steps[found, p] = step[p]
                of[found] = k
                found += 1
    return found
