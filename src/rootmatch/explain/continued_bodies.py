"""What goes on by the law of a body that repeats itself, beside it or in its stead: another board on the same squares.

A near symmetry that puts points of a body onto others tells where more of them would be: at the images of points that
have no other in their place. What continues the body has detections there, where the body has no points, and explains
as much as the body does, from wherever its rows are counted. So the image may show

- the body, and detections that are clutter, as the posterior has it;
- the body, and what goes on beside it: beyond its points only, as among them it says itself which places are empty;
- something else alone: a body with a point in every place, of which the image shows any share, or a window; or one as
  large as the body, with a point in each of its holes as well, as another board with other corners missing.

All three have the evidence of `rootmatch.model.evidence`, with places in the stead of points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_identity, cache_by_values
from rootmatch.explain.more_places import Beside, Places, log_shown_chance
from rootmatch.model.compiled.occluder import LOG_FREE, LOG_ODDS, MIN_HIDDEN
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_poses
from rootmatch.model.modes import Modes
from rootmatch.model.near_symmetries import (
    LAW,
    SHARE,
    TOLERANCE,
    find_symmetries,
    neighbour_tolerance,
    same_point_tolerance,
)
from rootmatch.model.posterior import Posterior
from rootmatch.model.prediction import GATE, Settled, settle_assignment
from rootmatch.model.priors import PRESENT_ODDS
from rootmatch.problems.pose_fit.reference_point import body_radius

LOG_CONTINUED = -PRESENT_ODDS
"""Logarithm of the odds that what goes on by the body's law is in view, beside it or without it: what repeats itself is
one of many, so something else of that kind is there as probably as nothing is."""
MAX_PLACES = 400
"""Most places of what continues a body, the body's own points among them. A round value; it bounds time."""
FAR = 2.0
"""Distance of these from the body's centre, over that of its farthest point. A round value; it bounds time."""
ROUNDS = 16
"""Most steps by which a body is continued. A round value; it bounds time."""
MOTIONS = 12
"""Most motions that continue a body. A round value; it bounds time."""
INSIDE = 1e-6
"""Distance beyond the hull of a body, over its radius, up to which a place is within it."""
LIKELY = 0.5
"""Probability that the body is in view from which it is asked whether something else is. A round value."""


@cache_by_identity(64)
@cache_by_values(64)
def continue_body(source: Floats, normals: Floats | None) -> Places:
    """Places that near symmetries of a body (n, 3) lead to from its points, and from there again; none mostly.

    A symmetry leads on from a point that it puts another one onto; so what does not repeat itself is not continued.
    Where several lead to one place, each a little off, it is one place.
    """
    n, radius = len(source), body_radius(source)
    rotations, shifts, near = _continuing_motions(source, normals)
    if not len(rotations):
        return Places(source[:0], None, np.zeros(0, np.bool_))
    from scipy.spatial import cKDTree  # slow to import

    apart = max(near, float(np.median(neighbour_tolerance(source))))
    points, unit = source, np.zeros(source.shape) if normals is None else np.asarray(normals, float)
    centre = source.mean(axis=0)
    reach = FAR * float(np.linalg.norm(source - centre, axis=1).max())
    for _ in range(ROUNDS):
        images = points @ rotations.swapaxes(1, 2) + shifts[:, None]
        off, to = cKDTree(points).query(images.reshape(-1, 3), distance_upper_bound=apart)
        off, to = off.reshape(images.shape[:2]), to.reshape(images.shape[:2])
        led = np.zeros((len(rotations), len(points) + 1), np.bool_)  # no point is the last place
        np.put_along_axis(led, np.where(off < near, to, len(points)), values=True, axis=1)
        which, own = np.nonzero(led[:, :-1] & ~(off < apart))
        away = np.linalg.norm(images[which, own] - centre, axis=1)
        order = np.argsort(away, kind="stable")
        order = order[away[order] < reach]
        which, own = which[order], own[order]
        kept = _drop_repeated(images[which, own], apart)[: MAX_PLACES - len(points)]
        if not len(kept):
            break
        facing = (rotations[which[kept]] @ unit[own[kept], :, None])[..., 0]
        points, unit = np.concatenate([points, images[which[kept], own[kept]]]), np.concatenate([unit, facing])
    return Places(points[n:], None if normals is None else unit[n:], _is_beyond_hull(source, points[n:], radius))


