"""Steps of the filter of a motion, compiled: see `rootmatch.tracking.motion_filter`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.prior_terms import rotation_vector_between
from rootmatch.tracking.motion_levels import (
    average_levels,
    bend_levels,
    exchange_levels,
    fill_rotation,
    find_axes,
    take_in_level,
)

SEEN = 1e-6
"""Part of a prediction's precision up to which a frame tells nothing. A round value; rounding leaves some."""


@part
def multiply(first, second, out):  # type: ignore[no-untyped-def]
    """The product of matrices (3, 3), into ``out``."""
    for i in range(3):
        for j in range(3):
            out[i, j] = first[i, 0] * second[0, j] + first[i, 1] * second[1, j] + first[i, 2] * second[2, j]


@part
def carry_column(column, F, turn, out):  # type: ignore[no-untyped-def]
    """The transition times a column (p + 12,), into ``out``."""
    first = column.shape[0] - 12
    for i in range(6):
        now = column[i]
        if i < 3:
            now = turn[i, 0] * column[0] + turn[i, 1] * column[1] + turn[i, 2] * column[2]
        for p in range(3):
            change = F[p, 1] * column[first + i] + F[p, 2] * column[first + 6 + i]
            out[i if p == 0 else first - 6 + 6 * p + i] = F[p, 0] * now + change
    for i in range(6, first):
        out[i] = column[i]


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def move_ahead(transition, state, levels, rule, out):  # type: ignore[no-untyped-def]
    """A later state.

    The p rows of a pose are those of its covariance, see `rootmatch.problems.pose_fit.pose.Pose`; the first six move.

    Parameters
    ----------
    transition : tuple
        Of position, velocity and acceleration, (3, 3), and the covariance that an acceleration of unit variance adds.
    state : tuple
        Rotation (3, 3), position (3,), velocity with acceleration (12,), and the covariance (p + 12, p + 12) of pose
        and motion.
    levels : tuple
        See `average_levels`.
    rule : tuple
        See `exchange_levels`; variances (J,) of the accelerations of each level over the stated ones, those (6,), and
        what is added to that of the scale.
    out : tuple
        State and levels, filled.
    """
    transition, state, levels, rule, out = borrow((transition, state, levels, rule, out))
    F, added = transition
    R, t, motion, P = state
    usual, kept, variances, stated, of_scale = rule
    (turned, moved, faster, whole), (each, apart, shares) = out
    turn, first = np.empty((3, 3)), P.shape[0] - 12
    mixed, half, offset = np.empty(each.shape), np.empty(P.shape), np.empty(apart.shape)
    for i in range(6):
        velocity, acceleration = motion[i], motion[6 + i]
        faster[i] = F[1, 1] * velocity + F[1, 2] * acceleration
        faster[6 + i] = F[2, 1] * velocity + F[2, 2] * acceleration
        if i >= 3:
            moved[i - 3] = t[i - 3] + F[0, 1] * velocity + F[0, 2] * acceleration
    x = F[0, 1] * motion[0] + F[0, 2] * motion[6]
    y = F[0, 1] * motion[1] + F[0, 2] * motion[7]
    z = F[0, 1] * motion[2] + F[0, 2] * motion[8]
    fill_rotation(x, y, z, turn)
    multiply(turn, R, turned)
    exchange_levels(levels, P, (usual, kept), (mixed, offset, shares))
    for level in range(len(shares)):
        carry_column(offset[level], F, turn, apart[level])
        # twice, and each time into rows: that of a covariance
        for row in range(P.shape[0]):
            carry_column(mixed[level, row], F, turn, half[row])
        for column in range(P.shape[0]):
            carry_column(half[:, column], F, turn, each[level, column])
        for p in range(3):
            for q in range(3):
                row, column = (0 if p == 0 else first - 6 + 6 * p), (0 if q == 0 else first - 6 + 6 * q)
                for i in range(6):
                    each[level, row + i, column + i] += added[p, q] * variances[level] * stated[i]
        for i in range(6, first):
            each[level, i, i] += of_scale
    average_levels((each, apart, shares), whole)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def take_pose(before, pose, rule, out):  # type: ignore[no-untyped-def]
    """The state after a pose whose fit includes its prediction, as moments of all levels.

    Parameters
    ----------
    before : tuple
        State and levels that were predicted, see `move_ahead`, and the scale.
    pose : tuple
        Rotation, position, covariance (p, p) and scale of the fit.
    rule : tuple
        Probability that the fit is of the body, otherwise the prediction holds; ν of the tails of the prediction in the
        fit; and how much of what the fit leaves open counts in them.
    out : tuple
        State and levels; what they change by with the fit (p + 12, p), and with the prediction's errors; filled.

    Returns
    -------
    scale : float
    """
    before, pose, out = borrow((before, pose, out))
    (R, t, motion, P), (each, apart, shares), scale = before
    R_fit, t_fit, fitted, scale_fit = pose
    chance, freedom, counted = rule
    (turned, moved, faster, covariance), (levels, means, parts), change, kept = out
    count, rows, size = len(shares), P.shape[0], fitted.shape[0]
    turn, step, along = np.empty((3, 3)), np.empty(size), np.empty(size)
    rotation_vector_between(R_fit, R, turn, step)
    for i in range(3):
        step[3 + i] = t_fit[i] - t[i]
    if size > 6:
        step[6] = scale_fit - scale
    whole, bent = P.copy(), np.empty(each.shape)
    bend_levels((each, apart, shares), whole, step, along, bent)
    axes, back, left = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    find_axes(whole[:size, :size], fitted, axes, back, left)
    measured, precision, squared = np.empty(size), np.empty(size), 0.0
    for i in range(size):
        measured[i] = 0.0
        for k in range(size):
            measured[i] += axes[i, k] * along[k]
        squared += measured[i] * measured[i] + counted * left[i]
    weight = min(1.0, (freedom + size) / (freedom + squared)) if freedom < math.inf else 1.0
    common, told = np.zeros(rows), np.empty(count)
    gains = np.empty((count, rows, size))
    for a in range(rows):
        for b in range(size):
            change[a, b] = kept[a, b] = 0.0
    for i in range(size):
        precision[i] = 1.0 / left[i] - weight
        if precision[i] >= SEEN:
            measured[i] *= 1.0 / (left[i] * precision[i])
        else:
            precision[i] = 0.0
    for j in range(count):
        told[j] = take_in_level((bent[j], apart[j]), (axes, back, measured, precision), (levels[j], means[j], gains[j]))
    # of what the fit does not tell it may be less certain than the prediction: then a caller said where the body is
    for i in range(size):
        if precision[i] > 0.0:
            continue
        more = max(left[i] - 1.0, 0.0)
        for a in range(rows):
            common[a] = 0.0
            for k in range(size):
                common[a] += whole[a, k] * axes[i, k]
        for a in range(rows):
            for b in range(size):
                change[a, b] += common[a] * axes[i, b]
                kept[a, b] += common[a] * axes[i, b] * (more / (1.0 + more))
            for j in range(count):
                means[j, a] += common[a] * measured[i]
                for b in range(rows):
                    levels[j, a, b] += more * common[a] * common[b]
    best, total = told[0], 0.0
    for j in range(count):
        best = max(best, told[j])
    for j in range(count):
        parts[j] = shares[j] * math.exp(told[j] - best)
        total += parts[j]
    faster_by = np.zeros(rows)
    for j in range(count):
        parts[j] /= total
        for a in range(rows):
            faster_by[a] += parts[j] * means[j, a]
            for i in range(size):
                if precision[i] > 0.0:
                    gain = parts[j] * gains[j, a, i]
                    for b in range(size):
                        change[a, b] += gain * axes[i, b] / (left[i] * precision[i])
                        kept[a, b] += gain * axes[i, b]
    # from where the fit is, as that may be along an arc
    for i in range(size):
        step[i] = faster_by[i] - along[i]
    fill_rotation(step[0], step[1], step[2], turn)
    multiply(turn, R_fit, turned)
    for i in range(3):
        moved[i] = t_fit[i] + step[3 + i]
    if size > 6:
        scale_fit += step[6]
    if chance < 1.0:
        rotation_vector_between(turned, R, turn, step)
        fill_rotation(chance * step[0], chance * step[1], chance * step[2], turn)
        multiply(turn, R, turned)
        for i in range(3):
            moved[i] = t[i] + chance * (moved[i] - t[i])
        scale_fit = scale + chance * (scale_fit - scale)
        for a in range(rows):
            faster_by[a] *= chance
            for b in range(size):
                change[a, b] *= chance
                kept[a, b] *= chance
        for j in range(count):
            share = (1.0 - chance) * shares[j] + chance * parts[j]
            new, parts[j] = chance * parts[j] / max(share, 1e-300), share
            for a in range(rows):
                common[a] = means[j, a] - apart[j, a]
                means[j, a] = apart[j, a] + new * common[a]
            for a in range(rows):
                for b in range(rows):
                    spread = new * (1.0 - new) * common[a] * common[b]
                    levels[j, a, b] = (1.0 - new) * each[j, a, b] + new * levels[j, a, b] + spread
    for j in range(count):
        for a in range(rows):
            means[j, a] -= faster_by[a]
    for i in range(12):
        faster[i] = motion[i] + faster_by[size + i]
    average_levels((levels, means, parts), covariance)
    return scale_fit
