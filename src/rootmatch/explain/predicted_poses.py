"""The predicted poses of a task, with the vertical where that is measured, and fits of assignments with them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rootmatch.algebra.rotation import angle_count, one_rotation_matrix
from rootmatch.arrays import Floats, Integers
from rootmatch.explain.finding import Finding, mode_pose
from rootmatch.explain.prior_validation import NONE, problem_vertical
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.blobs import resolve_blobs
from rootmatch.model.errors_in_common import errors_in_common
from rootmatch.model.evidence import squared_deviations, weigh_assignments
from rootmatch.model.exchanged import own_prior
from rootmatch.model.known_density import Known
from rootmatch.model.pose_density import Broad, Doubted, Gaussian
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.pose_fit.camera_fit import camera_poses
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_checks import nearest_covariance
from rootmatch.problems.pose_fit.pose_prior import PosePrior, turn_vectors
from rootmatch.problems.pose_fit.reference_point import add_arc_curvature, covariance_in_either_axes, pose_about_point
from rootmatch.problems.pose_fit.rig_fit import rig_pose
from rootmatch.problems.pose_fit.shared_errors import (
    SharedPose,
    copy_shared_errors,
    fuse_prediction,
    with_whole_covariance,
)
from rootmatch.problems.up2p import UP2P
from rootmatch.problems.up2pf import UP2PF

WITHIN = 22.5
"""Squared deviation from a predicted pose up to which it is no contradiction: beyond is one in a thousand of χ² of six
parameters."""

CONTRADICTED = 30.0
"""Squared deviation from what is known in part of a pose beyond which it is contradicted: of three numbers it has a
chance of 1e-6, and sensors have errors that nobody stated. A round value."""
EXACT = 1e-12
"""Least variance of a direction, radians²."""

MINIMUM = 1
"""Degrees of freedom beyond two that a pose is taken to have at the least, where its noise is estimated."""


def pose_knowledge(task: MatchingTask) -> PosePrior | None:
    """Partial knowledge of a task's pose, with the vertical of its problem; None if there is none but that."""
    upright = None if task.known is None else problem_vertical(task.problem)
    return task.known if upright is None or task.known is None else copy_with(task.known, vertical=upright.vertical)


def predicted_mixture(task: MatchingTask) -> list[tuple[Pose, float]]:
    """The predicted poses of a task and the share of each, which add up to 1: the one given, then its rivals."""
    assert task.prior_pose is not None
    every = [(task.prior_pose, 1.0 - sum(share for _, share in task.rivals.poses)), *task.rivals.poses]
    upright = problem_vertical(task.problem)
    return every if upright is None else [(upright.with_prediction(pose), share) for pose, share in every]


def assignment_labels(task: MatchingTask, motions: Integers) -> Integers:
    """Motion (n,) that each point has in any assignment: that of its body, or the only one; else as in a match."""
    if task.bodies is not None:
        return task.bodies.index
    return motions if motions.max(initial=-1) > 0 else np.zeros_like(motions)


def agrees_with_prior(found: Finding) -> bool | None:
    """Whether a finding agrees with what a caller knows of the pose; None if it is not trusted, or without a prior.

    A predicted pose so vague that it tells less than knowing nothing does not hold, but is no contradiction either. Nor
    does one agree that is many standard deviations away, though that is more probable than a prediction that is wrong.
    The vertical of `UP2P` is part of what is known, and is told if it is contradicted. Several bodies agree if none
    disagrees.
    """
    if found.parts is not None:
        told = {agrees_with_prior(part) for part in found.parts.values()} - {None}
        return all(told) if told else None
    prior, pose = found.task.prior_pose, found.pose
    if found.contradicted or contradicts_vertical(found):
        return False
    if found.prior_holds is None or prior is None or pose is None:
        return found.prior_holds
    if prior.covariance is None or pose.covariance is None or len(prior.covariance) != len(pose.covariance):
        return found.prior_holds
    off = np.array([*turn_vectors((pose.R @ prior.R.T)[None])[0], *(pose.t - prior.t)])
    spread = (prior.covariance + pose.covariance)[: len(off), : len(off)]  # without a scale
    unit = np.sqrt(np.maximum(spread.diagonal(), EXACT))
    return bool(off / unit @ np.linalg.lstsq(spread / np.outer(unit, unit), off / unit)[0] <= WITHIN)


def is_against_prior(found: Finding) -> bool:
    """Whether what was found contradicts a prior, but for which it would be trusted."""
    told, prior = found.posterior, None if found.model is None else own_prior(found.model.prior)
    if told is None or told.origins is None or not isinstance(prior, Doubted) or told.origins[found.mode] >= 0:
        return False
    chance, minimum = found.facts.probability or 0.0, found.facts.min_probability
    return chance * (1.0 - minimum) >= prior.doubt * (1.0 - chance) * minimum


