"""An image that is dense for its noise: poses by alignment of densities, judged by the model of the image.

Where more than one detection is expected near the prediction of a minimal set, minimal sets cannot be told apart by
their inliers, and the search by them comes to nothing. The alignment needs no pairs. It proposes poses only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.deadline import OutOfTime
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.image_decision import is_modelled, tell_image
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.task import MatchingTask
from rootmatch.model.proposals import Proposals
from rootmatch.model.views import unproject_detections
from rootmatch.problems.p3p import P3P
from rootmatch.samplers.densities.alignment import ROTATIONS, Aligned, align_densities
from rootmatch.samplers.guided.crowding import crowding

CROWDED, LARGE = 1.0, 100
"""`crowding` of the detections and number of points from which densities are aligned. With fewer points the search by
wide triples is as quick: .4 s with 70, .9 with 100, 3.4 with 150, where the alignment takes one (`rootmatch benchmark
blind`, surfaces from seed 1040)."""
PAIRED = 3.0
"""Standard deviations of the noise within which a point and a detection, each other's nearest, are paired."""
SHARE = 0.5
"""Of the time left, for the alignment: the search follows where it finds nothing."""
FIRST = 8
"""Aligned poses that are weighed."""


def match_dense(task: MatchingTask) -> Finding | None:
    """The finding by alignment of densities; None if the image is not dense, or nothing is found."""
    plane = _plane_detections(task)
    if plane is None:
        return None
    detections, sigma = plane
    points = task.points.source
    rng = np.random.default_rng(task.options.seed)
    try:
        with task.deadline.part(SHARE).enforce():
            poses = align_densities(points - points.mean(axis=0), detections, sigma, rng=rng)
            body = Candidate.of(task, []).posed(_pair_nearest(task, detections, sigma, poses))
            told = body.alone()
    except OutOfTime:
        return None
    found = tell_image(make_empty_finding(task, "no pose aligns the points with the detections"), told, body)
    return None if found.status is Status.UNTRUSTED else replace(found, reason=None, evaluated=ROTATIONS)


def _plane_detections(task: MatchingTask) -> tuple[Floats, float] | None:
    """Detections (n', 2) in units of the focal length and their σ there; None where densities are not aligned.

    Where they are not crowded, minimal sets tell more. The alignment takes every point to be visible from everywhere,
    and knows one camera, one body and no prior.
    """
    options, points = task.options, task.points
    default = options.chosen_sampler == "auto" and options.solver is None and options.scheduler is None
    free = task.allowed is None and task.weights is None and not task.has_prior and task.budget is None
    known = points.normals is None and not points.has_covariances
    if not (isinstance(task.problem, P3P) and is_modelled(task) and default and free and known):
        return None
    if task.shape[0] < LARGE or task.shape[1] <= task.problem.order:
        return None
    camera, target, sigma = task.problem.camera.chart(points.target, points.detection_noise)
    rays = unproject_detections(camera, target)
    aside = unproject_detections(camera, target + np.array([float(np.median(sigma)), 0.0]))
    if not (np.minimum(rays[:, 2], aside[:, 2]) > 0.0).all():
        return None
    if crowding(rays, np.linalg.norm(aside - rays, axis=1)) < CROWDED:
        return None
    flat, moved = rays[:, :2] / rays[:, 2:], aside[:, :2] / aside[:, 2:]
    return flat, float(np.median(np.linalg.norm(moved - flat, axis=1)))


def _pair_nearest(task: MatchingTask, detections: Floats, sigma: float, poses: Aligned) -> Proposals:
    """The aligned poses with the pairs that are each other's nearest there."""
    from scipy.spatial import cKDTree  # slow to import, and few images are dense

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
