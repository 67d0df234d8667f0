"""What goes on by the law of a body that repeats itself, beside it or in its stead: another board on the same squares.

A near symmetry that puts points of a body onto others tells where more of them would be: at the images of points that
have no other in their place. What continues the body has detections there, where the body has no points, and explains
as much as the body does, from wherever its rows are counted. So the image may show

- the body, and detections that are clutter, as the posterior has it;
- the body, and what goes on beside it: beyond its points only, as among them it says itself which places are empty;
- something else alone: a body with a point in every place, of which the image shows any share, or a window.

All three have the evidence of `rootmatch.model.evidence`, with places in the stead of points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, kept_by_values
from rootmatch.explain.near_symmetries import DISTINCT, LEAST, SHARE, TOLERANCE, symmetries_of
from rootmatch.frozen import copied, once
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import about
from rootmatch.model.modes import Modes
from rootmatch.model.posterior import Posterior
from rootmatch.model.prediction import GATE, HIDDEN, Settled, settle
from rootmatch.model.priors import PRESENT_ODDS
from rootmatch.problems.pose_fit.reference_point import body_radius

LOG_CONTINUED = -PRESENT_ODDS
"""Logarithm of the odds that what goes on by the body's law is in view, beside it or without it: what repeats itself is
one of many, so something else of that kind is there as probably as nothing is."""
MOST_PLACES = 400
"""Most places of what continues a body, the body's own points among them. A round value; it bounds time."""
FAR = 2.0
"""Distance of these from the body's centre, over that of its farthest point. A round value; it bounds time."""
ROUNDS = 16
"""Most steps by which a body is continued. A round value; it bounds time."""
MOTIONS = 12
"""Most motions that continue a body. A round value; it bounds time."""
INSIDE = 1e-6
"""Distance beyond the hull of a body, over its radius, up to which a place is within it."""
MODES = 16
"""Modes that are weighed. A round value; it bounds time."""
LIKELY = 0.5
"""Probability that the body is in view from which it is asked whether something else is. A round value."""


class Places(NamedTuple):
    """Where a body that continues by its own law would have more points."""

    points: Floats
    """(m, 3)"""
    normals: Floats | None
    """(m, 3), if the body has any."""
    beyond: Bools
    """(m,) which are beyond the hull of the body's points; the others are its holes."""


@kept_by_values(64)
def places_beside(source: Floats, normals: Floats | None) -> Places:
    """Places that near symmetries of a body (n, 3) lead to from its points, and from there again; none mostly.

    A symmetry leads on from a point that it puts another one onto; so what does not repeat itself is not continued.
    """
    n, radius = len(source), body_radius(source)
    rotations, shifts, near = _leading_on(source, normals)
    if not len(rotations):
        return Places(source[:0], None, np.zeros(0, np.bool_))
    from scipy.spatial import cKDTree  # slow to import

    points, unit = source, np.zeros(source.shape) if normals is None else np.asarray(normals, float)
    centre = source.mean(axis=0)
    reach = FAR * float(np.linalg.norm(source - centre, axis=1).max())
    for _ in range(ROUNDS):
        images = points @ rotations.swapaxes(1, 2) + shifts[:, None]
        off, to = cKDTree(points).query(images.reshape(-1, 3), distance_upper_bound=near)
        off, to = off.reshape(images.shape[:2]), to.reshape(images.shape[:2])
        led = np.zeros((len(rotations), len(points) + 1), np.bool_)  # no point is the last place
        np.put_along_axis(led, to, values=True, axis=1)
        which, own = np.nonzero(led[:, :-1] & ~(off < near))
        away = np.linalg.norm(images[which, own] - centre, axis=1)
        order = np.argsort(away, kind="stable")
        order = order[away[order] < reach]
        which, own = which[order], own[order]
        kept = _distinct(images[which, own], near)[: MOST_PLACES - len(points)]
        if not len(kept):
            break
        facing = (rotations[which[kept]] @ unit[own[kept], :, None])[..., 0]
        points, unit = np.concatenate([points, images[which[kept], own[kept]]]), np.concatenate([unit, facing])
    return Places(points[n:], None if normals is None else unit[n:], _beyond(source, points[n:], radius))