def contradicts(known: PosePrior, pose: Pose) -> bool:
    """Whether a pose is where what is known of it in part all but excludes it."""
    angles = angle_count(len(pose.t))
    spread, apart = np.zeros((6, 6)) if pose.covariance is None else pose.covariance, 0.0
    own = slice(angles, angles + len(pose.t))
    if known.vertical is not None:
        source, camera, sigma = np.asarray(known.vertical[0]), np.asarray(known.vertical[1]), known.vertical[2]
        turned = pose.R @ source
        angle = math.atan2(float(np.linalg.norm(np.cross(turned, camera))), float(turned @ camera))
        apart = angle**2 / max(sigma**2 + float(np.linalg.eigvalsh(spread[:3, :3])[-1]), EXACT)
    parts = []
    if known.rotation is not None:
        R, covariance = known.rotation
        (off,) = turn_vectors((pose.R @ np.asarray(R).T)[None])
        parts.append((off, np.asarray(covariance) + spread[:angles, :angles]))
    if known.place is not None:
        parts.append((pose.t - known.place[0], known.place[1] + spread[own, own]))
    apart = max(apart, *(float(off @ np.linalg.lstsq(both, off)[0]) for off, both in parts), 0.0)
    return apart > CONTRADICTED


def contradicts_vertical(found: Finding) -> bool:
    """Whether what is trusted shows a vertical that the problem's own all but excludes.

    Its pose is of both, and nearer to that than what the detections alone show, to first order.
    """
    upright, pose, model = problem_vertical(found.task.problem), found.pose, found.model
    if upright is None or pose is None or model is None:
        return False
    (R,), (place,) = at = model.centred(pose.R[None], pose.t[None])
    alone = weigh_assignments(model, found.assignment[None], model.linearise_about(*at), Broad(model.radius))
    turn, shift = np.split(alone.step[0], 2)
    return contradicts(upright, model.pose_of_origin(one_rotation_matrix(turn) @ R, place + shift, alone.covariance[0]))


def check_contradiction(found: Finding, told: Pose | PosePrior | None) -> Finding:
    """A finding about a prediction that what is ``told`` of its pose in part was combined with, compared with that.

    The combination is of first order, and a vertical that is upside down does not change it.
    """
    against = isinstance(told, PosePrior) and found.pose is not None and contradicts(told, found.pose)
    return (
        copy_with(found, prior_holds=False, contradicted=True) if against and found.prior_holds is not None else found
    )


def finding_poses(found: Finding) -> list[Pose | None]:
    """The most likely pose of each motion of a finding: polished from that of its model if there is one."""
    matched = found.matched_count
    found = copy_with(found, fitted=found.pose or _weighed_pose(found))
    if found.pose is not None and (found.prior_holds or matched >= found.task.problem.min_for_pose):
        pose = polish_pose(found)
        return [None if pose is None else inflate_estimated_noise(found.task, pose)]
    return fit_match_poses(found.task, [found.assignment], found.motion_labels)[0]


def _weighed_pose(found: Finding) -> Pose | None:
    """The pose with which an assignment was weighed that is not trusted; None if it was not weighed with any.

    A fit anew of what fits badly, as with a vertical that is upside down, may end anywhere.
    """
    if found.posterior is None or found.model is None or found.mode >= len(found.posterior.modes.log_mass):
        return None
    modes, k, own = found.posterior.modes, found.mode, found.assignment >= 0
    if (modes.assignments[k][own] != found.assignment[own]).any():
        return None
    return mode_pose(found.model, modes, k)


def fused_pose(found: Finding) -> Pose | None:
    """The pose of a finding's matches and its prediction together; None if that did not hold."""
    if found.pose is None or not agrees_with_prior(found):
        return None
    return share_errors(found, found.pose, found.task.prior_pose)


def polish_pose(found: Finding) -> Pose | None:
    """The most likely pose of a finding's assignment near the pose of its model, with its residuals.

    A prediction that holds is part of the fit, and counts less if it is far from that pose. Partial knowledge that
    holds is a normal distribution about that pose. A vertical that is contradicted has no part in it.
    """
    task, assignment, pose, prior_holds = found.task, found.assignment, found.pose, bool(found.prior_holds)
    assert pose is not None
    if task.problem.takes_motion_prior:
        return share_errors(found, pose, task.prior_pose)  # what is known is part of it, in closed form
    problem, known = task.problem, pose_knowledge(task)
    points = task.points if task.rig is None else task.sightings[1]
    if found.model is not None:
        points = resolve_blobs(found.model, points, assignment, pose)
    if isinstance(problem, UP2PF):
        return problem.poses(points, assignment[None], pose)[0]
    prior, centre = None, points.source.mean(axis=0)
    level = isinstance(problem, UP2P) and not contradicts_vertical(found)
    if prior_holds and known is not None:
        prior = Known(known, centre).about(pose)
    elif prior_holds:
        prior = _gaussian_near(task, predicted_mixture(task)[0][0], pose, centre)
    elif task.rig is not None and level and (upright := problem_vertical(problem)) is not None:
        prior = Known(upright, centre).about(pose)
    if task.rig is not None:
        fit = rig_pose(task.sightings[0], points, assignment, prior, start=pose)
    else:
        vertical = problem.upright if level and prior is None else None  # type: ignore[attr-defined]
        camera = problem.camera  # type: ignore[attr-defined]
        fit = camera_poses(points, camera, assignment[None], upright=vertical, prior=prior, start=pose)[0]
    return None if fit is None else _restate_chi2(found, share_errors(found, fit, prior))


