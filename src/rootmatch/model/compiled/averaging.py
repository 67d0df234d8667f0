"""The posterior of a pose averaged along weak directions, compiled: one call in the place of a dozen for each.

It is what `rootmatch.tracking.averaged_pose` does step by step, for what `rootmatch.model.compiled.settling` is for.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.evidence import scratch_for, weigh_one
from rootmatch.model.compiled.known_terms import components_about, room_for_terms
from rootmatch.model.compiled.prior_terms import vector_of
from rootmatch.model.compiled.projection import linearise_one
from rootmatch.model.compiled.steps import step_of_one
from rootmatch.model.compiled.visibility import see_one


@part
def leave_out(lines, precision, step, work):  # type: ignore[no-untyped-def]
    """A step (6,) without its part along lines (6, w), in place; ``precision`` (6, 6), ``work`` (2, 6, 6): scratch."""
    precise, square = work
    w = lines.shape[1]
    for p in range(6):
        for b in range(w):
            precise[p, b] = 0.0
            for q in range(6):
                precise[p, b] += precision[p, q] * lines[q, b]
    # least squares by Gauss and Jordan: the normal matrix of directions that are independent is positive definite
    for a in range(w):
        for b in range(w):
            square[a, b] = 0.0
            for p in range(6):
                square[a, b] += lines[p, a] * precise[p, b]
    for b in range(w):
        total = 0.0
        for p in range(6):
            total += step[p] * precise[p, b]
        precise[0, b] = total
    for a in range(w):
        for b in range(w):
            if b != a:
                ratio = square[b, a] / square[a, a]
                precise[0, b] -= ratio * precise[0, a]
                for c in range(a, w):
                    square[b, c] -= ratio * square[a, c]
    for b in range(w):
        along = precise[0, b] / square[b, b]
        for p in range(6):
            step[p] -= along * lines[p, b]


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def average(assignments, lines, places, scene, known, least, out):  # type: ignore[no-untyped-def]
    """Mean and covariance of a pose by the posterior at places on lines, one line after another.

    Parameters
    ----------
    assignments : (1, n) int64 array
    lines : (6, w) array
        Directions, as long as their standard deviations.
    places : (K,) array
        On each line, in standard deviations.
    scene, known : tuple
        As for `rootmatch.model.compiled.settling.settle`.
    least : float
        Least variance along a line, over that of the fit.
    out : tuple
        Rotation (1, 3, 3), position (1, 3) and covariance (6, 6), of the fit at first and of the average in the end.
    """
    assignments, lines, places, scene, known, out = borrowed((assignments, lines, places, scene, known, out))
    body, views, image, clutter, rates = scene
    target, sigma, view_cosine = image[0], image[1], image[3]
    rotation, position, covariance = out
    n, count = assignments.shape[1], places.shape[0]
    poses = np.empty((1, 3, 3)), np.empty((1, 3))
    cosine = np.empty((1 if body[1].shape[0] > 0 else 0, n))
    pixels, jacobian, by_position = np.empty((1, n, 2)), np.empty((1, n, 2, 6)), np.empty((1, n, 2, 3))
    seen, expected = np.empty((1, n), np.bool_), np.empty((1, n))
    images = pixels, jacobian, by_position, seen, cosine, expected
    whole = pixels, jacobian, seen, expected, cosine, np.empty((0, 0), np.int64), np.empty((0, 0))
    white = np.empty((0, 0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0))
    room = room_for_terms(known)
    terms = room[0]
    scratch = scratch_for(n, image[4].shape[0], target.shape[0])
    step = np.empty((1, 6))
    one = np.empty(1)  # of what is not read
    weighed = one, step, np.empty((1, 6, 6)), one, one, np.empty((1, n)), one, one
    work = np.empty((6, 6)), np.empty((6, 6))
    values, off, mean, shown, visible = np.empty(count), np.empty((count, 6)), np.empty(6), np.empty(n), np.empty(n)
    for line in range(lines.shape[1]):
        highest = -math.inf
        for k in range(count):
            for p in range(6):
                step[0, p] = places[k] * lines[p, line]
            step_of_one(0, step, rotation, position, math.inf, poses[0], poses[1])
            linearise_one(0, body, poses, views, images)
            components_about(0, poses, known, room)
            weigh_one(0, 0, assignments, whole, white, terms, image, clutter, rates, scratch, weighed)
            # to the valley, but along none of its weak directions
            leave_out(lines, scratch[0][0], step[0], work)
            step_of_one(0, step, poses[0], poses[1], math.inf, poses[0], poses[1])
            linearise_one(0, body, poses, views, images)
            components_about(0, poses, known, room)
            value = terms[3][0] - 0.5 * terms[2][0]
            for c in range(1, terms[3].shape[0]):
                value = max(value, terms[3][c] - 0.5 * terms[2][c])
            see_one(0, expected[0], cosine, view_cosine, 0.0, shown, visible)
            for i in range(n):
                j = assignments[0, i]
                if j >= 0:
                    u, v = target[j, 0] - pixels[0, i, 0], target[j, 1] - pixels[0, i, 1]
                    value += math.log(max(visible[i], 1e-300)) - 0.5 * (u * u + v * v) / (sigma[j] * sigma[j])
            values[k] = value if abs(value) < math.inf else -math.inf
            highest = max(highest, values[k])
            vector_of(poses[0][0], rotation[0], room[2][0], off[k])
            for p in range(3):
                off[k, 3 + p] = poses[1][0, p] - position[0, p]
        if highest == -math.inf:
            continue
        weights = 0.0
        for k in range(count):
            values[k] = math.exp(values[k] - highest)
            weights += values[k]
        for p in range(6):
            mean[p] = 0.0
            for k in range(count):
                mean[p] += values[k] / weights * off[k, p]
        for p in range(6):
            for q in range(6):
                spread = (least - 1.0) * lines[p, line] * lines[q, line]
                for k in range(count):
                    spread += values[k] / weights * (off[k, p] - mean[p]) * (off[k, q] - mean[q])
                covariance[p, q] += spread
        for p in range(6):
            step[0, p] = mean[p]
        step_of_one(0, step, rotation, position, math.inf, rotation, position)
