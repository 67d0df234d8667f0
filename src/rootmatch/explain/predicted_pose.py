"""Matching with a predicted pose: directly if the prediction decides, otherwise also without it."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import OutOfTime
from rootmatch.explain.decide import TRUST, Facts
from rootmatch.explain.finding import Finding, empty_tensor, nothing_found
from rootmatch.explain.image_decision import told_by
from rootmatch.explain.image_hypotheses import PREDICTION, Candidate, is_enough, proposals_by_prediction
from rootmatch.explain.predicted_assignment import Found, match_with_prior, prior_of
from rootmatch.explain.predicted_likelihood import PriorFit, unbiased_frame
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.pose_fit.absolute import AbsoluteFit
from rootmatch.problems.pose_fit.pose import Pose

UNCONFIRMED = "the prior pose is not confirmed"


def match_predicted(task: MatchingTask, solve: Callable[[MatchingTask], Finding]) -> Finding:
    """The match of a task with a predicted pose.

    If the assignment about the prediction leaves a doubt, a full search runs without it. The result is the posterior of
    both, with a prediction that may be wrong; `Match.prior_holds` says whether it held.
    """
    searchable = task.shape[1] >= task.problem.order
    predicted, body = None, Candidate.of(task, [])
    with suppress(OutOfTime), task.deadline.at_least(PREDICTION).enforced():
        predicted = proposals_by_prediction(task)
        body = body.proposed([], predicted)
        told = body.alone()
        if not searchable or is_enough(body, told):
            found = told_by(nothing_found(task, UNCONFIRMED), told, body)
            if found.prior_holds:
                return replace(found, reason=None)
    if not searchable:
        return nothing_found(
            replace(task, prior_pose=None),
            f"{UNCONFIRMED}, and {task.shape[1]} detections are given where a search without it "
            f"needs {task.problem.order}",
        )
    searched = solve(replace(task, prior_pose=None))
    with suppress(OutOfTime):
        body = body.proposed(searched.every, predicted)
        return told_by(replace(searched, task=task), body.alone(), body)
    return searched


def tried(task: MatchingTask) -> tuple[Finding, Found | None]:
    """The result of a prediction, and its match: untrusted if it is not accepted, empty if nothing is found."""
    found = match_with_prior(task, prior_of(task))
    if found is None:
        return nothing_found(task, UNCONFIRMED), None
    match = match_of(task, found)
    if found.believed:
        return match, found
    return replace(match.with_facts(confirmed=False), prior_holds=None, fused_pose=None, reason=UNCONFIRMED), found


def match_of(task: MatchingTask, found: Found) -> Finding:
    """The finding of a prediction's result, as if it were accepted."""
    matched = found.assignment >= 0
    soft = np.zeros(task.shape)
    soft[matched, found.assignment[matched]] = found.probability
    best = found.alternatives[0][1] - found.log_odds if found.alternatives else -math.inf
    others = [other for other, _ in found.alternatives[: TRUST.alternatives]]
    return Finding(
        task=task,
        assignment=found.assignment,
        others=others,
        facts=Facts(lead=1.0 - math.exp(min(best, 0.0)), probability=found.probability),
        tensor=empty_tensor(task),
        scores=[math.nan] * (1 + len(others)),
        soft=soft,
        log_odds=found.log_odds,
        prior_holds=True,
        fused_pose=found.pose,
    )


def pose_of(fit: PriorFit) -> Pose:
    """The pose of a fit."""
    return Pose.unchecked(fit.R, fit.t, fit.covariance)


def _poses(task: MatchingTask, assignments: list[NDArray[np.int64]]) -> list[tuple[NDArray[np.float64], ...]]:
    """Rotation and translation that fit each assignment, in the caller's frame and unit."""
    if not assignments:
        return []
    fit = task.problem.fitted(task.points, np.array(assignments))
    assert isinstance(fit, AbsoluteFit)
    centre = task.points.source.mean(axis=0)
    unit = math.sqrt(float(((task.points.source - centre) ** 2).mean()))
    return [(R, unit * t - R @ centre) for R, t in zip(fit.rotation, fit.translation, strict=True)]


def free_pose(match: Finding) -> Pose:
    """The pose of a match with its covariance, without the prior if possible."""
    fused = match.fused_pose
    if (match.assignment >= 0).sum() <= match.task.problem.minimal and fused is not None:
        return fused
    fits = free_fits(match.task, [match.assignment])
    if not fits and fused is not None:
        return fused
    return pose_of(fits[0])


def free_fits(task: MatchingTask, assignments: list[NDArray[np.int64]]) -> list[PriorFit]:
    """Assignments fitted with the same uninformative prior.

    For a rig, assignments with too few matches in every camera are left out.
    """
    known = [
        (one, R, t) for one, (R, t) in zip(assignments, _poses(task, assignments), strict=True) if np.isfinite(t).all()
    ]
    size = float(np.sqrt(((task.points.source - task.points.source.mean(axis=0)) ** 2).mean()))
    far = max((float(np.linalg.norm(t)) for _, _, t in known), default=0.0)
    return [unbiased_frame(task, R, t, size + far).fitted(one, R, t) for one, R, t in known]
