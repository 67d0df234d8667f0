"""Matching with a predicted pose: at once where the prediction decides, otherwise without it, and it is then judged."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.on_demand import changed
from rootmatch.pipeline.prior import DEFAULT_PRIOR, Found, match_with_prior, prior_of
from rootmatch.pipeline.prior_frame import PriorFit, PriorFrame, unbiased_frame
from rootmatch.pipeline.status import TRUST, Status
from rootmatch.pipeline.task import MatchingTask
from rootmatch.problems.pose_fit.absolute import AbsoluteFit
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.result import Match

UNCONFIRMED = "the prior pose is not confirmed"


def match_predicted(task: MatchingTask, solve: Callable[[MatchingTask], Match]) -> Match:
    """The match of a task with a predicted pose.

    Where the prediction and the detections do not agree on an assignment that is beyond chance, all is searched without
    the prediction; `Match.prior_holds` says what came of it.
    """
    direct = direct_match(task)
    if direct is not None:
        return direct
    without = replace(task, predicted=None)
    if task.shape[1] < task.problem.order:
        return empty_match(
            without,
            f"{UNCONFIRMED}, and {task.shape[1]} detections are given where a search without it "
            f"needs {task.problem.order}",
        )
    return _judged(task, solve(without))


def direct_match(task: MatchingTask) -> Match | None:
    """The match that a prediction decides; None where it does not."""
    match, found = tried(task)
    return match if found is not None and found.believed else None


def tried(task: MatchingTask) -> tuple[Match, Found | None]:
    """What a prediction finds, and its match: untrusted where it is not believed, empty where nothing is found."""
    found = match_with_prior(task, prior_of(task))
    if found is None:
        return empty_match(task, UNCONFIRMED), None
    match = match_of(task, found)
    if found.believed:
        return match, found
    return replace(match, status=Status.UNTRUSTED, prior_holds=None, fused_pose=None, fault=UNCONFIRMED), found


def match_of(task: MatchingTask, found: Found) -> Match:
    """The match of what a prediction found, as if it is believed."""
    n, n_target = task.shape
    matched = found.assignment >= 0
    soft = np.zeros((n, n_target))
    soft[matched, found.assignment[matched]] = found.probability
    best = found.alternatives[0][1] - found.log_odds if found.alternatives else -math.inf
    return Match(
        task=task,
        assignment=found.assignment,
        score=found.log_odds,
        margin=1.0 - math.exp(min(best, 0.0)),
        alternatives=found.alternatives[: TRUST.alternatives],
        soft=soft,
        tensor=AffinityTensor.unchecked(np.empty((0, task.problem.order), np.int32), np.empty(0), (n, n_target)),
        motions=np.where(matched, 0, -1),
        status=Status.MATCHED if found.probability >= TRUST.probability else Status.AMBIGUOUS,
        converged=True,
        hyperedges=0,
        seconds=0.0,
        fitted_probability=found.probability,
        prior_holds=True,
        fused_pose=found.pose,
    )


def _judged(task: MatchingTask, found: Match) -> Match:
    """A match found without the prediction, and whether that held; it decides between what else is equally good."""
    if found.status is Status.UNTRUSTED:
        return changed(found, prior_holds=None)
    every = [found.assignment, *(other for other, _ in found.alternatives)]
    every = [one for one in every if (one >= 0).sum() > task.problem.minimal]
    frame = PriorFrame(task, prior_of(task))
    fits = [frame.fitted(one, R, t) for one, (R, t) in zip(every, _poses(task, every), strict=True)]
    near = [fit for fit in fits if fit.chi2_prior < DEFAULT_PRIOR.contradicted]
    if not near:
        return changed(found, prior_holds=False)
    if found.status is Status.MATCHED:
        own = fits[0]
        held = own in near
        return changed(found, task=task, prior_holds=held, fused_pose=pose_of(own) if held else None)
    near.sort(key=lambda fit: -fit.log_odds)
    best, others = near[0], near[1:]
    share = 1.0 / (1.0 + sum(math.exp(max(fit.log_odds - best.log_odds, -700.0)) for fit in others))
    probability = share / (1.0 + frame.neighbours(best)[0])
    return replace(
        found,
        task=task,
        assignment=best.assignment,
        alternatives=[(one, score) for one, score in [(found.assignment, found.score), *found.alternatives]
                      if not np.array_equal(one, best.assignment)],
        motions=np.where(best.assignment >= 0, 0, -1),
        status=Status.MATCHED if probability >= TRUST.probability else Status.AMBIGUOUS,
        fitted_probability=probability,
        prior_holds=True,
        fused_pose=pose_of(best),
    )  # fmt: skip


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


def empty_match(task: MatchingTask, fault: str) -> Match:
    """The match of a task that leaves nothing to match."""
    n, n_target = task.shape
    return Match(
        task=task,
        assignment=np.full(n, -1, np.int64),
        score=0.0,
        margin=0.0,
        alternatives=[],
        soft=np.zeros((n, n_target)),
        tensor=AffinityTensor.unchecked(np.empty((0, task.problem.order), np.int32), np.empty(0), (n, n_target)),
        motions=np.full(n, -1, np.int64),
        status=Status.UNTRUSTED,
        converged=True,
        hyperedges=0,
        seconds=0.0,
        fault=fault,
    )


def free_pose(match: Match) -> Pose:
    """The pose of a match with its covariance, without a prior, or that with it where only that is known."""
    fused = match.fused_pose
    if (match.assignment >= 0).sum() <= match.problem.minimal and fused is not None:
        return fused
    fits = free_fits(match.task, [match.assignment])
    if not fits and fused is not None:
        return fused
    return pose_of(fits[0])


def free_fits(task: MatchingTask, assignments: list[NDArray[np.int64]]) -> list[PriorFit]:
    """Assignments fitted with a prior that says nothing, the same for all of them.

    Of a rig those are left out that have too few matches in every camera.
    """
    known = [
        (one, R, t) for one, (R, t) in zip(assignments, _poses(task, assignments), strict=True) if np.isfinite(t).all()
    ]
    size = float(np.sqrt(((task.points.source - task.points.source.mean(axis=0)) ** 2).mean()))
    far = max((float(np.linalg.norm(t)) for _, _, t in known), default=0.0)
    return [unbiased_frame(task, R, t, size + far).fitted(one, R, t) for one, R, t in known]
