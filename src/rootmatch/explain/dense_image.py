"""An image that is dense for its noise: poses by alignment of densities, judged by the model of the image.

Where more than one detection is expected near the prediction of a minimal set, minimal sets cannot be told apart by
their inliers, and the search by them comes to nothing. The alignment needs no pairs. It proposes poses only.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rootmatch.deadline import OutOfTime
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding, nothing_found
from rootmatch.explain.image_decision import is_modelled, told_by
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.task import MatchingTask
from rootmatch.model.proposals import Proposals
from rootmatch.model.views import rays_of
from rootmatch.problems.p3p import P3P
from rootmatch.samplers.densities.alignment import ROTATIONS, Aligned, Blob, aligned

Floats = NDArray[np.float64]

VAGUE = 3.0
"""Standard deviations of the noise by which the pose of a minimal set typically misses another point's image. A round
value; benchmarks/results/blind.csv has both sides of the rule."""
GATE = 2.5
"""Of those, within which detections of a point are looked for."""
PAIRED = 3.0
"""Standard deviations of the noise within which a point and a detection, each other's nearest, are paired."""
SHARE = 0.5
"""Of the time left, for the alignment: the search follows where it finds nothing."""
FIRST = 8
"""Aligned poses that are weighed."""


def match_dense(task: MatchingTask) -> Finding | None:
    """The finding by alignment of densities; None if the image is not dense, or nothing is found."""
    plane = _in_plane(task)
    if plane is None or not is_dense(*plane, task.shape[0]):
        return None
    detections, sigma = plane
    points = task.points.source
    rng = np.random.default_rng(task.options.seed)
    try:
        with task.deadline.part(SHARE).enforced():
            poses = aligned(points - points.mean(axis=0), detections, sigma, rng=rng)
            body = Candidate.of(task, [])
            body = body.proposed([], _paired(task, detections, sigma, poses))
            told = body.alone()
    except OutOfTime:
        return None
    found = told_by(nothing_found(task, "no pose aligns the points with the detections"), told, body)
    return None if found.status is Status.UNTRUSTED else replace(found, reason=None, evaluated=ROTATIONS)


def is_dense(detections: Floats, sigma: float, points: int) -> bool:
    """Whether more than one detection is expected near the prediction of a minimal set, where the body is."""
    blob = Blob.of(detections, sigma, points)
    near = math.pi * (GATE * VAGUE * sigma) ** 2
    return min(points, len(detections)) * near > blob.extent > 0.0


def _in_plane(task: MatchingTask) -> tuple[Floats, float] | None:
    """Detections (n', 2) in units of the focal length and their σ there; None where the alignment does not apply.

    It takes every point to be visible from everywhere, and knows one camera, one body and no prior.
    """
    options, points = task.options, task.points
    default = options.chosen_sampler == "auto" and options.solver is None and options.scheduler is None
    free = task.allowed is None and task.weights is None and not task.has_prior and task.budget is None
    known = points.normals is None and points.source_covariance is None
    if not (isinstance(task.problem, P3P) and is_modelled(task) and default and free and known):
        return None
    camera, target, sigma = task.problem.camera.chart(points.target, points.detection_noise)
    rays = rays_of(camera, target)
    aside = rays_of(camera, target + np.array([float(np.median(sigma)), 0.0]))
    if task.shape[1] <= task.problem.order or not (np.minimum(rays[:, 2], aside[:, 2]) > 0.0).all():
        return None
    flat, moved = rays[:, :2] / rays[:, 2:], aside[:, :2] / aside[:, 2:]
    return flat, float(np.median(np.linalg.norm(moved - flat, axis=1)))


def _paired(task: MatchingTask, detections: Floats, sigma: float, poses: Aligned) -> Proposals:
    """The aligned poses with the pairs that are each other's nearest there."""
    points, rows, tree = task.points.source - task.points.source.mean(axis=0), [], cKDTree(detections)
    for R, t in zip(poses.rotation[:FIRST], poses.position[:FIRST], strict=True):
        seen = points @ R.T + t
        image = seen[:, :2] / np.maximum(seen[:, 2:], 1e-9)
        away, nearest = tree.query(image)
        back = cKDTree(image).query(detections)[1]
        mutual = (back[nearest] == np.arange(len(points))) & (away <= PAIRED * sigma)
        rows.append(np.where(mutual, nearest, -1))
    assignments = np.array(rows, np.int64).reshape(-1, len(points))
    return Proposals(assignments, poses.rotation[:FIRST], poses.position[:FIRST])
