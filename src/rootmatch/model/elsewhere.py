"""Points of a body that no camera shows, while several cameras see others beside it: the same points elsewhere.

A point without a detection in any image is dark or covered, and what else there is about the body is clutter of each
image. Or it is elsewhere on the body: then several cameras see it in one place of space. Something else that shares a
few of the body's points has its other points elsewhere, as a body seldom has. Least of all a body whose points were in
place in the frames before.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.copy_or_alike import ANOTHER
from rootmatch.model.detection_model import USUAL_RATE, DetectionModel
from rootmatch.model.evidence import settle_poses
from rootmatch.model.image_alike import REACH, cache_answer, perturb_points
from rootmatch.model.linearised import Linearised
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import Doubted
from rootmatch.model.prediction import HIDDEN
from rootmatch.model.priors import INEXACT, WRONG_MODEL

LEAST, MOST = 2, 4
"""Points that are elsewhere, at least and at most: of a single one the body is a hundred times as probable as anything
else, but for one that was in place in the frames before, and four decide. Round values."""
LOG_2PI = math.log(2.0 * math.pi)


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
    least = _least(model, dark)
    if len(dark) < least or free.sum() < 2 * least or model.resolution or not np.isfinite(modes.covariance[k]).all():
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
    rows = (np.arange(images)[:, None] * n + dark).ravel()
    place = _Place(model, at, covariance, rows[lit[rows] > HIDDEN])
    free, left, body, other = free.copy(), set(dark.tolist()), list[float](), list[float]()
    seen = list[Elsewhere]()
    for count in range(1, min(len(dark), MOST) + 1):
        near = place.gate(free)
        each = [(place.seen(np.arange(images) * n + one, near, lit), one) for one in sorted(left)]
        track, point = max(each, key=lambda one: one[0].worth)
        if len(track.rows) < 2:
            break
        left.discard(point)
        own[0, track.rows], free[track.detections], off[point] = track.detections, False, True
        turned = rotation[0]
        where = model.points[point] + turned.T @ track.step[6:]
        seen.append(Elsewhere(where, turned.T @ track.spread[6:, 6:] @ turned, len(track.rows)))
        wide = perturb_points(model, model.radius, np.tile(off, images))
        found, _ = settle_poses(wide, own, rotation, position)
        log_odds = float(found.log_odds[0]) - math.log(math.comb(n, count))
        moved += math.log(WRONG_MODEL if placed is not None and placed[point] else INEXACT)
        body.append(log_odds + moved)
        other.append(log_odds + math.log(WRONG_MODEL) + count * math.log(ANOTHER))
    if len(other) < _least(model, off.nonzero()[0]):
        return -math.inf, -math.inf, ()
    return float(np.logaddexp.reduce(body)), float(np.logaddexp.reduce(other)), tuple(seen)


def _placed(model: DetectionModel) -> Bools | None:
    """Which points have been in place in the frames before; None if that is not known."""
    return model.prior.placed if isinstance(model.prior, Doubted) else None


def _least(model: DetectionModel, dark: Integers) -> int:
    """How many of the dark points have to be elsewhere to tell: one that was in place tells alone."""
    placed = _placed(model)
    return LEAST if placed is None or not placed[dark].any() else 1


class _Track(NamedTuple):
    """What a point may have in each image."""

    worth: float
    """Log-odds against clutter."""
    rows: Integers
    detections: Integers
    step: Floats
    """(9,) of pose and point, to where they are then, with their covariance."""
    spread: Floats


class _Place:
    """Where a pose with its covariance (6, 6) has points that may be anywhere on the body."""

    def __init__(self, model: DetectionModel, at: Linearised, covariance: Floats, rows: Integers) -> None:
        self.model, self.rows = model, rows.tolist()
        self.spread = np.zeros((9, 9))
        self.spread[:6, :6], self.spread[6:, 6:] = covariance, model.radius**2 * np.eye(3)
        jacobian = np.concatenate([at.jacobian[0], at.jacobian[0, :, :, 3:]], axis=2)[rows]
        self.jacobian = dict(zip(self.rows, jacobian, strict=True))
        """By the pose and the point (2, 9), of each of the rows: of all visible points that may be anywhere."""
        self._every_off = model.target - at.pixels[0, rows, None]
        self.off = dict(zip(self.rows, self._every_off, strict=True))
        """Of all detections (n', 2) from each."""
        self._image = rows // (model.shape[0] // len(model.images))
        self._across = jacobian @ self.spread @ jacobian.swapaxes(1, 2)

    def gate(self, free: Bools) -> dict[int, Integers]:
        """Detections that may be of the point of each row, of those that are free (n',)."""
        of_image = free & (self.model.image_indices == self._image[:, None])
        sigma = np.where(of_image, self.model.sigma, 0.0).max(axis=1, initial=0.0) + 1e-300
        (a, b), (_, d) = np.moveaxis(self._across + (sigma**2)[:, None, None] * np.eye(2), 0, 2)[..., None]
        x, y = np.moveaxis(self._every_off, 2, 0)
        near = of_image & (d * x * x - 2.0 * b * x * y + a * y * y < REACH**2 * (a * d - b * b))
        return {row: own.nonzero()[0] for row, own in zip(self.rows, near, strict=True)}

    def seen(self, rows: Integers, near: dict[int, Integers], lit: Floats) -> _Track:
        """The likeliest detections of a point that has these rows; ``near``: what `gate` tells."""
        possible = {row: near[row] for row in rows.tolist() if row in near}
        best = _Track(-math.inf, np.empty(0, np.int64), np.empty(0, np.int64), np.zeros(9), self.spread)
        for row, every in possible.items():
            others = [(one, own) for one, own in possible.items() if one != row and len(own)]
            for first in every.tolist() if others else []:
                one = self._grow_track([(row, np.array([first])), *others], lit)
                if len(one.rows) > 1 and one.worth > best.worth:
                    best = one
        return best

    def _grow_track(self, possible: list[tuple[int, Integers]], lit: Floats) -> _Track:
        """What a point has in each image in turn, as far as those before tell where it is."""
        step, spread, total, pairs = np.zeros(9), self.spread, 0.0, list[tuple[int, int]]()
        for row, own in possible:
            jacobian, sigma = self.jacobian[row], float(self.model.sigma[own].max()) + 1e-300
            carried = jacobian @ spread
            (a, b), (_, d) = (carried @ jacobian.T).tolist()
            a, d = a + sigma**2, d + sigma**2  # of the deviations, whose covariance is 2 x 2
            determinant = a * d - b * b
            inverse = np.array([[d, -b], [-b, a]]) / determinant
            off, chance = self.off[row][own] - jacobian @ step, USUAL_RATE * float(lit[row])
            worth = -self.model.clutter.log_density[own] - 0.5 * ((off @ inverse) * off).sum(axis=1)
            worth += math.log(chance / (1.0 - chance)) - 0.5 * math.log(determinant) - LOG_2PI
            one = int(worth.argmax())
            if worth[one] > 0.0 or not pairs:
                gain = carried.T @ inverse
                step, spread = step + gain @ off[one], spread - gain @ carried
                total += float(worth[one])
                pairs.append((row, int(own[one])))
        rows, detections = np.array(pairs, np.int64).reshape(-1, 2).T
        return _Track(total, rows, detections, step, spread)