def _leading_on(source: Floats, normals: Floats | None) -> tuple[Floats, Floats, float]:
    """Motions (G, 3, 3) and (G, 3) that put most points onto others and lead on, and up to where a place is a point's.

    They are near symmetries, and one after another: two half turns about different places are a shift. What takes back
    what it does, as half a turn, leads nowhere.
    """
    found = symmetries_of(source, normals)
    if not found:
        return np.empty((0, 3, 3)), np.empty((0, 3)), 0.0
    between = np.linalg.norm(source[:, None] - source, axis=2)
    near = min(TOLERANCE * body_radius(source), DISTINCT * float(np.median(np.sort(between, axis=1)[:, 1])))
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
    squared = ((images[:, :, None] - source) ** 2).sum(axis=3)
    mapped = (squared < near**2).any(axis=2).sum(axis=1)
    kept = list[int]()
    for k in np.argsort(-mapped, kind="stable").tolist():
        if len(kept) == MOTIONS or mapped[k] < max(LEAST, SHARE * len(source)):
            break
        if all(np.linalg.norm(images[k] - images[one], axis=1).max() > near for one in kept):
            kept.append(k)
    return rotations[kept], shifts[kept], near


def _distinct(places: Floats, near: float) -> list[int]:
    """Those of some places (m, 3) that are in the place of none before."""
    kept = list[int]()
    for k, place in enumerate(places):
        if not kept or float(np.linalg.norm(places[kept] - place, axis=1).min()) > near:
            kept.append(k)
    return kept


def _beyond(source: Floats, places: Floats, radius: float) -> Bools:
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


def beside_continuations(told: Posterior, model: DetectionModel, places: Places, taken: Bools | None) -> Posterior:
    """A posterior in which what goes on by a body's law may be beside it, or in its stead.

    Parameters
    ----------
    told : Posterior
    model : DetectionModel
    places : Places
        Of the body. Where none of them has a detection, the posterior stays as it is.
    taken : (n',) bool array, optional
        Detections of other bodies.
    """
    if not len(places.points) or not float(told.probabilities.sum()) >= LIKELY:
        return told
    beside = Beside(model, places, taken)
    modes = beside.each(told)
    odds = [_continued(beside, mode) for mode in modes]
    every = [
        None if one is None else (one[0] + own, one[1] + own) for one, own in zip(odds, _own(told, modes), strict=True)
    ]
    found = factors_of(every, told.probabilities[: len(every)], LOG_CONTINUED)
    return told if found is None else told.beside(*found)


def _own(told: Posterior, modes: Sequence[Modes]) -> Floats:
    """Logarithm (K,) of the part of each mode's weight that is its own, and not that of copies beside it.

    What goes on beside a mode explains what these do. Relative to the mode that explains most itself.
    """
    mass = np.array([float(mode.log_mass[0]) for mode in modes])
    with np.errstate(divide="ignore"):
        own = mass - np.log(told.probabilities[: len(mass)])
    own -= own[mass.argmax()]
    return np.asarray(np.minimum(own, 0.0))


