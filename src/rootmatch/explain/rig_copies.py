"""The task of a rig's copies: every camera has a copy of every point, so the methods of one camera serve all.

A copy has one image, in its camera, so its assignment is one number. Copies share one pose of the rig; the detections
of all cameras lie side by side in one plane. Bodies, predictions and the posterior treat such a task like any other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.cameras.rig import Rig, rig_of
from rootmatch.errors import InputError
from rootmatch.explain.body_labels import BodyLabels, twin_points
from rootmatch.explain.finding import Finding
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.base import Problem
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.rig_fit import LEAST, Copies, CopiesAsGiven, rig_pose
from rootmatch.samplers.guided.sampler import Guided

Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RigCopies(Problem):
    """Copies of points, one for each camera, against the detections of all; no kernels, but a fit.

    Attributes
    ----------
    copies : Copies
    task : MatchingTask
        Of the points and the rig itself.
    """

    copies: Copies
    task: MatchingTask
    name: ClassVar[str] = "rig"
    order: ClassVar[int] = 4
    minimal: ClassVar[int] = 3
    degree: ClassVar[int] = 4
    constraints: ClassVar[int] = 2
    pair_count: ClassVar[int] = 6
    source_dimension: ClassVar[int] = 3
    takes_normals: ClassVar[bool] = True
    takes_prior: ClassVar[bool] = True
    least_for_pose: ClassVar[int] = LEAST
    to_check: ClassVar[str] = "units and cameras"
    to_tell: ClassVar[str] = "give normals"

    @cached_property
    def camera(self) -> CopiesAsGiven:
        """The rig as one camera of the copies, in the caller's unit."""
        copies = self.copies
        return CopiesAsGiven(copies.rig, copies.points, copies.offsets, copies.owner)

    def in_image(self, points: PointSets) -> PointSets:
        """As they are: each camera's own task has what its image shows; see `Problem.in_image`."""
        return points

    def poses(self, points: PointSets, assignments: Integers) -> list[Pose | None]:
        """Poses of the rig; see `Problem.poses`."""
        return [rig_pose(self.copies, points, one) for one in assignments]

    def of_some(self, source: Integers, target: Integers) -> RigCopies:
        """The problem of the copies of some points, all copies of each, and of some detections."""
        points = source[source < self.copies.count]
        part = Copies(self.copies.rig, self.copies.points[points], self.copies.offsets, self.copies.owner[target])
        return RigCopies(part, self.task.subset(points, target))

    def tables(self, points: PointSets) -> Any:
        """None: hyper-edges are within a camera.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError("rig: hyper-edges of several cameras are not evaluated; take one camera")

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Refused: see `tables`."""
        raise InputError("rig: minimal sets of several cameras are not solved; take one camera")


def is_rig(task: MatchingTask) -> bool:
    """Whether the detections of a task are those of a rig."""
    return rig_of(task.problem) is not None


def copies_task(task: MatchingTask) -> MatchingTask:
    """The task of the copies of a rig's points, each of which may be any detection of its camera.

    Raises
    ------
    InputError
        For an option that rigs do not support.
    """
    _check(task)
    rig: Rig = task.problem.camera  # type: ignore[attr-defined]
    points, rows, cameras = task.points, task.points.target, len(rig.views)
    _, plane, sigma = rig.chart(rows, points.target_noise)
    copies = Copies(rig, points.source, rig.offsets(rows), rows[:, 2].astype(np.int64))
    own = np.repeat(np.arange(cameras), copies.count)[:, None] == copies.owner
    bodies, covariance = task.bodies, points.source_covariance
    return replace(
        task,
        problem=RigCopies(copies, replace(task, known=None)),
        points=PointSets(
            source=np.tile(points.source, (cameras, 1)),
            target=plane,
            source_noise=np.tile(points.source_noise, cameras),
            target_noise=sigma,
            normals=None if points.normals is None else np.tile(points.normals, (cameras, 1)),
            view_cosine=None if points.view_cosine is None else np.tile(points.view_cosine, cameras),
            source_covariance=None if covariance is None else np.tile(covariance, (cameras, 1, 1)),
            noise_alone=points.noise_alone,
        ),
        allowed=own if task.allowed is None else own & np.tile(task.allowed, (cameras, 1)),
        weights=None if task.weights is None else np.tile(task.weights, (cameras, 1)),
        bodies=None if bodies is None else BodyLabels(bodies.names, np.tile(bodies.index, cameras)),
    )


def of_points(finding: Finding, task: MatchingTask | None = None) -> Finding:
    """The finding of a rig's points, made from that of their copies: one detection for each point.

    Parameters
    ----------
    finding : Finding
        Of a task of copies.
    task : MatchingTask, optional
        That of the points and the rig, if it is another one than the copies were made of.
    """
    problem = finding.task.problem
    assert isinstance(problem, RigCopies)
    task = task or problem.task
    n, n_target = task.shape
    first, camera = _first_of(finding.assignment.reshape(-1, n))
    others, scores = [], [finding.every_score[0]]
    for other, score in finding.alternatives:
        seen = _first_of(other.reshape(-1, n))[0]
        if not np.array_equal(seen, first):
            others.append(seen)
            scores.append(score)
    points = np.flatnonzero(first >= 0)
    copies = camera[points] * n + points
    soft, labels = np.zeros((n, n_target)), np.full(n, -1, np.int64)
    soft[points, first[points]] = finding.soft_assignment[copies, first[points]]
    labels[points] = finding.motion_labels[copies]
    i, j = np.divmod(finding.tensor.indices.astype(np.int64), max(n_target, 1))
    indices = (i % n * n_target + j).astype(np.int32)
    return replace(
        finding,
        task=task,
        assignment=first,
        others=others,
        scores=scores,
        soft=soft,
        tensor=AffinityTensor.unchecked(indices, np.asarray(finding.tensor.weights), (n, n_target), task.weights),
        labels=labels,
    )


def _first_of(sightings: Integers) -> tuple[Integers, Integers]:
    """The detection of each point in the first camera that has one, −1 for none, and that camera; of (C, n)."""
    seen = sightings >= 0
    camera = seen.argmax(axis=0)
    return np.where(seen.any(axis=0), sightings[camera, np.arange(sightings.shape[1])], -1), camera


def twin_of(first: MatchingTask, second: MatchingTask, tolerance: float) -> Integers | None:
    """`twin_points` of the points of two bodies, or of their copies: camera by camera."""
    one, two = first.problem, second.problem
    if not (isinstance(one, RigCopies) and isinstance(two, RigCopies)):
        return twin_points(first.points.source, second.points.source, tolerance)
    twin = twin_points(one.copies.points, two.copies.points, tolerance)
    if twin is None:
        return None
    cameras = np.arange(len(one.copies.offsets))
    return np.asarray((cameras[:, None] * len(twin) + twin).ravel())


def _check(task: MatchingTask) -> None:
    """Refuse options that rigs do not support."""
    options = task.options
    searches = options.sampler in (None, "auto", "guided") or isinstance(options.sampler, Guided)
    given = {
        "motions": options.motions != 1,
        "preset": options.preset is not None,
        "solver": options.solver is not None,
        "scheduler": options.scheduler is not None,
        "samples": options.samples is not None,
        "sampler": not searches,
    }
    for name, is_given in given.items():
        if is_given:
            raise InputError(f"{name}: not supported for a rig; leave it out")
