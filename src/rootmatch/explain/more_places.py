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
OF_POINTS = "points", "normals", "view_cosine", "source_covariance"
"""What a model has of each of its points."""


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
        n, m = len(model.points) // self.images, len(places.points)
        self.own = {name: one[:n] for name in OF_POINTS if (one := getattr(model, name)) is not None}
        """What is known of the body's points in one image."""
        # places are as uncertain as the points, and seen as far aside
        self.there = {name: np.tile(one.mean(axis=0), (m, *(1,) * (one.ndim - 1))) for name, one in self.own.items()}
        """The same of the places."""
        self.there["points"] = places.points
        if places.normals is not None:
            self.there["normals"] = places.normals

    @once
    def others(self) -> DetectionModel:
        """The model of points in the places alone."""
        return self._with_points(self.there)

    @once
    def outside(self) -> DetectionModel:
        """The model of points in the places beyond the body."""
        return self._with_points({name: one[self.places.beyond] for name, one in self.there.items()})

    @once
    def whole(self) -> DetectionModel:
        """The model of points in all of the places, beside the body's own."""
        return self._with_points({name: np.concatenate([one, self.there[name]]) for name, one in self.own.items()})

    @once
    def filled(self) -> DetectionModel:
        """The model of points in the body's holes, beside its own."""
        holes = ~self.places.beyond
        return self._with_points(
            {name: np.concatenate([one, self.there[name][holes]]) for name, one in self.own.items()}
        )

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

    def _with_points(self, points: dict[str, Floats]) -> DetectionModel:
        """The model with other points, in the same poses of the same centre, of the free detections only."""
        of_all = {name: np.tile(one, (self.images, *(1,) * (one.ndim - 1))) for name, one in points.items()}
        allowed = None
        if self.images > 1 or not self.free.all():
            image = np.repeat(np.arange(self.images), len(points["points"]))
            allowed = (image[:, None] == self.model.image_indices) & self.free
        wide = copy_with(self.model, allowed=allowed, log_weights=None, **of_all)
        wide.__dict__["centre"] = self.model.centre  # to which the poses and their prior refer
        return wide


def log_shown_chance(chances: Floats, matched: Bools, rates: Floats, log_weights: Floats) -> float:
    """Logarithm of the probability that these of some points are detected, with the chances (n,) that they can be.

    ``rates``, ``log_weights``: of the integral over the detection rate.
    """
    each = rates[:, None] * chances
    return float(np.logaddexp.reduce(log_weights + np.log(np.where(matched, each, 1.0 - each)).sum(axis=1)))
