"""Terms of predicted poses beside a broad prior, compiled: the formulas of `rootmatch.model.pose_density`."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part

NO_TURN = 1e-9
"""Sine of the angle of a rotation below which it is none, or a half turn."""


@part
def vector_of(mean, R, turn, out):  # type: ignore[no-untyped-def]
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
def broad_about(k, row, positions, broad, log_share, out):  # type: ignore[no-untyped-def]
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
def error_about(place, positions, k, step):  # type: ignore[no-untyped-def]
    """The last three numbers of the step from the k-th pose to a predicted one, whose rotation vector is the first."""
    x, y, z = step[0], step[1], step[2]
    u, v, w = place[0] - positions[k, 0], place[1] - positions[k, 1], place[2] - positions[k, 2]
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
def terms_about(k, row, poses, predictions, broad, scratch, out, which):  # type: ignore[no-untyped-def]
    """Terms of the largest of predicted poses and a broad prior about the k-th of some poses, into a row of ``out``.

    ``which``: the prediction, or their number for the broad one; ``scratch``: (3, 3) and (2, 6).
    """
    rotations, positions = poses
    means, places, wholes, peaks, freedoms = predictions
    _, field, depth, log_turn, radius = broad
    precision, slope, squared, log_density = out
    count = means.shape[0]
    turn, vectors = scratch
    step, push = vectors[0], vectors[1]
    x, y, z = positions[k, 0], positions[k, 1], positions[k, 2]
    distance2 = x * x + y * y + z * z
    reach2 = distance2 + radius * radius
    best = log_turn
    if log_turn > -math.inf:
        best -= math.log(field * depth) + 1.5 * math.log(reach2)
    which[row], squared[row], log_density[row] = count, 0.0, best
    for g in range(count):
        vector_of(means[g], rotations[k], turn, step)
        error_about(places[g], positions, k, step)
        total = 0.0
        for a in range(6):
            push[a] = 0.0
            for b in range(6):
                push[a] += wholes[g, a, b] * step[b]
            total += push[a] * step[a]
        weight, peak, freedom = 1.0, peaks[g], freedoms[g]
        # normal up to its mean squared deviation, where a t-distribution has the same slope
        if freedom < math.inf and total > 6.0:
            weight = (freedom + 6.0) / (freedom + total)
            peak += 0.5 * weight * total - 3.0 + (0.5 * freedom + 3.0) * math.log(weight)
        value = peak - 0.5 * weight * total
        # the first of equal components
        if value > best or (value == best and which[row] == count):
            best = value
            which[row], squared[row], log_density[row] = g, weight * total, peak
            for a in range(3):
                for p in range(0, 6, 3):
                    slope[row, p + a] = 0.0
                    for c in range(3):
                        slope[row, p + a] += weight * turn[c, a] * push[p + c]
                for p in range(0, 6, 3):
                    for b in range(6):
                        precision[row, p + a, b] = 0.0
                        for c in range(3):
                            precision[row, p + a, b] += weight * turn[c, a] * wholes[g, p + c, b]
            for a in range(6):
                for q in range(0, 6, 3):
                    u, v, w = precision[row, a, q], precision[row, a, q + 1], precision[row, a, q + 2]
                    for b in range(3):
                        precision[row, a, q + b] = u * turn[0, b] + v * turn[1, b] + w * turn[2, b]
    if which[row] == count:
        broad_about(k, row, positions, broad, log_turn, out)
