"""Labellings of a source that may be exactly symmetric, though its points were measured with errors.

What is measured of such a source tells nothing of which way round it is. So it is what was measured, or symmetric with
the most probable points by that: the formula of `rootmatch.model.exact_shapes`, for the motion of two point sets.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.rotation import turn_jacobian
from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.deadline import checkpoint
from rootmatch.model.exact_symmetry import ExactShape, fit_exact_shape, leave_points_out
from rootmatch.model.labelling_sums import is_same_motion
from rootmatch.model.point_set_model import Judged, PointSetModel, log_student_factor
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.problems.pose_fit.point_set_fit import RANGE_OF_LOG, TURN

LEADING = 0.01
"""Share of the best hypothesis above which it is asked which other ones a self-motion makes of it."""
NEGLIGIBLE = 12.0
"""Log-odds against a shape beyond which it is ignored. A round value."""
SHAPES = 4
"""Largest number of shapes by ever more of the self-motions. A round value."""
MOTIONS = 48
"""Largest number of self-motions that are tested. A round value."""


def is_turned(assignments: Integers, first: Integers) -> Bools:
    """Which labellings (K, n) give other points to the targets of a first one (n,), by another motion."""
    same = (np.sort(assignments, axis=1) == np.sort(first)).all(axis=1)
    return np.asarray(same & ~is_same_motion(assignments, first))


def share_by_exact_shapes(model: PointSetModel, found: Judged, log_mass: Floats) -> Floats:
    """Logarithms (K,) of the masses of labellings whose source may be exactly symmetric, given those by its points.

    All labellings about a motion gain what one of them does, which has the same targets as those of other motions.
    These motions have the mass that they had, together.
    """
    labels, out, left = found.fit.assignments, log_mass.copy(), np.ones(len(log_mass), np.bool_)
    base = log_mass - found.known
    for a in np.argsort(-base, kind="stable").tolist():
        if base[a] < base.max() + math.log(LEADING):
            break
        turned, group = left & is_turned(labels, labels[a]), [a]
        while turned.any() and len(group) <= MOTIONS:
            group.append(int(np.where(turned, base, -np.inf).argmax()))
            turned &= ~is_same_motion(labels, labels[group[-1]])
        gains = _log_gains(model, found.take(np.array(group))) if left[a] and len(group) > 1 else None
        if gains is None:
            continue
        about = [left & is_same_motion(labels, labels[k]) for k in group]
        before = np.array([np.logaddexp.reduce(base[own]) for own in about])
        kept = np.logaddexp.reduce(before) - np.logaddexp.reduce(before + gains)
        for own, gain in zip(about, gains, strict=True):
            out[own & left] += gain + kept
            left &= ~own
    return out


def _log_gains(model: PointSetModel, found: Judged) -> Floats | None:
    """Logarithm (K,) of the evidence of labellings of the same targets, over that with the points as measured.

    None if no self-motion may be exact.
    """
    clouds, labels = model.clouds, found.fit.assignments
    images = np.argsort(labels, axis=1, kind="stable")[:, int((labels[0] < 0).sum()) :]  # the point of each target
    images = images[:, images[0].argsort()]  # whatever the order, it is the same question: of every frame
    every, place = np.unique(images, return_inverse=True)
    place = place.reshape(images.shape)
    covariance = clouds.covariances(np.eye(clouds.source.shape[1]))[0][every]
    shapes = _find_shapes(clouds.source[every], covariance, place, model.mirror)
    if not shapes:
        return None
    odds = np.array([0.0, *(one.log_odds for one in shapes)])
    own, *exact = odds - np.logaddexp.reduce(odds)
    gains = np.full(len(labels), -np.inf)
    for h, (share, shape) in enumerate(zip(exact, shapes, strict=True)):
        shares, excess = np.array([share]), np.ones(1)
        if h == 0:
            shares, excess = np.append(own + shape.of_sizes, share), np.append(shape.excess, 1.0)
        for k, points in enumerate(place):
            checkpoint()
            each = shares + _log_gain_of_shape(found, k, (images[k], points), shape, excess)
            gains[k] = np.logaddexp(gains[k], np.logaddexp.reduce(each))
    return gains


@cache_by_values(128)
def _find_shapes(points: Floats, covariance: Floats, images: Integers, mirror: bool) -> tuple[ExactShape, ...]:
    """Exact shapes of points (n, k), by ever more of the self-motions that take images[0] (m,) onto the others (K, m).

    Those first that are exact with one half or more by themselves.
    """
    alone = list[tuple[float, int, Integers, ExactShape]]()
    for one in images[1:]:
        checkpoint()
        shape = fit_exact_shape(points, covariance, [(images[0], one)], mirror)
        if shape is not None and shape.log_odds > -NEGLIGIBLE:
            alone.append((shape.log_odds, len(alone), one, shape))
    alone.sort(key=lambda entry: entry[:2], reverse=True)
    fewest = max(sum(odds >= 0.0 for odds, *_ in alone), 1)
    shapes = list[ExactShape]()
    for count in range(fewest, min(len(alone), fewest + SHAPES - 1) + 1):
        motions = [(images[0], one) for _, _, one, _ in alone[:count]]
        shape = alone[0][3] if count == 1 else fit_exact_shape(points, covariance, motions, mirror)
        if shape is not None:
            shapes += leave_points_out(points, covariance, motions, shape)
    return tuple(shapes)


def _log_gain_of_shape(
    found: Judged, k: int, points: tuple[Integers, Integers], shape: ExactShape, excess: Floats
) -> Floats:
    """Logarithm (S,) of the evidence of labelling k with points of a shape, over that with those measured.

    To first order about its motion. ``points``: those with matches (m,), and their numbers among those of the shape.
    ``excess``: variance of the deviations from the shape, over that of the noise; 1 if it is exact.
    """
    fit, (matched, own) = found.fit.take(slice(k, k + 1)), points
    clouds, size, m, n = fit.clouds, fit.clouds.source.shape[1], len(matched), len(shape.moved)
    linear, target = fit.scale[0] * fit.rotation[0], fit.assignments[0][matched]
    first, second = clouds.covariances(linear)
    white = np.linalg.inv(np.linalg.cholesky(first[matched] + second[target]))
    exact = shape.covariance.reshape(n, size, n, size)[own][:, :, own]
    inward = white @ linear
    # the covariance of all matches with the exact shape, in units of theirs with the measured points
    whole = (inward @ exact.reshape(m, size, -1)).reshape(-1, m, size).swapaxes(0, 1) @ inward.swapaxes(1, 2)
    whole = whole.swapaxes(0, 1).reshape(m, size, m, size)
    whole[np.arange(m), :, np.arange(m)] += white @ second[target] @ white.swapaxes(1, 2)
    values, axes = np.linalg.eigh(whole.reshape(m * size, -1))
    values = np.maximum(values, 1e-9)
    moved = fit.places[0][0, matched]
    about = moved - moved.mean(axis=0)
    parts = [turn_jacobian(about), np.broadcast_to(np.eye(size), (m, size, size)), about[..., None]]
    columns = [
        *parts[: 2 + clouds.scaled],
        (clouds.target[target] - moved)[..., None],
        (shape.moved[own] @ linear.T)[..., None],
    ]
    rows = axes.T @ (white @ np.concatenate(columns, axis=-1)).reshape(m * size, -1)
    ridge = np.zeros(rows.shape[1] - 2)  # a direction that nothing determines counts with its whole range
    ridge[: parts[0].shape[-1]] = 1.0 / TURN**2
    if clouds.scaled:
        ridge[-1] = 1.0 / RANGE_OF_LOG**2
    part = np.append(1.0 / excess, 0.0)  # at last, the measured points
    variance = 1.0 + part[:, None] * (values - 1.0)
    rows, off = rows[:, :-2], rows[:, -2] - part[:, None] * rows[:, -1]
    precision = (rows.T / variance[:, None]) @ rows + np.diag(ridge)
    slope = (off / variance) @ rows
    decrement = (slope * np.linalg.solve(precision, slope[..., None])[..., 0]).sum(axis=1)
    squared = (off**2 / variance).sum(axis=1) - decrement
    every = log_student_factor(np.maximum(squared, 0.0), float(fit.dof[0]), NOISE_FREEDOM)
    every -= 0.5 * (np.log(variance).sum(axis=1) + np.linalg.slogdet(precision)[1])
    return np.asarray(every[:-1] - every[-1])
