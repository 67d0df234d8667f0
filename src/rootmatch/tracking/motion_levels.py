"""Levels of the accelerations of a body, compiled: see `rootmatch.tracking.motion_filter`.

Each level is a normal distribution of pose and motion with a share; they differ by how much a body accelerates.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.elimination import factorise, invert_factored, solve_lower
from rootmatch.jit.decorators import part
from rootmatch.model.compiled.eigenvectors import diagonalise
from rootmatch.model.compiled.prior_terms import combine_axes, fill_arc_motion, turn_covariance
from rootmatch.problems.pose_fit.reference_point import STRAIGHT

SMALL = 1e-6
"""Angle in radians below which the series of sine and cosine are cut after the first term."""


@part
def fill_rotation(x, y, z, turn):  # type: ignore[no-untyped-def]
    """Rotation matrix (3, 3) of a rotation vector."""
    angle = math.sqrt(x * x + y * y + z * z)
    s, c = 1.0, 0.5
    if angle > SMALL:
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    turn[1, 0], turn[1, 1], turn[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    turn[2, 0], turn[2, 1], turn[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)


@part
def average_levels(levels, out):  # type: ignore[no-untyped-def]
    """Covariance of a mixture of normal distributions, into ``out``.

    ``levels``: covariances (J, p + 12, p + 12), their means (J, p + 12) from that of all, and their shares (J,).
    """
    each, apart, shares = levels
    for a in range(out.shape[0]):
        for b in range(out.shape[0]):
            total = 0.0
            for j in range(len(shares)):
                total += shares[j] * (each[j, a, b] + apart[j, a] * apart[j, b])
            out[a, b] = total


@part
def exchange_levels(levels, whole, rule, out):  # type: ignore[no-untyped-def]
    """Levels after some time, of which each may have become any other: mean and covariance of what became of all.

    ``whole``: the covariance of all; ``rule``: shares (J,) of what changes level, and the chance that it does not.
    """
    each, apart, shares = levels
    usual, kept = rule
    covariance, offset, share = out
    for j in range(len(shares)):
        share[j] = kept * shares[j] + (1.0 - kept) * usual[j]
        same = kept * shares[j] / max(share[j], 1e-300)
        for a in range(whole.shape[0]):
            offset[j, a] = same * apart[j, a]
        for a in range(whole.shape[0]):
            for b in range(whole.shape[0]):
                own = each[j, a, b] + apart[j, a] * apart[j, b] - whole[a, b]
                covariance[j, a, b] = whole[a, b] + same * own - offset[j, a] * offset[j, b]


@part
def bend_levels(levels, whole, step, along, out):  # type: ignore[no-untyped-def]
    """Predicted levels as they are where a step (p,) takes the body, into ``out``, and the step ``along`` its arc.

    What its points leave open may stay as it is in the body's frame, or in the camera's: it is in either, see
    `rootmatch.problems.pose_fit.reference_point.covariance_in_either_axes`. ``whole``: the covariance of all, given and
    then of the levels there.
    """
    each, apart, shares = levels
    rows, size = whole.shape[0], step.shape[0]
    for i in range(size):
        along[i] = step[i]
    curved = whole[0, 0] + whole[1, 1] + whole[2, 2] >= STRAIGHT * STRAIGHT
    turn, turned = np.empty((3, 3)), np.empty((rows, rows))
    if curved:
        fill_arc_motion(along)
        fill_rotation(step[0], step[1], step[2], turn)
    for j in range(len(shares)):
        if curved:
            turn_covariance(each[j], turn, size, turned)
            combine_axes(each[j], turned, np.empty((rows, rows)), np.empty(rows), out[j])
        else:
            for a in range(rows):
                for b in range(rows):
                    out[j, a, b] = each[j, a, b]
    if curved:
        average_levels((out, apart, shares), whole)


@part
def _solve_rows(root, rows, column, out):  # type: ignore[no-untyped-def]
    """Columns of ``out`` (p, p): the rows (p, p) solved by a triangular root; ``column`` (p,): scratch."""
    size = len(column)
    for i in range(size):
        for j in range(size):
            column[j] = rows[i, j]
        solve_lower(root, size, column)
        for j in range(size):
            out[j, i] = column[j]


@part
def find_axes(predicted, fitted, axes, back, left):  # type: ignore[no-untyped-def]
    """Axes in which the pose of a fit is uncorrelated, and its prediction is too, with the variance 1.

    ``predicted``, ``fitted``: covariances (p, p) of either. Filled are ``axes`` (p, p), whose rows times a pose are
    along them, its inverse ``back``, and ``left`` (p,), variances of the fit.
    """
    size = len(left)
    root, white, vectors = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    column = np.empty(size)
    for i in range(size):
        for j in range(i + 1):
            root[i, j] = predicted[i, j]
    factorise(root, size, 1e-300)
    _solve_rows(root, fitted, column, vectors)
    _solve_rows(root, vectors, column, white)
    for i in range(size):
        for j in range(i):
            white[i, j] = white[j, i] = 0.5 * (white[i, j] + white[j, i])
    diagonalise(white, vectors)
    for c in range(size):
        left[c] = max(white[c, c], 1e-300)
        for i in range(size):
            column[i] = 1.0 if i == c else 0.0
        solve_lower(root, size, column)
        for i in range(size):
            axes[i, c], back[c, i] = 0.0, 0.0
            for k in range(size):
                axes[i, c] += vectors[k, i] * column[k]
                back[c, i] += root[c, k] * vectors[k, i] if k <= c else 0.0


@part
def take_in_level(level, seen, out):  # type: ignore[no-untyped-def]
    """A level after a measurement of its pose, and the logarithm of how well it predicted that, up to a constant.

    Parameters
    ----------
    level : tuple
        Covariance (p + 12, p + 12) and mean (p + 12,) from that of all.
    seen : tuple
        Axes (p, p) and back, see `find_axes`; what is measured along each (p,) and how precisely, 0 where nothing is.
    out : tuple
        Covariance and mean, and the gain (p + 12, p) of what is measured along each axis; filled.
    """
    P, offset = level
    axes, back, measured, precision = seen
    covariance, mean, gain = out
    rows, size = P.shape[0], len(precision)
    with_seen, total, inverse = np.empty((rows, size)), np.empty((size, size)), np.empty((size, size))
    residual = np.empty(size)
    for i in range(size):
        unit, here = math.sqrt(precision[i]), 0.0
        for k in range(size):
            here += axes[i, k] * offset[k]
        residual[i] = unit * (measured[i] - here)
        for a in range(rows):
            with_seen[a, i] = 0.0
            for k in range(size):
                with_seen[a, i] += unit * P[a, k] * axes[i, k]
    for i in range(size):
        for j in range(i + 1):
            total[i, j] = 1.0 if i == j else 0.0
            for k in range(size):
                total[i, j] += math.sqrt(precision[i]) * axes[i, k] * with_seen[k, j]
    factorise(total, size, 1e-300)
    invert_factored(total, size, inverse)
    for a in range(rows):
        mean[a] = offset[a]
        for i in range(size):
            gain[a, i] = 0.0
            for k in range(size):
                gain[a, i] += with_seen[a, k] * inverse[k, i]
            mean[a] += gain[a, i] * residual[i]
    for a in range(rows):
        for b in range(a + 1):
            value = 0.5 * (P[a, b] + P[b, a])
            for i in range(size):
                value -= 0.5 * (gain[a, i] * with_seen[b, i] + gain[b, i] * with_seen[a, i])
            covariance[a, b] = covariance[b, a] = value
    # along what is seen, without differences of large numbers
    along = np.empty((size, rows))
    for i in range(size):
        for b in range(rows):
            along[i, b] = gain[b, i] / math.sqrt(precision[i]) if precision[i] > 0.0 else 0.0
            for k in range(size if precision[i] == 0.0 else 0):
                along[i, b] += axes[i, k] * covariance[k, b]
    for a in range(size):
        for b in range(size, rows):
            covariance[a, b] = 0.0
            for i in range(size):
                covariance[a, b] += back[a, i] * along[i, b]
            covariance[b, a] = covariance[a, b]
        for b in range(a + 1):
            value = 0.0
            for i in range(size):
                value += 0.5 * (back[a, i] * along[i, b] + back[b, i] * along[i, a])
            inverse[a, b] = value
    for a in range(size):
        for b in range(a + 1):
            covariance[a, b] = covariance[b, a] = inverse[a, b]
    told = 0.0
    for i in range(size):
        told -= math.log(total[i, i])
        for k in range(i + 1):
            residual[i] -= total[i, k] * residual[k] if k < i else 0.0
        residual[i] /= total[i, i]
        told -= 0.5 * residual[i] * residual[i]
        for a in range(rows):
            gain[a, i] *= math.sqrt(precision[i])
    return told
