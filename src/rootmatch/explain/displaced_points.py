"""Points of a matched body that have no match, and a detection near their place: the body may be bent, or another one.

A point that has no detection is hidden or dark, and what lies near its place is clutter by chance. Or it is somewhere
else on the body by N(0, τ² I), with τ of the sizes of `rootmatch.model.image_alike.ERRORS`, and is seen there by every
camera: of a body that is not as it was given, one point is, and each is as probable. The advice names what is more
probable than the other.

Between two point sets both are labellings, and their odds are those of the model with that point less certain.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.point_set_decision import make_point_set_model
from rootmatch.model.copy_or_alike import LOG_OFF
from rootmatch.model.detection_model import USUAL_RATE, DetectionModel
from rootmatch.model.image_alike import ERRORS, REACH
from rootmatch.model.linearised import Linearised
from rootmatch.model.prediction import HIDDEN
from rootmatch.problems.pose_fit.reference_point import body_radius

MINIMUM = 0.0
"""Log-odds from which a point is said to be somewhere else: where that is more probable than not."""


class Displaced(NamedTuple):
    """A point that is probably not where the model has it."""

    point: int
    """Its index among those of the body."""
    detections: Integers
    """(C',) detections that are its own then, one in each camera that has one."""
    off: float
    """Their largest distance from where the point is expected, px; between point sets in units of the target."""


def find_displaced_points(found: Finding, taken: Bools | None) -> list[Displaced]:
    """Points of a trusted body that are probably somewhere else; ``taken``: (n',) detections of other bodies."""
    model, told, problem = found.model, found.posterior, found.task.problem
    if found.status is Status.MATCHED and found.labellings is not None:
        return _find_displaced_in_set(found, taken)
    if found.status is not Status.MATCHED or model is None or told is None or not problem.takes_prior:
        return []
    modes, k = told.modes, found.mode
    at = model.linearise_about(modes.rotation[k : k + 1], modes.position[k : k + 1])
    if found.point_error or at.blob is not None or not np.isfinite(modes.covariance[k]).all():
        return []
    free = np.ones(model.shape[1], np.bool_) if taken is None else ~taken
    free[found.assignment[found.assignment >= 0]] = False
    lit = USUAL_RATE * np.where(at.seen[0], modes.visible[k], 0.0)
    rows = np.arange(len(lit)).reshape(max(len(model.images), 1), -1)
    candidates = (rows[:, one] for one in np.flatnonzero((found.assignment[rows] < 0).all(axis=0)))
    every = [_judge_displacement(model, _Place(at, modes.covariance[k], lit), own, free) for own in candidates]
    return [one for one in every if one is not None]


def _find_displaced_in_set(found: Finding, taken: Bools | None) -> list[Displaced]:
    """The same between two point sets: the nearest target that is left is a point's own, if that is off."""
    from scipy.stats import chi2  # slow to import

    model, assignment, out = make_point_set_model(found.task), found.assignment, list[Displaced]()
    left = np.ones(found.task.shape[1], np.bool_) if taken is None else ~taken
    left[assignment[assignment >= 0]] = False
    if model is None or not left.any():
        return []
    one, n = model.judge_one(assignment), len(assignment)
    errors = ERRORS * body_radius(model.clouds.source)
    away = np.where(left, np.linalg.norm(one.fit.places[0][0][:, None] - model.clouds.target, axis=2), np.inf)
    nearest, squared = away.argmin(axis=1), one.fit.predictions(0)[0][np.arange(n), away.argmin(axis=1)]
    near = away.min(axis=1) < REACH * float(one.fit.scale[0]) * errors[-1]
    apart = squared > float(chi2.isf(TRUST.noise_chance, model.clouds.target.shape[1]))
    for point in np.flatnonzero((assignment < 0) & near & apart):
        own = np.where(np.arange(n) == point, nearest, assignment)
        clouds = [model.clouds.off_by(np.where(np.arange(n) == point, error, 0.0)) for error in errors]
        odds = [float(replace(model, clouds=one_off).judge(own[None]).log_odds[0]) for one_off in clouds]
        if LOG_OFF - math.log(n) + float(np.logaddexp.reduce(odds)) - float(one.log_odds[0]) >= MINIMUM:
            out.append(Displaced(int(point), nearest[point : point + 1], float(away[point].min())))
    return out


class _Place(NamedTuple):
    """Where a pose with its covariance (6, 6) has the points, and the chance (n,) that each is detected there."""

    at: Linearised
    covariance: Floats
    lit: Floats

    def off(self, model: DetectionModel, rows: Integers, detections: Integers) -> tuple[Floats, Floats, Floats]:
        """Deviations (2 m,) of m detections, their covariance by noise and pose, and Jacobian (2 m, 3) by the point."""
        jacobian = self.at.jacobian[0, rows].reshape(-1, 6)
        by_pose = jacobian @ self.covariance @ jacobian.T
        if model.source_covariance is not None:
            known = self.at.jacobian[0, rows][..., 3:] @ self.at.rotation[0]
            own = known @ model.source_covariance[rows] @ known.swapaxes(1, 2)
        else:
            own = np.zeros((len(rows), 2, 2))
        if model.target_covariance is None:
            own = own + model.sigma[detections, None, None] ** 2 * np.eye(2)
        else:
            own = own + model.target_covariance[detections]
        for k, block in enumerate(own):
            by_pose[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += block
        return (model.target[detections] - self.at.pixels[0, rows]).ravel(), by_pose, jacobian[:, 3:]


def _judge_displacement(model: DetectionModel, place: _Place, rows: Integers, free: Bools) -> Displaced | None:
    """The point that has these rows, one in each camera, if it is probably somewhere else."""
    from scipy.stats import chi2  # slow to import

    errors, shown = ERRORS * body_radius(model.points), rows[place.lit[rows] > USUAL_RATE * HIDDEN]
    nearest = []
    for image, row in enumerate(rows):
        (own,) = np.nonzero(free & (model.image_indices == image))
        if row in shown and len(own):
            squares = ((model.target[own] - place.at.pixels[0, row]) ** 2).sum(axis=1)
            nearest.append((row, own[np.argmin(squares)]))
    if not nearest:
        return None
    seen, detections = np.array(nearest).T
    off, narrow, by_point = place.off(model, seen, detections)
    if float(off @ np.linalg.solve(narrow, off)) < float(chi2.isf(TRUST.noise_chance, len(off))):
        return None  # it is where the model has it, and was left out for another reason
    wide = narrow + errors[:, None, None] ** 2 * (by_point @ by_point.T)
    squared = np.einsum("i,kij,j->k", off, np.linalg.inv(wide), off)
    fits = -0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * wide)[1])
    log_odds = LOG_OFF - math.log(model.shape[0] // max(len(model.images), 1)) + float(np.logaddexp.reduce(fits))
    log_odds -= math.log1p(-USUAL_RATE)  # what is dark is so in all cameras
    count = np.bincount(model.image_indices[free])[model.image_indices[detections]]
    log_odds -= float(np.log(count - 0.5).sum())  # any clutter point may be the one that is near
    missed = np.setdiff1d(shown, seen)
    log_odds += float(np.log(place.lit[seen]).sum() + np.log1p(-place.lit[missed]).sum())
    log_odds -= float(model.clutter.log_density[detections].sum())
    largest = float(np.hypot(*off.reshape(-1, 2).T).max())
    return Displaced(int(rows[0]), detections, largest) if log_odds >= MINIMUM else None


def point_advice(found: Finding, whole: Finding | None) -> str:
    """What `find_displaced_points` finds, as a part of advice; empty if it finds nothing.

    ``whole``: of one of several bodies, the finding of all.
    """
    told, taken = "", None
    if whole is not None:
        taken = np.bincount(whole.assignment[whole.assignment >= 0], minlength=whole.task.shape[1]) > 0
    for one in find_displaced_points(found, taken):
        in_image = found.labellings is None and found.task.points.target.shape[1] == 2
        in_pixels = found.task.rig is not None or in_image
        sigma = float(found.task.points.detection_noise[one.detections].mean())
        off = f"{one.off:.2g} px" if in_pixels else f"{one.off / sigma:.2g} σ"
        where = f" in {len(one.detections)} cameras" if len(one.detections) > 1 else ""
        told += (
            f"; point {one.point} seems displaced: a detection is {off} from where the model puts it{where}; the "
            "body may be bent, or another one"
        )
    return told
