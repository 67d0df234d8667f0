"""`Sightings`: what each camera of a rig sees of the points of a match."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.finding import Finding
from rootmatch.explain.predicted_poses import finding_poses
from rootmatch.hypergraph.deferred_tensor import renumber_tensor
from rootmatch.problems.pose_fit.pose import Pose


@dataclass(frozen=True, eq=False)
class Sightings:
    """Detections of the points in each camera of a rig."""

    finding: Finding

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return self.finding.task.rows // self.finding.task.shape[0]

    @property
    def assignment(self) -> Integers:
        """Index into the target of each source point in each camera, (C, n); −1 where it is not seen."""
        return self.finding.assignment.reshape(self.cameras, -1)

    @property
    def alternatives(self) -> list[Integers]:
        """The next most probable sightings, each (C, n)."""
        return [other.reshape(self.cameras, -1) for other in self.finding.others]

    @cached_property
    def poses(self) -> list[Pose | None]:
        """Poses of the bodies in the rig, each fitted to all sightings; their ``points`` are camera · n + point."""
        return finding_poses(self.finding)

    @property
    def pose(self) -> Pose | None:
        """The pose of the first body; None if there is none."""
        return self.poses[0] if self.poses else None

    @cached_property
    def confidence(self) -> Floats:
        """Confidence of each point (n,): that of its surest sighting; if unseen, the least over the cameras."""
        known = self.finding.all_confidence
        each = np.full(self.assignment.shape, np.nan) if known is None else known.reshape(self.assignment.shape)
        surest = np.where(self.assignment >= 0, each, -1.0).max(axis=0)
        return np.asarray(np.where((self.assignment >= 0).any(axis=0), surest, each.min(axis=0)))


def reduce_to_first_cameras(finding: Finding) -> Finding:
    """The finding of a rig with one detection for each point: that of the first camera that sees it."""
    task = finding.task
    n, n_target = task.shape
    first, camera = _first_detections(finding.assignment.reshape(-1, n))
    others, scores = [], [finding.all_scores[0]]
    for other, score in finding.alternatives:
        seen = _first_detections(other.reshape(-1, n))[0]
        if not np.array_equal(seen, first):
            others.append(seen)
            scores.append(score)
    points = np.flatnonzero(first >= 0)
    rows = camera[points] * n + points
    soft, labels = np.zeros((n, n_target)), np.full(n, -1, np.int64)
    soft[points, first[points]] = finding.soft_assignment[rows, first[points]]
    labels[points] = finding.motion_labels[rows]
    of_rows = np.arange(task.rows) % n, np.arange(n_target)
    return replace(
        finding,
        assignment=first,
        others=others,
        scores=scores,
        soft=soft,
        tensor=renumber_tensor(finding.tensor, of_rows, (n, n_target), task.weights),
        labels=labels,
    )


def _first_detections(sightings: Integers) -> tuple[Integers, Integers]:
    """The detection of each point in the first camera that has one, −1 for none, and that camera; of (C, n)."""
    seen = sightings >= 0
    camera = seen.argmax(axis=0)
    return np.where(seen.any(axis=0), sightings[camera, np.arange(sightings.shape[1])], -1), camera
