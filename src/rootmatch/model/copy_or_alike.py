"""What stands in another place where a body fits: an exact copy of it, or something else of nearly its shape.

Of two places, either may show the body and the other one a copy. Against clutter both are far too good to be accidents,
however much worse one of them fits. What misses a point that stands beside its place, or has all of them a little off,
is more probably something alike; and where the body is, there is only what an exact copy would be.

All points of what is alike are off, as `rootmatch.model.image_alike` has it, or some of them are somewhere else. The
body may be so as well, if seldom: then it is what stands there.

In a single place something else may stand as well, with a detection beside the place of a point that has no match.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_poses, weigh_assignments
from rootmatch.model.image_alike import (
    ERRORS,
    LOG_ALIKE,
    LOG_INEXACT,
    OWN,
    REACH,
    alike_log_odds,
    cache_answer,
    perturb_points,
)
from rootmatch.model.linearised import Linearised
from rootmatch.model.modes import Modes
from rootmatch.model.prediction import HIDDEN
from rootmatch.model.priors import COPY, INEXACT, WRONG_MODEL

LOG_OFF = math.log(INEXACT / len(ERRORS))
"""Log-odds that one of a body's points is off by each of `ERRORS`, of those that all are as given."""
FAR = ERRORS[OWN:]
"""Those of points that are somewhere else: beyond what all points of a body may be off by."""
ANOTHER = 0.5
"""Probability that one more point of what is alike is somewhere else: as probably as not."""
TRIED, MAXIMUM = 16, 8
"""Most points that are tried as the one that is somewhere else, and most that are so together. Round values; they bound
time."""


def log_alike_factor(model: DetectionModel, modes: Modes, k: int, taken: Bools) -> float:
    """Logarithm of the factor on the odds of a copy in the place of a mode: something alike may be there instead.

    ``k``: which mode; ``taken`` (n',): detections of the body in its own place, and of others.

    Returns
    -------
    float
        log (1 + E / I), with the odds E of something alike against an exact copy, and I those of a copy that is as
        exact as the body, against an exact one.
    """
    all_off, (given, some_off) = log_odds_all_off(model, modes, k, taken), log_odds_some_off(model, modes, k, taken)
    own, other = _with_priors(some_off)
    body, alike = [max(given, 0.0), *(all_off[:OWN] + LOG_INEXACT), *own], [*(all_off + LOG_ALIKE), *other]
    odds = np.logaddexp.reduce(alike) - math.log(COPY) - np.logaddexp.reduce(body)
    return float(np.logaddexp(0.0, odds))


def log_odds_of_points_elsewhere(model: DetectionModel, modes: Modes, k: int, taken: Bools | None = None) -> float:
    """Log-odds of something else that has points elsewhere, of the body as it is or with its own points there.

    In one image, by the detections that are near the points without a match; −∞ without any. Parameters are those of
    `rootmatch.model.image_alike.alike_log_odds`.
    """
    matched = modes.assignments[k][modes.assignments[k] >= 0]
    taken = np.zeros(model.shape[1], np.bool_) if taken is None else taken
    free = ~taken
    free[matched] = False
    (missed,) = ((modes.assignments[k] < 0) & (modes.visible[k] > HIDDEN)).nonzero()
    if not len(missed) or not free.any() or not np.isfinite(modes.covariance[k]).all():
        return -math.inf
    at = model.linearise_about(modes.rotation[k : k + 1], modes.position[k : k + 1])
    jacobian, by_point = at.jacobian[0, missed], FAR[-1] * model.radius * at.by_position[0, missed]
    variance = ((jacobian @ modes.covariance[k]) * jacobian).sum(axis=(1, 2)) + (by_point**2).sum(axis=(1, 2))
    squared = ((model.target[free] - at.pixels[0, missed, None]) ** 2).sum(axis=2)
    near = missed[squared.min(axis=1) < REACH**2 * (variance + model.sigma[free].max() ** 2)]
    if not len(near):
        return -math.inf
    given, some_off = log_odds_some_off(model, modes, k, taken, tuple(near.tolist()))
    own, other = _with_priors(some_off)
    return float(np.logaddexp.reduce(other) - np.logaddexp.reduce([max(given, 0.0), *own])) if len(other) else -math.inf


def _with_priors(some_off: Floats) -> tuple[Floats, Floats]:
    """Log-odds (m,) of the body, and of something alike, with one, two … points off; by those (m, W) of each size."""
    odds, count = np.logaddexp.reduce(some_off, axis=1) - math.log(len(ERRORS)), 1.0 + np.arange(len(some_off))
    return odds + count * math.log(INEXACT), odds + math.log(WRONG_MODEL) + count * math.log(ANOTHER)


def log_odds_all_off(model: DetectionModel, modes: Modes, k: int, taken: Bools) -> Floats:
    """Log-odds (W,) of a body of which all points are off by each of `ERRORS`: by its matches, or all that is near.

    Over the body as given, with all changes of the mode. Parameters are those of `log_alike_factor`.
    """
    at, own = model.linearise_about(modes.rotation[k : k + 1], modes.position[k : k + 1]), modes.assignments[k : k + 1]
    wide = [perturb_points(model, error) for error in ERRORS * model.radius]
    matched = np.array([float(weigh_assignments(one, own, at).log_odds[0]) for one in wide]) - modes.log_mass[k]
    near = alike_log_odds(model, modes, k, taken)
    return np.asarray(matched if near is None else np.maximum(matched, near))