def _restate_chi2(found: Finding, fit: Pose) -> Pose:
    """A fit of a finding with χ² by the noise that was stated, where the points are off though nobody said so.

    Its covariance is that of a fit which allows for them.
    """
    if not found.point_error or found.model is None or fit.chi2 is None or not fit.dof:
        return fit
    model, exact = found.model, copy_with(found.model, source_covariance=None)
    at = model.linearise_about(*model.centred(fit.R[None], fit.t[None]))
    squared, stated = (squared_deviations(one, found.assignment[None], at)[0] for one in (model, exact))
    chi2 = max(float(fit.chi2 + stated - squared), 0.0)
    return replace(fit, chi2=chi2, rms_sigma=math.sqrt(chi2 / fit.dof))


def share_errors(found: Finding, fit: Pose, prior: Pose | None) -> Pose:
    """A fit of a finding as it is told: with what first order leaves out of its covariance.

    Errors of the source that it has in common with a prediction are counted once.
    """
    own, model = fit.shared if isinstance(fit, SharedPose) else None, found.model
    if own is None and model is not None and (isinstance(prior, SharedPose) or model.calibration_noise is not None):
        own = errors_in_common(model, found.assignment, fit)
    told = with_whole_covariance(fit)
    if own is not None and isinstance(prior, SharedPose):
        told = fuse_prediction(prior, told, own)
    elif own is not None and not isinstance(fit, SharedPose):
        assert fit.covariance is not None
        whole = fit.covariance - own.counted + own.each @ own.each.T  # of the rank of the fit: a vertical may be exact
        told = replace(fit, covariance=nearest_covariance(whole))
    if told.covariance is None or len(told.t) == 2:  # where one angle is, positions are on an arc of first order
        return told
    if (covariance := add_arc_curvature(told.covariance)) is told.covariance:
        return told
    return replace(told, covariance=covariance)


def _gaussian_near(task: MatchingTask, prior: Pose, near: Pose, centre: Floats) -> Pose:
    """A prediction with the covariance that `Gaussian` has about a pose: its tails, and axes of either kind."""
    assert prior.covariance is not None
    place, covariance = pose_about_point(prior.R, prior.t, prior.covariance, centre)
    gaussian = Gaussian(prior.R, place, covariance, freedom=task.prior_freedom)
    at = near.R[None], (near.t + near.R @ centre)[None]
    weight = float(gaussian.tail_weight(replace(gaussian, freedom=math.inf).terms(*at).squared)[0])
    turn = np.kron(np.eye(2), prior.R @ near.R.T)
    covariance = (
        covariance_in_either_axes(gaussian.bounded_covariance, turn @ gaussian.bounded_covariance @ turn.T) / weight
    )
    return copy_shared_errors(Pose.unchecked(prior.R, *pose_about_point(prior.R, place, covariance, -centre)), prior)


def select_prediction(task: MatchingTask, k: int) -> MatchingTask:
    """The same task with one of its predicted poses alone."""
    if not task.rivals.poses:
        return task
    every = [task.prior_pose, *(pose for pose, _ in task.rivals.poses)]
    return copy_with(task, prior_pose=every[k], rivals=NONE)


def fit_match_poses(task: MatchingTask, assignments: list[Integers], motions: Integers) -> list[list[Pose | None]]:
    """Poses of each assignment (n,), one per motion (n,); raises `InputError` if the problem fits none.

    Matched points without a motion are left out, unless there is only one. None for a motion with fewer matches than
    the problem's pose needs, or if no pose puts them in front of the camera. All are fitted at once.
    """
    problem = task.problem
    Capability.POSE.require(problem.min_for_pose, problem.name)
    count = int(motions.max(initial=-1)) + 1
    labels = np.zeros_like(motions) if count == 1 else motions
    groups = [np.where(labels == label, assignment, -1) for assignment in assignments for label in range(count)]
    enough = [k for k, group in enumerate(groups) if (group >= 0).sum() >= problem.min_for_pose]
    fitted = problem.poses(task.points, np.array([groups[k] for k in enough])) if enough else []
    # a pose predicts no image of a point that is beside the camera
    poses = {
        k: inflate_estimated_noise(task, pose)
        for k, pose in zip(enough, fitted, strict=True)
        if pose is not None and (pose.predicted is None or np.isfinite(pose.predicted).all())
    }
    return [[poses.get(row * count + label) for label in range(count)] for row in range(len(assignments))]


def inflate_estimated_noise(task: MatchingTask, pose: Pose) -> Pose:
    """A pose with the covariance of its t-distribution, if the noise was estimated from its own residuals."""
    if not task.noise_is_estimated or pose.covariance is None or pose.dof is None:
        return pose
    return replace(pose, covariance=pose.covariance * (pose.dof / max(pose.dof - 2, MINIMUM)))
