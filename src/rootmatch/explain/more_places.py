"""A body's model with points in more places: beside its own, or in their stead."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.frozen import copy_with, once
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_poses
from rootmatch.model.modes import Modes
from rootmatch.model.posterior import Posterior
from rootmatch.model.prediction import HIDDEN

MODES = 16
"""Modes that are weighed. A round value; it bounds time."""


class Places(NamedTuple):
    """Where a body that continues by its own law would have more points."""

    points: Floats
    """(m, 3)"""
    normals: Floats | None
    """(m, 3), if the body has any."""
    beyond: Bools
    """(m,) which are beyond the hull of the body's points; the others are its holes."""


class Beside:
    """A body's model with points in more places: the same for all of its modes."""

    def __init__(self, model: DetectionModel, places: Places, taken: Bools | None) -> None:
        self.model, self.places, self.images = model, places, max(len(model.images), 1)
        self.free = np.ones(model.shape[1], np.bool_) if taken is None else ~taken
        self.shape = Shape.of(model, self.images)

    @once
    def others(self) -> DetectionModel:
        """The model of points in the places alone."""
        return self.shape.replace_points(self.places).model(self.model, self.free)

    @once
    def outside(self) -> DetectionModel:
        """The model of points in the places beyond the body."""
        return self.shape.replace_points(self.places).take(self.places.beyond).model(self.model, self.free)

    @once
    def whole(self) -> DetectionModel:
        """The model of points in all of the places, beside the body's own."""
        return self.shape.and_(self.places).model(self.model, self.free)

    def each(self, told: Posterior) -> list[Modes]:
        """The modes of a posterior that are weighed, one by one."""
        modes = told.modes.first(MODES)
        return [modes.take(slice(k, k + 1)) for k in range(len(modes.log_odds))]

    def unused_detections(self, mode: Modes) -> Bools:
        """Which detections (n',) a mode leaves."""
        (assignment,), left = mode.assignments, self.free.copy()
        left[assignment[assignment >= 0]] = False
        return left

    def off_by(self, mode: Modes) -> Floats:
        """Squared distances (m, n') of detections from the places, in units of both their variances.

        Infinite for a place that is not in view.
        """
        found, at = weigh_poses(self.others, np.full((1, self.others.shape[0]), -1), mode.rotation, mode.position)
        squared = at.squared_distances_from(self.others.target, self.others.sigma, mode.covariance[0])
        return np.where((found.visible[0] > HIDDEN)[:, None], squared, np.inf)


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
            model.points[which], _take_optional(model.normals, which), _take_optional(model.view_cosine, which),
            _take_optional(model.source_covariance, which), images,
        )  # fmt: skip

    def replace_points(self, places: Places) -> Shape:
        """Places in the stead of its points, as uncertain as these."""
        m = len(places.points)
        cosine = None if self.cosine is None else np.full(m, self.cosine.mean())
        covariance = None if self.covariance is None else np.tile(self.covariance.mean(axis=0), (m, 1, 1))
        return Shape(places.points, places.normals, cosine, covariance, self.images)

    def and_(self, places: Places) -> Shape:
        """Its points, followed by places."""
        more = self.replace_points(places)
        return Shape(
            np.concatenate([self.points, more.points]), _join_optional(self.normals, more.normals),
            _join_optional(self.cosine, more.cosine), _join_optional(self.covariance, more.covariance), self.images,
        )  # fmt: skip

    def take(self, which: Bools) -> Shape:
        """Some of its points."""
        return Shape(
            self.points[which], _take_optional(self.normals, which), _take_optional(self.cosine, which),
            _take_optional(self.covariance, which), self.images,
        )  # fmt: skip

    def model(self, model: DetectionModel, free: Bools) -> DetectionModel:
        """A model with these points, in the same poses of the same centre, of some detections (n',) only."""

        def of_all(one: Floats | None) -> Floats | None:
            return None if one is None else np.tile(one, (self.images, *(1,) * (one.ndim - 1)))

        allowed = None
        if self.images > 1 or not free.all():
            allowed = (np.repeat(np.arange(self.images), len(self.points))[:, None] == model.image_indices) & free
        wide = copy_with(
            model, points=of_all(self.points), normals=of_all(self.normals), view_cosine=of_all(self.cosine),
            source_covariance=of_all(self.covariance), allowed=allowed, log_weights=None,
        )  # fmt: skip
        wide.__dict__["centre"] = model.centre  # to which the poses and their prior refer
        return wide


def _take_optional(one: Floats | None, which: Bools | slice) -> Floats | None:
    """Some rows of what may not be known."""
    return None if one is None else one[which]


def _join_optional(one: Floats | None, other: Floats | None) -> Floats | None:
    """Rows of what may not be known, one after the other."""
    return None if one is None or other is None else np.concatenate([one, other])
