"""A body where it is expected that shows too little there to be recognised: it is turned away, or out of view.

What is found elsewhere contradicts what was known of the pose. Either that was wrong, or it is right, the body shows
nothing where it is, and a copy is in view. The second is as probable as that so little is shown in the expected poses,

    W = mean over expected poses and rates of Π over images of Σ_(k ≤ m) P(k detected) n'! / (n' − k)! Γ(n' − k + ½) / …

with the detections n' that the copy leaves, and the rate of which the copy tells, as it is like the body.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from rootmatch.algebra.rotation import rotation_from_vector, rotation_onto_y, spread_rotations
from rootmatch.arrays import Floats, Integers
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.known_density import MIN_SPREAD, Known
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import Doubted, Gaussian, Mixed
from rootmatch.model.shown_in_part import SIGHT, count_distributions, count_ways_to_own, positions_ahead, rate_weights

POSES = 32
"""Poses of a prediction over which a mean is taken. A round value."""


def odds_of_unrecognised(model: DetectionModel, prior: Doubted, copies: Modes) -> Floats:
    """Odds (M,) that the body is in its expected poses and shows too little, relative to clutter alone.

    ``copies``: what is seen of a copy.
    """
    views, matched = ExpectedViews.of(model, prior), np.count_nonzero(copies.assignments >= 0, axis=1)
    told = rate_weights(model, matched, copies.visible.sum(axis=1))
    out = np.empty(len(matched))
    for k, used in enumerate(copies.uses(model.shape[1])):
        left = np.bincount(model.image_indices[~used], minlength=views.few.shape[1])
        out[k] = views.odds(left) @ told[k]
    return out


@dataclass(frozen=True, eq=False)
class ExpectedViews:
    """What the images show of a body in its expected poses: worked out once, and a frame asks several times."""

    few: Floats
    """(m + 1, C, S Q H) probability that 0, 1 … points of each image are detected, see `count_distributions`."""
    weights: Floats
    """(S,) of the poses."""
    tables: dict[bytes, Floats] = field(default_factory=dict)

    @classmethod
    def of(cls, model: DetectionModel, prior: Doubted) -> ExpectedViews:
        """Those of what is known of the body."""
        if "views" in prior.told:
            return prior.told["views"]  # type: ignore[no-any-return]
        poses, shares = [sample_expected_poses(model, one) for one in prior.predictions], np.exp(prior.log_shares)
        rotation, position = (np.concatenate(part) for part in zip(*poses, strict=True))
        at = model.linearise_about(rotation, position)
        visible = prior.lit * model.visibility(at, np.zeros(len(rotation)))
        weights = np.repeat(shares, POSES)
        in_view = weights * at.seen.any(axis=1)  # as a vague prediction hardly says: the body is asked for
        weights = in_view if in_view.any() else weights
        few = count_distributions(visible, model.rate_quadrature[0], max(len(model.images), 1), prior.minimum - 1)
        views = prior.told["views"] = cls(few, weights / weights.sum())
        return views

    def odds(self, left: Integers) -> Floats:
        """Odds (Q,) at each rate that no more are detected, with detections (C,) that each image has left."""
        if (key := left.tobytes()) not in self.tables:
            each = (count_ways_to_own(left, len(self.few) - 1) * self.few).sum(axis=0).prod(axis=0)
            self.tables[key] = self.weights @ (each.reshape(len(self.weights), -1, len(SIGHT)) @ SIGHT)
        return self.tables[key]


def sample_expected_poses(model: DetectionModel, known: Mixed) -> tuple[Floats, Floats]:
    """Some poses (`POSES`, 3, 3) and (`POSES`, 3) of the body's centre by what is known; ahead where no place is."""
    normal = _normal_deviates()
    if isinstance(known, Gaussian):
        step = normal @ np.linalg.cholesky(known.bounded_covariance).T
        return rotation_from_vector(step[:, :3]) @ known.rotation, known.position + step[:, 3:]
    rotation, place = spread_rotations(POSES), None
    if isinstance(known, Known):
        turn, down, place = known.prior.turn, known.prior.down, known.prior.place
        if turn is not None:
            rotation = rotation_from_vector(normal[:, :3] @ _matrix_root(turn[1])) @ turn[0]
        elif down is not None:
            source, camera, tilt = down
            onto, back = rotation_onto_y(np.asarray(source)), rotation_onto_y(np.asarray(camera)).T
            about = 2.0 * np.pi * (np.arange(POSES)[:, None] + 0.5) / POSES * np.array([0.0, 1.0, 0.0])
            tilted = rotation_from_vector(max(tilt, MIN_SPREAD) * normal[:, :3] * np.array([1.0, 0.0, 1.0]))
            rotation = back @ tilted @ rotation_from_vector(about) @ onto
    if place is None:
        return rotation, positions_ahead(model, POSES)
    return rotation, place[0] + normal[:, 3:] @ _matrix_root(place[1]) + rotation @ model.centre


@lru_cache(maxsize=1)
def _normal_deviates() -> Floats:
    """Normal deviates (`POSES`, 6), always the same, as nothing here is to be noisy."""
    return np.random.default_rng(0).normal(size=(POSES, 6))


def _matrix_root(covariance: Floats) -> Floats:
    """A root (3, 3) of a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)