def _continuing_motions(source: Floats, normals: Floats | None) -> tuple[Floats, Floats, float]:
    """Motions (G, 3, 3) and (G, 3) that put most points onto others and lead on, and up to where a place is a point's.

    They are near symmetries, and one after another: two half turns about different places are a shift. What takes back
    what it does, as half a turn, leads nowhere.
    """
    found = find_symmetries(source, normals)
    if not found:
        return np.empty((0, 3, 3)), np.empty((0, 3)), 0.0
    from scipy.spatial import cKDTree  # slow to import

    near = same_point_tolerance(source)
    rotations, shifts = np.array([one.rotation for one in found]), np.array([one.shift for one in found])
    rotations = np.concatenate([rotations, rotations.swapaxes(1, 2)])
    shifts = np.concatenate([shifts, -(rotations[len(found) :] @ shifts[..., None])[..., 0]])
    after = rotations[:, None] @ rotations, (rotations[:, None] @ shifts[..., None])[..., 0] + shifts[:, None]
    rotations = np.concatenate([rotations, after[0].reshape(-1, 3, 3)])
    shifts = np.concatenate([shifts, after[1].reshape(-1, 3)])
    images = source @ rotations.swapaxes(1, 2) + shifts[:, None]
    twice = images @ rotations.swapaxes(1, 2) + shifts[:, None]
    turns = (np.linalg.norm(twice - source, axis=2) > near).any(axis=1)
    rotations, shifts, images = rotations[turns], shifts[turns], images[turns]
    off, _ = cKDTree(source).query(images.reshape(-1, 3), distance_upper_bound=near)
    mapped = (off < near).reshape(images.shape[:2]).sum(axis=1)
    kept = list[int]()
    for k in np.argsort(-mapped, kind="stable").tolist():
        if len(kept) == MOTIONS or mapped[k] < max(LAW, SHARE * len(source)):
            break
        if all(np.linalg.norm(images[k] - images[one], axis=1).max() > near for one in kept):
            kept.append(k)
    return rotations[kept], shifts[kept], near


def _drop_repeated(places: Floats, near: float) -> list[int]:
    """Those of some places (m, 3) that are in the place of none before."""
    kept = list[int]()
    for k, place in enumerate(places):
        if not kept or float(np.linalg.norm(places[kept] - place, axis=1).min()) > near:
            kept.append(k)
    return kept


def _is_beyond_hull(source: Floats, places: Floats, radius: float) -> Bools:
    """Which places (m, 3) are outside the hull of points (n, 3), in the space that these span."""
    from scipy.spatial import ConvexHull  # slow to import

    centre = source.mean(axis=0)
    _, spread, axes = np.linalg.svd(source - centre, full_matrices=False)
    across = axes[spread > TOLERANCE * spread[0]]
    along, every = (source - centre) @ across.T, (places - centre) @ across.T
    if along.shape[1] == 1:
        return np.asarray((every < along.min() - INSIDE * radius) | (every > along.max() + INSIDE * radius))[:, 0]
    faces = ConvexHull(along).equations
    return np.asarray((every @ faces[:, :-1].T + faces[:, -1] > INSIDE * radius).any(axis=1))


def allow_continuations(told: Posterior, model: DetectionModel, places: Places, taken: Bools | None) -> Posterior:
    """A posterior in which what goes on by a body's law may be beside it, or in its stead.

    The same where no detection is in one of the places. ``taken``: (n',) detections of other bodies.
    """
    if not len(places.points) or not told.shown >= LIKELY:
        return told
    beside = Beside(model, places, taken)
    modes = beside.each(told)
    odds = [_continuation_odds(beside, mode) for mode in modes]
    if not any(odds):
        return told
    # what is hidden of the body is told as exactly as what is hidden of something in its stead
    shown = _gain_by_hulls(model, *modes[0][:3])
    every = [
        None if one is None else (one[0] + own, one[1] + own - shown)
        for one, own in zip(odds, _own_weight(told, modes), strict=True)
    ]
    found = continuation_factors(every, told.probabilities[: len(every)], LOG_CONTINUED)
    return told if found is None else told.beside(*found)


def _own_weight(told: Posterior, modes: Sequence[Modes]) -> Floats:
    """Logarithm (K,) of the part of each mode's weight that is its own, and not that of copies beside it.

    What goes on beside a mode explains what these do. Relative to the mode that explains most itself.
    """
    mass = np.array([float(mode.log_mass[0]) for mode in modes])
    with np.errstate(divide="ignore"):
        own = mass - np.log(told.probabilities[: len(mass)])
    own -= own[mass.argmax()]
    return np.asarray(np.minimum(own, 0.0))


