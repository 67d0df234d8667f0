"""`Sightings`: what each camera of a rig sees of the points of a match."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.rig_copies import RigCopies
from rootmatch.problems.pose_fit.pose import Pose

if TYPE_CHECKING:
    from rootmatch.result import Match

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sightings:
    """Detections of the points in each camera of a rig.

    Attributes
    ----------
    assignment : (C, n) int64
        Index into the target of each source point in each camera; −1 where it is not seen.
    alternatives : list of (C, n) int64
        The next most probable sightings.
    poses : list of Pose or None
        Poses of the bodies in the rig, each fitted to all sightings; their ``points`` are camera · n + point.
    confidence : (n,) float64
        Of each point: of its surest sighting, or the least of those that an unseen point lacks.
    """

    copies: Match

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        problem = self.copies.task.problem
        assert isinstance(problem, RigCopies)
        return len(problem.copies.offsets)

    @property
    def assignment(self) -> Integers:
        """Index into the target of each source point in each camera, (C, n); −1 where it is not seen."""
        return self.copies.assignment.reshape(self.cameras, -1)

    @property
    def alternatives(self) -> list[Integers]:
        """The next most probable sightings."""
        return [other.reshape(self.cameras, -1) for other, _ in self.copies.alternatives]

    @property
    def poses(self) -> list[Pose | None]:
        """Poses of the bodies in the rig, each fitted to all sightings; their ``points`` are camera · n + point."""
        return self.copies.poses

    @property
    def pose(self) -> Pose | None:
        """The pose of the first body; None if there is none."""
        return self.poses[0] if self.poses else None

    @cached_property
    def confidence(self) -> Floats:
        """Confidence of each point (n,): that of its surest sighting; if unseen, the least over the cameras."""
        each = self.copies.confidence.reshape(self.assignment.shape)
        surest = np.where(self.assignment >= 0, each, -1.0).max(axis=0)
        return np.asarray(np.where((self.assignment >= 0).any(axis=0), surest, each.min(axis=0)))
