"""The posterior of a pose averaged along weak directions, compiled: one call in the place of a dozen for each.

It is for what `rootmatch.model.compiled.settling` is for, and is called by `rootmatch.tracking.averaged_pose`.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.elimination import solve_in_place
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.eigenvectors import diagonalise
from rootmatch.model.compiled.evidence import weigh_one, weighing_scratch
from rootmatch.model.compiled.known_terms import fill_components, term_buffers
from rootmatch.model.compiled.projection import linearise_one
from rootmatch.model.compiled.steps import SMALL, take_one_step
from rootmatch.model.compiled.visibility import fill_visibility_of_pose


@part
def weak_directions(covariance, distance, weak):  # type: ignore[no-untyped-def]
    """Directions (6, w) in which a covariance is large, as long as its standard deviation there, the largest first."""
    unit, axes, lines, count = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6)), 0
    for p in range(6):
        for q in range(6):
            unit[p, q] = covariance[p, q] / ((distance if p > 2 else 1.0) * (distance if q > 2 else 1.0))
    diagonalise(unit, axes)
    for _ in range(6):
        maximum = 0
        for p in range(1, 6):
            maximum = p if unit[p, p] > unit[maximum, maximum] else maximum
        if not unit[maximum, maximum] >= weak * weak:
            break
        for p in range(6):
            lines[p, count] = math.sqrt(unit[maximum, maximum]) * (distance if p > 2 else 1.0) * axes[p, maximum]
        unit[maximum, maximum] = -math.inf
        count += 1
    return lines[:, :count]


@part
def project_out(duals, covariance, step, work):  # type: ignore[no-untyped-def]
    """A step (6,) to the best pose that has no part along lines, in place.

    ``duals`` (6, w): see `dual_directions`; ``covariance`` (6, 6): of the fit; ``work`` (6, 6), (6, 6) and (6,): room.
    """
    push, square, along = work
    w = duals.shape[1]
    for p in range(6):
        for b in range(w):
            push[p, b] = 0.0
            for q in range(6):
                push[p, b] += covariance[p, q] * duals[q, b]
    # least squares: the normal matrix of directions that are independent is positive definite
    for a in range(w):
        along[a] = 0.0
        for p in range(6):
            along[a] += duals[p, a] * step[p]
        for b in range(w):
            square[a, b] = 0.0
            for p in range(6):
                square[a, b] += duals[p, a] * push[p, b]
    solve_in_place(square, along, w)
    for b in range(w):
        for p in range(6):
            step[p] -= along[b] * push[p, b]


@part
def dual_directions(lines, squared, arm, out):  # type: ignore[no-untyped-def]
    """Directions (6, w) whose product with a motion is how far it is along each of some lines, but for a factor.

    ``squared``: of the distance, by which turns and moves are compared; ``arm`` (3,): from the place of the centre that
    the motion is of to that of the lines.
    """
    x, y, z = arm
    for b in range(lines.shape[1]):
        u, v, w = lines[3, b] / squared, lines[4, b] / squared, lines[5, b] / squared
        out[0, b] = lines[0, b] + y * w - z * v
        out[1, b] = lines[1, b] + z * u - x * w
        out[2, b] = lines[2, b] + x * v - y * u
        out[3, b], out[4, b], out[5, b] = u, v, w


@part
def integrate_motion(step):  # type: ignore[no-untyped-def]
    """The last three numbers of a step where a motion at constant rates leads, in place; the first are its turn."""
    x, y, z = step[0], step[1], step[2]
    angle2 = x * x + y * y + z * z
    c, k = 0.5, 1.0 / 6.0
    if angle2 > SMALL:
        angle = math.sqrt(angle2)
        c, k = (1.0 - math.cos(angle)) / angle2, (1.0 - math.sin(angle) / angle) / angle2
    a, b, d = step[3], step[4], step[5]
    e, f, g = y * d - z * b, z * a - x * d, x * b - y * a
    step[3] = a + c * e + k * (y * g - z * f)
    step[4] = b + c * f + k * (z * e - x * g)
    step[5] = d + c * g + k * (x * f - y * e)


@part
def shift_reference(rows, x, y, z, out):  # type: ignore[no-untyped-def]
    """Motions (6, w) of a point as those of one at (x, y, z) from it, into ``out``, which may be the same."""
    for b in range(rows.shape[1]):
        u, v, w = rows[0, b], rows[1, b], rows[2, b]
        out[0, b], out[1, b], out[2, b] = u, v, w
        out[3, b] = rows[3, b] + v * z - w * y
        out[4, b] = rows[4, b] + w * x - u * z
        out[5, b] = rows[5, b] + u * y - v * x


@part
def expand_prior_terms(off, about, arm, terms):  # type: ignore[no-untyped-def]
    """The first row of a prior's terms, of a pose that is ``off`` (6,), by an expansion about another.

    ``about``: slope (6,) and precision (6, 6) there; ``arm``: from the centre's new place (3,) to that one.
    """
    slope, precision = about
    precisions, slopes, _, log_densities = terms
    log_densities[1:] = -math.inf
    terms[2][0], log_densities[0] = 0.0, 0.0
    x, y, z = arm[0], arm[1], arm[2]
    for a in range(6):
        slopes[0, a] = slope[a]
        for b in range(6):
            slopes[0, a] -= precision[a, b] * off[b]
            precisions[0, a, b] = precision[a, b]
    # of the motions of the centre: Mᵀ P M, where M adds ω × arm
    for a in range(7):
        row = precisions[0, a] if a < 6 else slopes[0]
        u, v, w = row[3], row[4], row[5]
        row[0] += y * w - z * v
        row[1] += z * u - x * w
        row[2] += x * v - y * u
    for b in range(6):
        u, v, w = precisions[0, 3, b], precisions[0, 4, b], precisions[0, 5, b]
        precisions[0, 0, b] += y * w - z * v
        precisions[0, 1, b] += z * u - x * w
        precisions[0, 2, b] += x * v - y * u


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def average_weak_directions(assignments, weak, places, scene, known, minimum, out):  # type: ignore[no-untyped-def]
    """Mean and covariance of a pose by the posterior at places along its weak directions, one after another.

    Parameters
    ----------
    assignments : (1, n) int64 array
    weak : float
        Standard deviation in radians, or over the distance, from which a direction is weak.
    places : (K,) array
        Along each direction, in standard deviations.
    scene, known : tuple
        As for `rootmatch.model.compiled.settling.settle`.
    minimum : float
        Least variance along a direction, over that of the fit.
    out : tuple
        Rotation (1, 3, 3), position (1, 3) and covariance (6, 6), of the fit at first and of the average in the end.
    """
    assignments, places, scene, known, out = borrow((assignments, places, scene, known, out))
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
    room = term_buffers(known)
    terms = room[0]
    scratch = weighing_scratch(n, image[4].shape[0], target.shape[0], rates[0].shape[0])
    step = np.empty((1, 6))
    one = np.empty(1)  # of what is not read
    weighed = one, step, np.empty((1, 6, 6)), one, one, np.empty((1, n)), one, one
    squared = position[0, 0] ** 2 + position[0, 1] ** 2 + position[0, 2] ** 2
    lines = weak_directions(covariance, max(math.sqrt(squared), 1e-300), weak)
    work, duals = (np.empty((6, 6)), np.empty((6, 6)), np.empty(6)), np.empty(lines.shape)
    values, off, mean, visible = np.empty(count), np.empty((count, 6)), np.zeros(6), np.empty(n)
    # what is known beside the detections, as it is about the fit
    fill_components(0, (rotation, position), known, room)
    best = 0
    for c in range(1, terms[3].shape[0]):
        if terms[3][c] - 0.5 * terms[2][c] > terms[3][best] - 0.5 * terms[2][best]:
            best = c
    about = terms[1][best].copy(), terms[0][best].copy()
    for line in range(lines.shape[1]):
        highest = -math.inf
        for k in range(count):
            for p in range(6):
                off[k, p] = step[0, p] = mean[p] + places[k] * lines[p, line]
            integrate_motion(step[0])
            arm = (-step[0, 3], -step[0, 4], -step[0, 5])
            take_one_step(0, step, rotation, position, math.inf, poses[0], poses[1])
            linearise_one(0, body, poses, views, images)
            expand_prior_terms(off[k], about, arm, terms)
            weigh_one(0, 0, assignments, whole, white, terms, image, clutter, rates, scratch, weighed)
            # to the valley, but along none of its weak directions
            dual_directions(lines, squared, arm, duals)
            project_out(duals, weighed[2][0], step[0], work)
            take_one_step(0, step, poses[0], poses[1], math.inf, poses[0], poses[1])
            linearise_one(0, body, poses, views, images)
            shift_reference(step.T, arm[0], arm[1], arm[2], step.T)
            value = 0.0
            for p in range(6):
                off[k, p] += step[0, p]
            for p in range(6):
                push = about[0][p]
                for q in range(6):
                    push -= 0.5 * about[1][p, q] * off[k, q]
                value += push * off[k, p]
            fill_visibility_of_pose(0, expected[0], cosine, view_cosine, 0.0, visible)
            for i in range(n):
                j = assignments[0, i]
                if j >= 0:
                    u, v = target[j, 0] - pixels[0, i, 0], target[j, 1] - pixels[0, i, 1]
                    value += math.log(max(visible[i], 1e-300)) - 0.5 * (u * u + v * v) / (sigma[j] * sigma[j])
            values[k] = value if abs(value) < math.inf else -math.inf
            highest = max(highest, values[k])
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
                spread = (minimum - 1.0) * lines[p, line] * lines[q, line]
                for k in range(count):
                    spread += values[k] / weights * (off[k, p] - mean[p]) * (off[k, q] - mean[q])
                covariance[p, q] += spread
    for p in range(6):
        step[0, p] = mean[p]
    integrate_motion(step[0])
    shift_reference(covariance, step[0, 3], step[0, 4], step[0, 5], covariance)
    shift_reference(covariance.T, step[0, 3], step[0, 4], step[0, 5], covariance.T)
    take_one_step(0, step, rotation, position, math.inf, rotation, position)