def continuation_factors(
    every: Sequence[tuple[float, float] | None], probabilities: Floats, log_prior: float
) -> tuple[Floats, float] | None:
    """Logarithm (K,) of the factor of each mode by what is beside it, and of the weight of something in its stead.

    None where no detection is in a place. ``every``: log-odds, over each mode, of this with what goes on beside it, and
    of something else in its stead. ``log_prior``: logarithm of the odds that either is in view.
    """
    of = [k for k, one in enumerate(every) if one is not None]
    if not of:
        return None
    beside, instead = np.array([one for one in every if one is not None]).T
    factors = np.zeros(len(every))
    factors[of] = np.logaddexp(0.0, log_prior + beside)
    with np.errstate(divide="ignore"):
        other = np.log(probabilities[of]) + log_prior + instead
    return factors, float(other.max())  # from whatever pose, it is the same thing


def _continuation_odds(beside: Beside, mode: Modes) -> tuple[float, float] | None:
    """Log-odds, over a mode, of this with what goes on beside it, and of something else in its stead.

    None where no detection that it leaves is in any of the places.
    """
    (assignment,), pose, places = mode.assignments, (mode.rotation, mode.position), beside.places
    left = beside.unused_detections(mode)
    near = beside.off_by(mode)[:, left] < GATE**2
    if not near.any():
        return None
    best, instead = _log_odds_instead(beside.whole, mode)
    if best is None:
        return None
    if near[~places.beyond].any():
        instead = float(np.logaddexp(instead, _log_odds_instead(beside.filled, mode)[1])) - math.log(2.0)
    # beyond the body is what its own matches leave there
    own = assignment.reshape(beside.images, -1)
    more = best.assignment.reshape(beside.images, -1)[:, own.shape[1] :]
    more = np.where(places.beyond & (more >= 0) & left[more], more, -1)
    if not (more >= 0).any():
        return -math.inf, instead
    both = weigh_poses(beside.whole, np.concatenate([own, more], axis=1).reshape(1, -1), *pose)[0]
    rest = more[:, places.beyond].reshape(1, -1)
    shown = weigh_poses(beside.outside, rest, *pose)[0].detected + mode.detected
    shown += _gain_by_hulls(beside.outside, rest, *pose)
    # −∞ where some of the places, which are told about another pose, cannot be seen from this one
    return float((both.place_log_odds + shown - mode.log_odds)[0]), instead


def _log_odds_instead(model: DetectionModel, mode: Modes) -> tuple[Settled | None, float]:
    """What explains most of all points and places of a model from about a mode's pose, and its log-odds over the mode.

    None, and −∞, where nothing is explained from there.
    """
    known = dict[bytes, Settled]()
    settle_assignment(model, (mode.rotation, mode.position), mode.covariance[0], known=known)
    if not known:
        return None, -math.inf
    best = max(known.values(), key=lambda one: one.log_odds)
    gain = _gain_by_hulls(model, best.assignment[None], best.rotation[None], best.position[None])
    return best, best.log_odds + gain - float(mode.log_mass[0])


def _gain_by_hulls(model: DetectionModel, assignment: Integers, rotation: Floats, position: Floats) -> float:
    """What the log-odds of an assignment (1, n) gain if a window shows the hull of its matches, and not more.

    The window of the model has eight edges of given directions, which leave more than a turned board in sight.
    """
    found, at = weigh_poses(model, assignment, rotation, position)
    if not np.isfinite(found.detected[0]):
        return 0.0
    matched, visible, images = assignment[0] >= 0, found.visible[0], max(len(model.images), 1)
    in_sight, odds = np.ones(len(matched), np.bool_), LOG_FREE
    for own in np.split(np.arange(len(matched)), images):
        if np.count_nonzero(matched[own]) < 3 or float(visible[own][~matched[own]].sum()) <= MIN_HIDDEN:
            continue
        shown = at.pixels[0, own][matched[own]]
        in_sight[own] = matched[own] | ~_is_beyond_hull(shown, at.pixels[0, own], body_radius(shown))
        points = np.count_nonzero(matched[own]) + float(visible[own][~matched[own]].sum())
        odds += LOG_ODDS - math.log(points**3 / 6.0)
    if in_sight.all():
        return 0.0
    told = odds + log_shown_chance(visible * in_sight, matched, *model.rate_quadrature)
    return max(told - float(found.detected[0]), 0.0)
