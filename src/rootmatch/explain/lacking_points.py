"""Points that a body lacks by its own law: a box of which seven corners were measured has eight.

Half a turn takes back what it does, so nothing goes on by it; but where it puts most points of a body onto others, and
some onto none, either these break its law, as a landmark does, or the body lacks points in those places. Each of these
exists with the share of points that obey the law. If it exists, it is one more point of the same body in the same pose,
which is detected as the others are, so a pose whose image shows it is that much more probable. Without that, half a
turn later, what is detected there is a point of the body, and that pose explains more.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_identity, cache_by_values
from rootmatch.explain.continued_bodies import LIKELY, continue_body
from rootmatch.explain.more_places import Beside, Places, log_shown_chance
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_poses
from rootmatch.model.modes import Modes
from rootmatch.model.near_symmetries import TOLERANCE, NearSymmetry, find_symmetries, same_point_tolerance
from rootmatch.model.posterior import Posterior
from rootmatch.model.prediction import GATE
from rootmatch.problems.points import mutual_nearest

LACKING = 0.02
"""Odds that a body lacks a point, before its law is asked. A stated value, not measured."""


class Lacking(NamedTuple):
    """Where a body may lack points by its own law."""

    places: Places
    chance: Floats
    """(m,) probability that a point is there."""


@cache_by_identity(64)
@cache_by_values(64)
def lacking_points(source: Floats, normals: Floats | None) -> Lacking:
    """Places onto which motions that map many points of a body (n, 3) put others; none mostly.

    Where the laws make a point less probable than anywhere, as that of a landmark half a turn away, is no place.
    """
    near, found = same_point_tolerance(source), find_symmetries(source, normals)
    known = np.concatenate([source, continue_body(source, normals).points]) if found else source
    places, facing, odds = np.empty((0, 3)), list[Floats](), np.empty(0)
    for laws in _groups(found, source, near):
        image = np.array([one.image for one in laws])
        moved = image != np.arange(len(source))
        obeyed = law_rates((image >= 0) & moved, moved)
        for which, own in np.argwhere(image < 0):
            one, ratio = laws[which], 1.0
            place = one.rotation @ source[own] + one.shift
            if len(_find_in_place(known, place, near)):
                continue
            # with a point there, the laws are obeyed in so many more places, and broken in others
            for other in (law.rotation @ place + law.shift for law in laws):
                if not len(_find_in_place(place[None], other, near)):
                    held = obeyed[_find_in_place(source, other, near)[:1]]
                    ratio *= float((held / (1.0 - held))[0]) if len(held) else 1.0 - float(obeyed[own])
            if ratio <= 1.0:
                continue
            if len(same := _find_in_place(places, place, near)):
                odds[same] = np.maximum(odds[same], ratio)
                continue
            places, odds = np.concatenate([places, place[None]]), np.append(odds, ratio)
            facing.append(place if normals is None else one.rotation @ normals[own])
    odds = LACKING * odds
    normal = None if normals is None else np.array(facing).reshape(-1, 3)
    return Lacking(Places(places, normal, np.zeros(len(places), np.bool_)), odds / (1.0 + odds))


def _groups(laws: Sequence[NearSymmetry], source: Floats, near: float) -> list[list[NearSymmetry]]:
    """Motions that hold together: any two that leave a place as it is, and what they are one after another.

    The symmetries of a finite body all leave its centre as it is.
    """
    if len(laws) < 2:
        return []
    rotations, shifts = np.array([one.rotation for one in laws]), np.array([one.shift for one in laws])
    images, middle = source @ rotations.swapaxes(1, 2) + shifts[:, None], source.mean(axis=0)
    after = images @ rotations[:, None].swapaxes(2, 3) + shifts[:, None, None]
    same = np.linalg.norm(after[:, :, None] - images, axis=4).mean(axis=3) < near
    found = set[tuple[int, ...]]()
    for pair in itertools.combinations(range(len(laws)), 2):
        turns = np.concatenate(rotations[list(pair)] - np.eye(3))
        moved = (rotations[list(pair)] @ middle + shifts[list(pair)] - middle).ravel()
        centre = middle - np.linalg.lstsq(turns, moved, rcond=TOLERANCE)[0]
        fixed = np.linalg.norm(rotations @ centre + shifts - centre, axis=1) < near
        own = np.isin(np.arange(len(laws)), pair)
        while fixed[own].all() and (more := same[own][:, own].any(axis=(0, 1)) & fixed & ~own).any():
            own |= more
        if fixed[own].all():
            found.add(tuple(np.flatnonzero(own).tolist()))
    return [[laws[k] for k in one] for one in sorted(found)]


def law_rates(held: Bools, moved: Bools) -> Floats:
    """Probability (n,) that a point obeys a law, of two kinds: those that obey any, and those that obey none.

    ``held``, ``moved``: (L, n) which points each law puts onto another point, and which elsewhere than where they are.
    """
    out = np.empty(held.shape[1])
    for kind in (held.any(axis=0), ~held.any(axis=0)):
        out[kind] = (held[:, kind].sum() + 1.0) / (moved[:, kind].sum() + 2.0)
    return out


def _find_in_place(points: Floats, place: Floats, near: float) -> Integers:
    """Those of some points (n, 3) that are in a place (3,)."""
    return np.flatnonzero(np.linalg.norm(points - place, axis=1) < near)


def allow_lacking(told: Posterior, model: DetectionModel, lacking: Lacking, taken: Bools | None) -> Posterior:
    """A posterior in which the body may have the points that it lacks by its own law.

    The same where none of their places has a detection. ``taken``: (n',) detections of other bodies.
    """
    if not len(lacking.chance) or not told.shown >= LIKELY:
        return told
    beside = Beside(model, lacking.places, taken)
    every = [_log_factor(beside, mode, lacking.chance) for mode in beside.each(told)]
    return told.beside(np.array(every), -math.inf) if any(every) else told


def _log_factor(beside: Beside, mode: Modes, there: Floats) -> float:
    """Logarithm of the factor on the weight of a mode by what it leaves in places with the chance (m,) of a point."""
    left = beside.unused_detections(mode)
    if not left.any():
        return 0.0
    off = beside.off_by(mode)
    off[:, ~left] = np.inf
    if beside.others.allowed is not None:
        off[~beside.others.allowed] = np.inf
    more = mutual_nearest(off, GATE**2)
    if not (more >= 0).any():
        return 0.0
    own, more = mode.assignments.reshape(beside.images, -1), more.reshape(beside.images, -1)
    labels = np.concatenate([own, more], axis=1)
    found = weigh_poses(beside.whole, labels.reshape(1, -1), mode.rotation, mode.position)[0]
    density = found.place_log_odds - (mode.log_odds - mode.detected)
    if not np.isfinite(density[0]):  # a place that cannot be seen
        return 0.0
    chance = np.concatenate([np.ones(own.shape[1]), there])
    chances, (rates, log_weights) = found.visible[0].reshape(beside.images, -1) * chance, beside.model.rate_quadrature
    none = np.concatenate([own, np.full_like(more, -1)], axis=1)
    shown = [log_shown_chance(chances.ravel(), one.ravel() >= 0, rates, log_weights) for one in (labels, none)]
    return float(np.logaddexp(0.0, density[0] + shown[0] - shown[1]))
