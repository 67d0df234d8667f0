"""Points of a body that no camera shows, while several cameras see others beside it: the same points elsewhere.

A point without a detection in any image is dark or covered, and what else there is about the body is clutter of each
image. Or it is elsewhere on the body: then several cameras see it in one place of space. Something else that shares a
few of the body's points has its other points elsewhere, as a body seldom has. Least of all a body whose points were in
place in the frames before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.compiled.evidence import LOG_2PI
from rootmatch.model.copy_or_alike import ANOTHER
from rootmatch.model.detection_model import USUAL_RATE, DetectionModel
from rootmatch.model.evidence import settle_poses
from rootmatch.model.image_alike import REACH, cache_answer, perturb_points
from rootmatch.model.linearised import Linearised
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import Doubted
from rootmatch.model.prediction import HIDDEN
from rootmatch.model.priors import INEXACT, WRONG_MODEL

MINIMUM, MAXIMUM = 2, 4
"""Points that are elsewhere, at least and at most: of a single one the body is a hundred times as probable as anything
else, but for one that was in place in the frames before, and four decide. Round values."""
TOGETHER = 2048
"""Tracks that grow together. A round value; it bounds memory."""


class Elsewhere(NamedTuple):
    """A point that several cameras see elsewhere on the body."""

    place: Floats
    """(3,) in the body's frame."""
    covariance: Floats
    sightings: int


def log_odds_of_another(model: DetectionModel, modes: Modes, k: int, taken: Bools | None = None) -> float:
    """Log-odds of something else whose other points are elsewhere, of the body in one of its modes.

    Of the body as it is, or with its own points there. −∞ if fewer than two points are seen elsewhere, each by two
    cameras or more, and none that was in place in the frames before. Parameters are those of
    `rootmatch.model.image_alike.alike_log_odds`.
    """
    if (told := _weigh_elsewhere(model, modes, k, taken)) is None:
        return -math.inf
    own_log_odds, other = np.asarray(told[:2]) - modes.log_mass[k]
    return float(other - np.logaddexp(0.0, own_log_odds))


def seen_elsewhere(model: DetectionModel, modes: Modes, k: int) -> tuple[Elsewhere, ...]:
    """The points of which `log_odds_of_another` tells."""
    told = _weigh_elsewhere(model, modes, k, None)
    return () if told is None else told[2]


def _weigh_elsewhere(
    model: DetectionModel, modes: Modes, k: int, taken: Bools | None
) -> tuple[float, float, tuple[Elsewhere, ...]] | None:
    """What `_weigh_another` tells of a mode; None if it can tell nothing."""
    if len(model.images) < 2:
        return None
    rows = np.arange(model.shape[0]).reshape(len(model.images), -1)
    shown = modes.visible[k][rows] > HIDDEN
    own = np.array(modes.assignments[k])
    (dark,) = ((own[rows] < 0).all(axis=0) & (shown.sum(axis=0) > 1)).nonzero()
    free = np.ones(model.shape[1], np.bool_) if taken is None else ~taken
    free[own[own >= 0]] = False
    minimum = _minimum(model, dark)
    if (
        len(dark) < minimum
        or free.sum() < 2 * minimum
        or model.resolution
        or not np.isfinite(modes.covariance[k]).all()
    ):
        return None
    mode = modes.take(slice(k, k + 1))
    return cache_answer(_weigh_another, model, (*mode[:4], mode.visible), dark, free)


