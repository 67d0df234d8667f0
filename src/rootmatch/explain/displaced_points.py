"""Points of a matched body that have no match, and a detection near their place: the body may be bent, or another one.

A point that has no detection is hidden or dark, and what lies near its place is clutter by chance. Or it is somewhere
else on the body by N(0, τ² I), with τ of the sizes of `rootmatch.model.image_alike.ERRORS`, and is seen there by every
camera: of a body that is not as it was given, one point is, and each is as probable. Both have the evidence of the
model, with that point less certain. The advice names what is more probable than the other, and than the point in its
place.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Integers
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.point_set_decision import make_point_set_model
from rootmatch.model.copy_or_alike import LOG_OFF
from rootmatch.model.evidence import settle_poses
from rootmatch.model.image_alike import ERRORS, REACH, perturb_points
from rootmatch.model.prediction import HIDDEN
from rootmatch.problems.pose_fit.reference_point import body_radius


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
    if found.status is not Status.MATCHED:
        return []
    left = np.ones(found.task.shape[1], np.bool_) if taken is None else ~taken
    left[found.assignment[found.assignment >= 0]] = False
    in_set = found.labellings is not None
    return _find_displaced_in_set(found, left) if in_set else _find_displaced_in_image(found, left)


def _find_displaced_in_image(found: Finding, left: Bools) -> list[Displaced]:
    """The same of images: in each the nearest detection that is left (n',) is a point's own, if that is off."""
    model, told, own, out = found.model, found.posterior, found.assignment, list[Displaced]()
    if model is None or told is None or not found.task.problem.takes_prior or found.point_error or model.resolution:
        return out
    place = slice(found.mode, found.mode + 1)
    pose = told.modes.rotation[place], told.modes.position[place]
    at, errors, images = model.linearise_about(*pose), ERRORS * model.radius, max(len(model.images), 1)
    rows = np.arange(model.shape[0]).reshape(images, -1)
    reach = REACH * errors[-1] * np.linalg.norm(at.by_position[0], axis=(1, 2))
    away = np.linalg.norm(model.target - at.pixels[0][:, None], axis=2)
    may = left & (np.repeat(np.arange(images), rows.shape[1])[:, None] == model.image_indices)
    may &= (away < reach[:, None]) & (told.modes.visible[found.mode] > HIDDEN)[:, None]
    away = np.where(may, away, np.inf)
    nearest = np.where(np.isfinite(away.min(axis=1, initial=np.inf)), away.argmin(axis=1), -1)
    missing = (own[rows] < 0).all(axis=0) & (nearest[rows] >= 0).any(axis=0)
    for point in np.flatnonzero(missing).tolist():
        off = np.tile(np.arange(rows.shape[1]) == point, images)
        each = np.array([own, *[np.where(off, nearest, own)] * (1 + len(errors))])
        wide = [model, model, *(perturb_points(model, error, off) for error in errors)]
        odds = [float(settle_poses(m, one[None], *pose)[0].log_odds[0]) for m, one in zip(wide, each, strict=True)]
        if _is_displaced(odds, rows.shape[1]):
            seen = rows[:, point][nearest[rows[:, point]] >= 0]
            out.append(Displaced(point, nearest[seen], float(away[seen, nearest[seen]].max())))
    return out


def _find_displaced_in_set(found: Finding, left: Bools) -> list[Displaced]:
    """The same between two point sets, where ``left`` (n',) are targets."""
    model, assignment, out = make_point_set_model(found.task), found.assignment, list[Displaced]()
    if model is None or not left.any():
        return out
    one, n = model.judge_one(assignment), len(assignment)
    errors = ERRORS * body_radius(model.clouds.source)
    away = np.where(left, np.linalg.norm(one.fit.places[0][0][:, None] - model.clouds.target, axis=2), np.inf)
    nearest, near = away.argmin(axis=1), away.min(axis=1) < REACH * float(one.fit.scale[0]) * errors[-1]
    for point in np.flatnonzero((assignment < 0) & near).tolist():
        off = np.arange(n) == point
        clouds = [model.clouds.off_by(np.where(off, error, 0.0)) for error in (0.0, *errors.tolist())]
        own = np.where(off, nearest, assignment)[None]
        odds = [float(replace(model, clouds=one_off).judge(own).log_odds[0]) for one_off in clouds]
        if _is_displaced([float(one.log_odds[0]), *odds], n):
            out.append(Displaced(point, nearest[point : point + 1], float(away[point].min())))
    return out


def _is_displaced(odds: list[float], n: int) -> bool:
    """Whether one of n points is more probably somewhere else than hidden, or in its place with what is near it.

    ``odds``: log-odds of the body without the point, with it in its place, and off by each of `ERRORS`.
    """
    return LOG_OFF - math.log(n) + float(np.logaddexp.reduce(odds[2:])) >= max(odds[:2])


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
