"""What stands in another place where a body fits: an exact copy of it, or something else of nearly its shape.

Of two places, either may show the body and the other one a copy. Against clutter both are far too good to be accidents,
however much worse one of them fits. What misses a point that stands beside its place, or has all of them a little off,
is more probably something alike; and where the body is, there is only what an exact copy would be.

All points of what is alike are off, as `rootmatch.model.image_alike` has it, or one of them is somewhere else. The body
may be so as well, if seldom: then it is what stands there.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.frozen import copied
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import evidence, settled_about
from rootmatch.model.image_alike import ERRORS, LOG_ALIKE, LOG_INEXACT, OWN, REACH, log_odds_alike
from rootmatch.model.linearised import Linearised
from rootmatch.model.modes import Modes
from rootmatch.model.prediction import HIDDEN
from rootmatch.model.priors import COPY, INEXACT

LOG_OFF = math.log(INEXACT / len(ERRORS))
"""Log-odds that one of a body's points is off by each of `ERRORS`, of those that all are as given."""
TRIED = 16
"""Most points that are tried as the one that is somewhere else. A round value; it bounds time."""


def log_beside_copy(model: DetectionModel, modes: Modes, k: int, taken: Bools) -> float:
    """Logarithm of the factor on the odds of a copy in the place of a mode: something alike may be there instead.

    Parameters
    ----------
    model : DetectionModel
    modes : Modes
    k : int
        Which of them.
    taken : (n',) bool array
        Detections of the body in its own place, and of others.

    Returns
    -------
    float
        log (1 + E / I), with the odds E of something alike against an exact copy, and I those of a copy that is as
        exact as the body, against an exact one.
    """
    body, alike = [0.0], [-math.inf]
    if (all_off := log_odds_alike(model, modes, k, taken)) is not None:
        body.extend(all_off[:OWN] + LOG_INEXACT)
        alike.extend(all_off + LOG_ALIKE - math.log(COPY))
    if (one_off := log_odds_one_off(model, modes, k, taken)) is not None:
        body.extend(one_off + LOG_OFF)
        alike.extend(one_off + LOG_ALIKE - math.log(COPY))
    return float(np.logaddexp(0.0, np.logaddexp.reduce(alike) - np.logaddexp.reduce(body)))


def log_odds_one_off(model: DetectionModel, modes: Modes, k: int, taken: Bools) -> Floats | None:
    """Log-odds (W,) of a body of which one point is off by each of `ERRORS`, in about the pose of one of the modes.

    Any point may be that one. Over the body as given, with all changes of the mode; None where points are joined in
    blobs, or the pose is told by so few that none can be left out. Parameters are those of `log_beside_copy`.
    """
    if model.resolution:
        return None
    assignment = modes.assignments[k]
    key = model.prior, *(one.tobytes() for one in (assignment, modes.rotation[k], modes.position[k], taken))
    if key not in model.alike:
        model.alike[key] = _one_off(model, modes, k, taken)
    found = model.alike[key]
    return None if found is None else np.asarray(found - modes.log_mass[k])


def _one_off(model: DetectionModel, modes: Modes, k: int, taken: Bools) -> Floats | None:
    """Log-odds (W,) against clutter alone, as of `log_odds_one_off`."""
    n, assignment = model.shape[0] // max(len(model.images), 1), modes.assignments[k]
    without = np.where(np.arange(model.shape[0]) % n == np.arange(n)[:, None], -1, assignment)
    pose = np.repeat(modes.rotation[k : k + 1], n, axis=0), np.repeat(modes.position[k : k + 1], n, axis=0)
    found, at = settled_about(model, without, *pose)
    (possible,) = (np.isfinite(found.log_odds) & ((without >= 0).sum(axis=1) >= model.prior.least)).nonzero()
    if not len(possible):
        return None
    order = possible[np.argsort(-found.log_odds[possible], kind="stable")][:TRIED]
    free, out = ~taken, np.full((len(order), len(ERRORS)), -np.inf)
    for row, point in enumerate(order.tolist()):
        shown = np.flatnonzero((np.arange(model.shape[0]) % n == point) & (found.visible[point] > HIDDEN))
        place = at.one(point), found.covariance[point], without[point]
        for w, error in enumerate(ERRORS * model.radius):
            off = np.zeros((model.shape[0], 3, 3)) if model.source_covariance is None else model.source_covariance + 0.0
            off[point::n] += error**2 * np.eye(3)
            wide = copied(model, source_covariance=off)
            own = _with_nearest(wide, place, shown, free)
            out[row, w] = float(evidence(wide, own[None], place[0]).log_odds[0])
    return np.asarray(np.logaddexp.reduce(out, axis=0) - math.log(n))


def _with_nearest(
    wide: DetectionModel, place: tuple[Linearised, Floats, Integers], rows: Integers, free: Bools
) -> Integers:
    """An assignment (n,) with the nearest free detection of some points, in its own image, if one is within `REACH`.

    ``place``: images of the points, covariance of the pose, and the assignment without these points.
    """
    at, by_pose, assignment = place
    out, free, images = assignment.copy(), free.copy(), max(len(wide.images), 1)
    free[assignment[assignment >= 0]] = False
    of_points = wide.of_points(at)
    assert of_points is not None
    for row in rows.tolist():
        own = free & (wide.image_of == row // (wide.shape[0] // images))
        (which,) = (own if wide.allowed is None else own & wide.allowed[row]).nonzero()
        if len(which):
            spread = at.jacobian[0, row] @ by_pose @ at.jacobian[0, row].T + of_points[0, row]
            off = wide.target[which] - at.pixels[0, row]
            squared = (off @ np.linalg.inv(spread + wide.sigma[which].max() ** 2 * np.eye(2)) * off).sum(axis=1)
            if squared.min() < REACH**2:
                out[row] = which[squared.argmin()]
    return out