def _weigh_another(
    model: DetectionModel, mode: tuple[Any, ...], dark: Integers, free: Bools
) -> tuple[float, float, tuple[Elsewhere, ...]]:
    """Log-odds, against clutter alone, of the body with points elsewhere and of something else, and these points."""
    images = max(len(model.images), 1)
    n = model.shape[0] // images
    assignments, rotation, position, (covariance,), (lit,) = mode
    at, own, off = model.linearise_about(rotation, position), assignments.copy(), np.zeros(n, np.bool_)
    placed, moved = _placed(model), 0.0
    place = _Place(model, at, covariance, np.arange(images)[:, None] * n + dark, lit)
    near, left, body, other = place.gate(free), list(range(len(dark))), list[float](), list[float]()
    tracks, stale, seen = dict[int, _Track](), left, list[Elsewhere]()
    for count in range(1, min(len(dark), MAXIMUM) + 1):
        tracks |= zip(stale, place.grow_tracks(near, stale), strict=True)
        best = max(left, key=lambda k: tracks[k].worth)
        track, point = tracks[best], int(dark[best])
        (seeing,) = (track.detections >= 0).nonzero()
        if len(seeing) < 2:
            break
        left.remove(best)
        taken = track.detections[seeing]
        stale = [k for k in left if np.isin(tracks[k].detections, taken).any()]
        near[..., taken] = False
        own[0, place.rows[seeing, best]], off[point] = taken, True
        turned = rotation[0]
        where = model.points[point] + turned.T @ track.step[6:]
        seen.append(Elsewhere(where, turned.T @ track.spread[6:, 6:] @ turned, len(seeing)))
        wide = perturb_points(model, model.radius, np.tile(off, images))
        found, _ = settle_poses(wide, own, rotation, position)
        log_odds = float(found.log_odds[0]) - math.log(math.comb(n, count))
        moved += math.log(WRONG_MODEL if placed is not None and placed[point] else INEXACT)
        body.append(log_odds + moved)
        other.append(log_odds + math.log(WRONG_MODEL) + count * math.log(ANOTHER))
    if len(other) < _minimum(model, off.nonzero()[0]):
        return -math.inf, -math.inf, ()
    return float(np.logaddexp.reduce(body)), float(np.logaddexp.reduce(other)), tuple(seen)


def _placed(model: DetectionModel) -> Bools | None:
    """Which points have been in place in the frames before; None if that is not known."""
    return model.prior.placed if isinstance(model.prior, Doubted) else None


def _minimum(model: DetectionModel, dark: Integers) -> int:
    """How many of the dark points have to be elsewhere to tell: one that was in place tells alone."""
    placed = _placed(model)
    return MINIMUM if placed is None or not placed[dark].any() else 1


class _Track(NamedTuple):
    """What a point may have in each of C images; what N points may have, (N, …)."""

    worth: Any
    """Log-odds against clutter."""
    detections: Integers
    """(C,), −1 for none."""
    step: Floats
    """(9,) of pose and point, to where they are then, with their covariance (9, 9)."""
    spread: Floats


