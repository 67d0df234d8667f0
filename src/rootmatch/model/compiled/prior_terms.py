"""Terms of predicted poses beside a broad prior, compiled: the formulas of `rootmatch.model.pose_density`."""

from __future__ import annotations

import math

from rootmatch.algebra.elimination import factorise, solve_lower
from rootmatch.jit.decorators import part
from rootmatch.model.compiled.evidence import invert_scaled
from rootmatch.problems.pose_fit.reference_point import RIDGE

NO_TURN = 1e-9
"""Sine of the angle of a rotation below which it is none, or a half turn."""


@part
def rotation_vector_between(mean, R, turn, out):  # type: ignore[no-untyped-def]
    """Rotation vector of mean Rᵀ, into the first three numbers of ``out``; ``turn`` (3, 3): scratch."""
    for i in range(3):
        for j in range(3):
            turn[i, j] = mean[i, 0] * R[j, 0] + mean[i, 1] * R[j, 1] + mean[i, 2] * R[j, 2]
    x, y, z = 0.5 * (turn[2, 1] - turn[1, 2]), 0.5 * (turn[0, 2] - turn[2, 0]), 0.5 * (turn[1, 0] - turn[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)
    ratio = 1.0
    if sine < NO_TURN and cosine < 0.0:
        # R = 2 n nᵀ − I, whose longest column tells n
        longest = 0
        for i in range(1, 3):
            longest = i if turn[i, i] > turn[longest, longest] else longest
        x, y, z = turn[0, longest], turn[1, longest], turn[2, longest]
        if longest == 0:
            x += 1.0
        elif longest == 1:
            y += 1.0
        else:
            z += 1.0
        ratio = math.pi / math.sqrt(x * x + y * y + z * z)
    elif sine >= NO_TURN:
        ratio = math.atan2(sine, cosine) / sine
    out[0], out[1], out[2] = ratio * x, ratio * y, ratio * z


@part
def fill_broad_terms(k, row, positions, broad, log_share, out):  # type: ignore[no-untyped-def]
    """Terms of the broad prior about the k-th of some positions, into a row of ``out``.

    ``log_share``: logarithm of its density of rotations, with its share.
    """
    any_turn, field, depth, _, radius = broad
    precision, slope, squared, log_density = out
    x, y, z = positions[k, 0], positions[k, 1], positions[k, 2]
    distance2 = x * x + y * y + z * z
    reach2 = distance2 + radius * radius
    squared[row], log_density[row] = 0.0, log_share - math.log(field * depth) - 1.5 * math.log(reach2)
    for a in range(6):
        slope[row, a] = 0.0
        for b in range(6):
            precision[row, a, b] = 0.0
    unit, across, along = 2.0 * math.pi / reach2, 1.0 / field, 1.0 / (depth * depth)
    for a in range(3):
        precision[row, a, a] = any_turn
        for b in range(3):
            ray = positions[k, a] * positions[k, b] / max(distance2, 1e-300)
            precision[row, 3 + a, 3 + b] = unit * (((1.0 if a == b else 0.0) - ray) * across + ray * along)


@part
def fill_arc_motion(step):  # type: ignore[no-untyped-def]
    """The last three numbers of a step as the motion whose arc leads there, in place; the first are its turn.

    See `rootmatch.algebra.rotation.arc_motion`.
    """
    x, y, z, u, v, w = step[0], step[1], step[2], step[3], step[4], step[5]
    angle2 = x * x + y * y + z * z
    c = 1.0 / 12.0
    if angle2 > 1e-4:
        half = 0.5 * math.sqrt(angle2)
        c = (1.0 - half / math.tan(half)) / angle2
    e, f, g = y * w - z * v, z * u - x * w, x * v - y * u
    step[3] = u + 0.5 * e + c * (y * g - z * f)
    step[4] = v + 0.5 * f + c * (z * e - x * g)
    step[5] = w + 0.5 * g + c * (x * f - y * e)


@part
def turn_covariance(covariance, turn, size, out):  # type: ignore[no-untyped-def]
    """A covariance whose axes are turned, into ``out``: of the pose in the first rows of so many, and of what follows.

    A seventh row, of the scale, has no axis.
    """
    rows = covariance.shape[0]
    for a in range(rows):
        for b in range(6, size):
            out[a, b] = covariance[a, b]
        for first in range(0, rows - size + 6, 3):
            p = first if first < 6 else first + size - 6
            u, v, w = covariance[a, p], covariance[a, p + 1], covariance[a, p + 2]
            for b in range(3):
                out[a, p + b] = turn[b, 0] * u + turn[b, 1] * v + turn[b, 2] * w
    for b in range(rows):
        for first in range(0, rows - size + 6, 3):
            p = first if first < 6 else first + size - 6
            u, v, w = out[p, b], out[p + 1, b], out[p + 2, b]
            for a in range(3):
                out[p + a, b] = turn[a, 0] * u + turn[a, 1] * v + turn[a, 2] * w


@part
def combine_axes(covariance, turned, factor, scale, out):  # type: ignore[no-untyped-def]
    """See `covariance_in_either_axes`: of the covariance (p, p) in both, into ``out``.

    ``turned`` is overwritten; ``factor`` (p, p) and ``scale`` (p,): scratch.
    """
    size = scale.shape[0]
    for i in range(size):
        scale[i] = 1.0 / math.sqrt(max(covariance[i, i] + turned[i, i], 1e-300))
        for j in range(i + 1):
            factor[i, j] = (covariance[i, j] + turned[i, j]) * scale[i] * scale[j] + (RIDGE if i == j else 0.0)
    factorise(factor, size, 1e-300)
    for side in range(2):
        # ``turned`` holds L⁻¹ C, column by column in its rows, of one covariance after the other
        for a in range(size):
            for i in range(size):
                turned[a, i] = (turned[a, i] if side == 0 else covariance[a, i]) * scale[i]
            solve_lower(factor, size, turned[a])
        for a in range(size):
            for b in range(a + 1):
                total = 0.0 if side == 0 else out[a, b]
                for k in range(size):
                    total += turned[a, k] * turned[b, k]
                out[a, b] = out[b, a] = total


@part
def fill_largest_terms(k, row, poses, predictions, broad, scratch, out, which):  # type: ignore[no-untyped-def]
    """Terms of the largest of predicted poses and a broad prior about the k-th of some poses, into a row of ``out``.

    ``which``: the prediction, or their number for the broad one; ``scratch``: (3, 3), (4, 6) and (4, 6, 6).
    """
    rotations, positions = poses
    means, places, covariances, peaks, freedoms = predictions
    _, field, depth, log_turn, radius = broad
    precision, slope, squared, log_density = out
    count = means.shape[0]
    turn, vectors, squares = scratch
    step, moved, push, scale = vectors[0], vectors[1], vectors[2], vectors[3]
    covariance, turned, factor, whole = squares[0], squares[1], squares[2], squares[3]
    x, y, z = positions[k, 0], positions[k, 1], positions[k, 2]
    distance2 = x * x + y * y + z * z
    reach2 = distance2 + radius * radius
    best = log_turn
    if log_turn > -math.inf:
        best -= math.log(field * depth) + 1.5 * math.log(reach2)
    which[row], squared[row], log_density[row] = count, 0.0, best
    for g in range(count):
        rotation_vector_between(means[g], rotations[k], turn, step)
        for a in range(3):
            step[3 + a] = places[g, a] - positions[k, a]
        fill_arc_motion(step)
        for a in range(3):  # from the predicted axes to those about the pose; a rotation has its own axis in both
            moved[a] = step[a]
            moved[3 + a] = turn[0, a] * step[3] + turn[1, a] * step[4] + turn[2, a] * step[5]
        turn_covariance(covariances[g], turn.T, 6, turned)
        combine_axes(covariances[g], turned, factor, scale, covariance)
        log_volume = 0.5 * invert_scaled(covariance, factor, scale, whole)
        total = 0.0
        for a in range(6):
            push[a] = 0.0
            for b in range(6):
                push[a] += whole[a, b] * moved[b]
            total += push[a] * moved[a]
        weight, peak, freedom = 1.0, peaks[g] - log_volume, freedoms[g]
        # normal up to its mean squared deviation, where a t-distribution has the same slope
        if freedom < math.inf and total > 6.0:
            weight = (freedom + 6.0) / (freedom + total)
            peak += 0.5 * weight * total - 3.0 + (0.5 * freedom + 3.0) * math.log(weight)
        value = peak - 0.5 * weight * total
        # the first of equal components
        if value > best or (value == best and which[row] == count):
            best = value
            which[row], squared[row], log_density[row] = g, weight * total, peak
            for a in range(6):
                slope[row, a] = weight * push[a]
                for b in range(6):
                    precision[row, a, b] = weight * whole[a, b]
    if which[row] == count:
        fill_broad_terms(k, row, positions, broad, log_turn, out)