def factors_of(
    every: Sequence[tuple[float, float] | None], probabilities: Floats, log_prior: float
) -> tuple[Floats, float] | None:
    """Logarithm (K,) of the factor of each mode by what is beside it, and of the weight of something in its stead.

    None where no detection is in a place.

    Parameters
    ----------
    every : sequence of (float, float), optional
        Log-odds, over each mode, of this with what goes on beside it, and of something else in its stead.
    probabilities : (K,) array
        Of the modes.
    log_prior : float
        Logarithm of the odds that either is in view.
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


def _continued(beside: Beside, mode: Modes) -> tuple[float, float] | None:
    """Log-odds, over a mode, of this with what goes on beside it, and of something else in its stead.

    None where no detection that it leaves is in any of the places.
    """
    (assignment,), pose, places = mode.assignments, (mode.rotation, mode.position), beside.places
    left = beside.left_by(mode)
    if not left.any() or not (beside.off_by(mode)[:, left] < GATE**2).any():
        return None
    known = dict[bytes, Settled]()
    settle(beside.whole, pose, mode.covariance[0], known=known)
    if not known:
        return None
    best = max(known.values(), key=lambda one: one.log_odds)
    instead = best.log_odds - float(mode.log_mass[0])
    # beyond the body is what its own matches leave there
    own = assignment.reshape(beside.images, -1)
    more = best.assignment.reshape(beside.images, -1)[:, own.shape[1] :]
    more = np.where(places.beyond & (more >= 0) & left[more], more, -1)
    if not (more >= 0).any():
        return -math.inf, instead
    both = about(beside.whole, np.concatenate([own, more], axis=1).reshape(1, -1), *pose)[0]
    shown = about(beside.outside, more[:, places.beyond].reshape(1, -1), *pose)[0].detected + mode.detected
    return float((both.log_odds - both.detected + shown - mode.log_odds)[0]), instead


class Beside:
    """A body's model with points in more places: the same for all of its modes.

    Attributes
    ----------
    others, outside, whole : DetectionModel
        Of points in the places alone; in those beyond the body; and in all of them beside its own points.
    """

    def __init__(self, model: DetectionModel, places: Places, taken: Bools | None) -> None:
        self.model, self.places, self.images = model, places, max(len(model.images), 1)
        self.free = np.ones(model.shape[1], np.bool_) if taken is None else ~taken
        self.shape = Shape.of(model, self.images)

    @once
    def others(self) -> DetectionModel:
        """See the class."""
        return self.shape.only(self.places).model(self.model, self.free)

    @once
    def outside(self) -> DetectionModel:
        """See the class."""
        return self.shape.only(self.places).take(self.places.beyond).model(self.model, self.free)

    @once
    def whole(self) -> DetectionModel:
        """See the class."""
        return self.shape.and_(self.places).model(self.model, self.free)

    def each(self, told: Posterior) -> list[Modes]:
        """The modes of a posterior that are weighed, one by one."""
        modes = told.modes.first(MODES)
        return [modes.take(slice(k, k + 1)) for k in range(len(modes.log_odds))]

    def left_by(self, mode: Modes) -> Bools:
        """Which detections (n',) a mode leaves."""
        (assignment,), left = mode.assignments, self.free.copy()
        left[assignment[assignment >= 0]] = False
        return left

    def off_by(self, mode: Modes) -> Floats:
        """Squared distances (m, n') of detections from the places, in units of both their variances.

        Infinite for a place that is not in view.
        """
        found, at = about(self.others, np.full((1, self.others.shape[0]), -1), mode.rotation, mode.position)
        by_pose = 0.5 * ((at.jacobian[0] @ mode.covariance[0]) * at.jacobian[0]).sum(axis=(1, 2))
        squared = ((at.pixels[0][:, None] - self.others.target) ** 2).sum(axis=2)
        shown = found.visible[0] > HIDDEN
        return np.where(shown[:, None], squared / (by_pose[:, None] + self.others.sigma**2), np.inf)


class Shape(NamedTuple):
    """Points of one image of a body, and what is known of them."""

    points: Floats
    normals: Floats | None
    cosine: Floats | None
    covariance: Floats | None
    images: int

    @classmethod
    def of(cls, model: DetectionModel, images: int) -> Shape:
        """The body of a model."""
        which = slice(len(model.points) // images)
        return cls(
            model.points[which], _taken(model.normals, which), _taken(model.view_cosine, which),
            _taken(model.source_covariance, which), images,
        )  # fmt: skip

    def only(self, places: Places) -> Shape:
        """Places in the stead of its points, as uncertain as these."""
        m = len(places.points)
        cosine = None if self.cosine is None else np.full(m, self.cosine.mean())
        covariance = None if self.covariance is None else np.tile(self.covariance.mean(axis=0), (m, 1, 1))
        return Shape(places.points, places.normals, cosine, covariance, self.images)

    def and_(self, places: Places) -> Shape:
        """Its points, followed by places."""
        more = self.only(places)
        return Shape(
            np.concatenate([self.points, more.points]), _joined(self.normals, more.normals),
            _joined(self.cosine, more.cosine), _joined(self.covariance, more.covariance), self.images,
        )  # fmt: skip

    def take(self, which: Bools) -> Shape:
        """Some of its points."""
        return Shape(
            self.points[which], _taken(self.normals, which), _taken(self.cosine, which),
            _taken(self.covariance, which), self.images,
        )  # fmt: skip

    def model(self, model: DetectionModel, free: Bools) -> DetectionModel:
        """A model with these points, in the same poses of the same centre, of some detections (n',) only."""

        def of_all(one: Floats | None) -> Floats | None:
            return None if one is None else np.tile(one, (self.images, *(1,) * (one.ndim - 1)))

        allowed = None
        if self.images > 1 or not free.all():
            allowed = (np.repeat(np.arange(self.images), len(self.points))[:, None] == model.image_of) & free
        wide = copied(
            model, points=of_all(self.points), normals=of_all(self.normals), view_cosine=of_all(self.cosine),
            source_covariance=of_all(self.covariance), allowed=allowed, log_weights=None,
        )  # fmt: skip
        wide.__dict__["centre"] = model.centre  # to which the poses and their prior refer
        return wide


def _taken(one: Floats | None, which: Bools | slice) -> Floats | None:
    """Some rows of what may not be known."""
    return None if one is None else one[which]


def _joined(one: Floats | None, other: Floats | None) -> Floats | None:
    """Rows of what may not be known, one after the other."""
    return None if one is None or other is None else np.concatenate([one, other])