def log_odds_some_off(
    model: DetectionModel, modes: Modes, k: int, taken: Bools, tried: tuple[int, ...] = ()
) -> tuple[float, Floats]:
    """Log-odds (m, W) of a body of which one, two … points are off by each of `FAR`, about the pose of a mode.

    Any point may be the one, and any two the two, of which the best stand for the sum. Over the body as given, with all
    changes of the mode. Before them, those of the body as given with what is nearest to these points in its place: what
    another labelling explains does not tell that points are off. No rows where points are joined in blobs, or where so
    few tell the pose that none can be left out. Parameters are those of `log_alike_factor`; ``tried``: points that may
    be off, all if there are none.
    """
    if model.resolution:
        return -math.inf, np.empty((0, len(FAR)))
    mode = modes.assignments[k], modes.rotation[k : k + 1], modes.position[k : k + 1]
    given, off = cache_answer(_weigh_some_off, model, mode, ~taken, tried)
    return float(given - modes.log_mass[k]), np.asarray(off - modes.log_mass[k])


def _weigh_some_off(
    model: DetectionModel, mode: tuple[Integers, Floats, Floats], free: Bools, tried: tuple[int, ...]
) -> tuple[float, Floats]:
    """Log-odds against clutter alone, as of `log_odds_some_off`; ``free`` (n',): what may be matched."""
    n = model.shape[0] // max(len(model.images), 1)
    points = np.array(tried or range(n))
    order, each = _weigh_sets_off(model, mode, np.eye(n, dtype=np.bool_)[points], free)
    order = points[order]
    if not len(order):
        return -math.inf, np.empty((0, len(FAR)))
    out = [np.logaddexp.reduce(each, axis=0) - math.log(n)]
    given = float(each[:, 0].max())
    surest = order[np.argsort(-each[:, 1:].max(axis=1), kind="stable")][:MAXIMUM]
    if len(surest) > 1:
        sets = np.zeros((len(surest) - 1, n), np.bool_)
        for count, one in enumerate(sets, 2):
            one[surest[:count]] = True
        which, more = _weigh_sets_off(model, mode, sets, free)
        given = max(given, float(more[:, 0].max(initial=-math.inf)))
        out += [more[row] - math.log(math.comb(n, which[row] + 2)) for row in np.argsort(which)]
    return given, np.array(out)[:, 1:]


def _weigh_sets_off(
    model: DetectionModel, mode: tuple[Integers, Floats, Floats], sets: Bools, free: Bools
) -> tuple[Integers, Floats]:
    """Which sets (K, n) of points can be off, and log-odds (K', 1 + W) of that by nothing and each of `FAR`.

    The most probable first.
    """
    (assignment, rotation, position), images = mode, max(len(model.images), 1)
    pose = np.repeat(rotation, len(sets), axis=0), np.repeat(position, len(sets), axis=0)
    off = np.tile(sets, (1, images))
    without = np.where(off, -1, assignment)
    found, at = settle_poses(model, without, *pose)
    (order,) = (np.isfinite(found.log_odds) & ((without >= 0).sum(axis=1) >= model.prior.minimum)).nonzero()
    order = order[np.argsort(-found.log_odds[order], kind="stable")][:TRIED]
    errors = model.radius * np.append(0.0, FAR)
    out = np.empty((len(order), len(errors)))
    for row, one in enumerate(order.tolist()):
        place, shown = (at.one(one), found.covariance[one], without[one]), off[one] & (found.visible[one] > HIDDEN)
        for w in range(len(errors))[::-1]:  # what is too far for the largest errors is so for all
            wide = perturb_points(model, errors[w], off[one])
            own = _assign_nearest_free(wide, place, shown.nonzero()[0], free)
            if (own == place[2]).all():
                out[row, : w + 1] = found.log_odds[one]
                break
            out[row, w] = float(weigh_assignments(wide, own[None], place[0]).log_odds[0])
    return order, out


def _assign_nearest_free(
    wide: DetectionModel, place: tuple[Linearised, Floats, Integers], rows: Integers, free: Bools
) -> Integers:
    """An assignment (n,) with the nearest free detection of some points, in its own image, if one is within `REACH`.

    ``place``: images of the points, covariance of the pose, and the assignment without these points.
    """
    at, by_pose, assignment = place
    out, free, images = assignment.copy(), free.copy(), max(len(wide.images), 1)
    free[assignment[assignment >= 0]] = False
    of_points = wide.of_points(at)
    for row in rows.tolist():
        own = free & (wide.image_indices == row // (wide.shape[0] // images))
        (which,) = (own if wide.allowed is None else own & wide.allowed[row]).nonzero()
        if len(which):
            spread = at.jacobian[0, row] @ by_pose @ at.jacobian[0, row].T + of_points[0, row]
            off = wide.target[which] - at.pixels[0, row]
            squared = (off @ np.linalg.inv(spread + wide.sigma[which].max() ** 2 * np.eye(2)) * off).sum(axis=1)
            if squared.min() < REACH**2:
                out[row] = which[squared.argmin()]
                free[out[row]] = False
    return out