class _Place:
    """Where a pose with its covariance (6, 6) has points that may be anywhere on the body.

    ``rows`` (C, D): those of each of D points in each of C images; ``lit`` (n,): that each row is visible.
    """

    def __init__(self, model: DetectionModel, at: Linearised, covariance: Floats, rows: Integers, lit: Floats) -> None:
        self.model, self.rows, self.lit = model, rows, lit[rows]
        self.spread = np.zeros((9, 9))
        self.spread[:6, :6], self.spread[6:, 6:] = covariance, model.radius**2 * np.eye(3)
        self.jacobian = np.concatenate([at.jacobian[0], at.jacobian[0, :, :, 3:]], axis=2)[rows]
        """By the pose and the point (C, D, 2, 9)."""
        self.off = model.target - at.pixels[0, rows, None]
        """Of all detections (C, D, n', 2) from where a point is predicted in its image."""

    def gate(self, free: Bools) -> Bools:
        """Which detections (C, D, n') may be of each point, of those that are free (n',)."""
        visible = (self.lit > HIDDEN)[..., None]
        of_image = visible & free & (self.model.image_indices == np.arange(len(self.rows))[:, None, None])
        sigma = np.where(of_image, self.model.sigma, 0.0).max(axis=2, initial=0.0) + 1e-300
        across = self.jacobian @ self.spread @ self.jacobian.swapaxes(2, 3)
        (a, b), (_, d) = np.moveaxis(across + (sigma**2)[..., None, None] * np.eye(2), (2, 3), (0, 1))[..., None]
        x, y = np.moveaxis(self.off, 3, 0)
        return np.asarray(of_image & (d * x * x - 2.0 * b * x * y + a * y * y < REACH**2 * (a * d - b * b)))

    def grow_tracks(self, near: Bools, points: Sequence[int]) -> list[_Track]:
        """The likeliest detections of each of some points; ``near`` (C, D, n'): what `gate` tells."""
        best = [_Track(-math.inf, np.full(len(near), -1), np.zeros(9), self.spread)] * len(points)
        which, near = np.array(points, np.int64), near[:, points]
        elsewhere = near.any(axis=2).sum(axis=0) > 1
        image, number, detection = (near & elsewhere[:, None]).nonzero()
        for begin in range(0, len(number), TOGETHER):
            some = slice(begin, begin + TOGETHER)
            told = self._grow_together(image[some], detection[some], which[number[some]], near[:, number[some]])
            worth = np.where((told.detections >= 0).sum(axis=1) > 1, told.worth, -np.inf)
            for k in np.unique(number[some]).tolist():
                one = int(np.where(number[some] == k, worth, -np.inf).argmax())
                if worth[one] > best[k].worth:
                    best[k] = _Track._make(part[one] for part in told)
        return best

    def _grow_together(self, first: Integers, detections: Integers, points: Integers, near: Bools) -> _Track:
        """What points (N,) have in each image in turn, as far as those before tell where they are.

        They begin in images ``first`` (N,) with detections (N,); ``near`` (C, N, n'): what they may have.
        """
        count, every = len(points), np.arange(len(points))
        spread = np.repeat(self.spread[None], count, axis=0)
        told = _Track(np.zeros(count), np.full((count, len(near)), -1), np.zeros((count, 9)), spread)
        self._grow_by(
            told, (first, points, every), detections[:, None], np.ones((count, 1), np.bool_), minimum=-math.inf
        )
        for image in range(len(near)):
            own = np.flatnonzero(near[image].any(axis=1) & (first != image))
            if len(own):
                which = np.flatnonzero(self.model.image_indices == image)[None]
                where = np.full(len(own), image), points[own], own
                self._grow_by(told, where, which, near[image][np.ix_(own, which[0])])
        return told

    def _grow_by(
        self,
        told: _Track,
        where: tuple[Integers, Integers, Integers],
        which: Integers,
        may: Bools,
        *,
        minimum: float = 0.0,
    ) -> None:
        """Let some tracks grow by the likeliest of the detections that they may have, where that is worth more.

        Parameters
        ----------
        where : image, point and track
            (M,) each.
        which, may : (M, m) or (1, m), and (M, m) arrays
            Detections, and whether they may be of the point.
        minimum : float
            What they are worth, at least.
        """
        (image, of, own), model = where, self.model
        sigma = np.where(may, model.sigma[which], 0.0).max(axis=1) + 1e-300
        jacobian, step, spread = self.jacobian[image, of], told.step[own], told.spread[own]
        carried = jacobian @ spread
        (a, b), (_, d) = np.moveaxis(carried @ jacobian.swapaxes(1, 2), 0, 2)
        a, d = a + sigma**2, d + sigma**2  # of the deviations, whose covariance is 2 x 2
        determinant = a * d - b * b
        off = self.off[image[:, None], of[:, None], which] - (jacobian @ step[..., None])[:, None, :, 0]
        x, y = np.moveaxis(off, 2, 0)
        squared = (d[:, None] * x * x - 2.0 * b[:, None] * x * y + a[:, None] * y * y) / determinant[:, None]
        chance = USUAL_RATE * self.lit[image, of]
        more = np.log(chance / (1.0 - chance)) - 0.5 * np.log(determinant) - LOG_2PI
        worth = np.where(may, more[:, None] - 0.5 * squared - model.clutter.log_density[which], -np.inf)
        one = worth.argmax(axis=1)
        (at,) = (worth[np.arange(len(own)), one] > minimum).nonzero()
        one, own = one[at], own[at]
        inverse = np.stack([d, -b, -b, a], axis=-1).reshape(-1, 2, 2)[at] / determinant[at, None, None]
        gain = carried[at].swapaxes(1, 2) @ inverse
        told.worth[own] += worth[at, one]
        told.detections[own, image[at]] = np.broadcast_to(which, may.shape)[at, one]
        told.step[own] += (gain @ off[at, one, :, None])[..., 0]
        told.spread[own] -= gain @ carried[at]
