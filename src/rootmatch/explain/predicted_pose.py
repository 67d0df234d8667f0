"""Matching with a predicted pose: directly if the prediction decides, otherwise also without it.

Of two point sets, what is assigned about predicted motions, and whether a search could find more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.deadline import OutOfTime
from rootmatch.explain.bodies import SURE, UNCONFIRMED, Choice, SearchPart, why_unsearched
from rootmatch.explain.body_findings import restore_columns
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.image_decision import image_finding
from rootmatch.explain.image_hypotheses import NAMED, Candidate, is_search_needless, propose_predicted
from rootmatch.explain.in_time import prediction_deadline
from rootmatch.explain.inexact_points import allow_point_errors
from rootmatch.explain.prior_validation import NONE
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.modes import used_mask
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.problems.pose_fit.point_set_fit import FEWEST


def match_predicted(
    task: MatchingTask, solve: Callable[[MatchingTask], Finding] | None, choice: Choice | None = None
) -> Finding:
    """The match of a task with a predicted pose, or with several.

    Where what is assigned about the prediction leaves a doubt, all is searched without it; what is told is the
    posterior of both, under a prediction that may be wrong. `Match.prior_holds` says what came of it. Nothing is
    searched without ``solve``, from a task without a prediction to its match; ``choice`` says what is.
    """
    searchable = solve is not None and task.shape[1] >= task.problem.order
    body = Candidate.of(task, [])
    predicted, found = None, make_empty_finding(task, None)
    with prediction_deadline(task.deadline).within():
        predicted = propose_predicted(body.model)
        body = body.with_assignments([], predicted)
        told = body.alone()
        if choice is not None or not searchable or is_search_needless(body.model, told, task.minimal):
            found = allow_point_errors(image_finding(found, told, body), task)
    reason = None if found.prior_holds else found.reason or why_unsearched(task)
    found = found if found.reason == reason else copy_with(found, reason=reason)
    if found.prior_holds and (choice is None or not searchable):
        return found
    part = SearchPart(0) if choice is None else choice(found)
    if solve is None or part is None:
        return found
    if not searchable:
        return make_empty_finding(
            copy_with(task, prior_pose=None, rivals=NONE),
            f"{UNCONFIRMED}, and a search without it needs {task.problem.order} detections, but {task.shape[1]} are "
            "given",
        )
    task = part.of(task)
    if part.rest and found.posterior is not None:
        columns = np.flatnonzero(found.posterior.used(task.shape[1]) < SURE)
        if len(columns) < task.problem.order:
            return found
        searched = restore_columns(solve(task.subset(None, columns)), task, columns)
    else:
        searched = solve(copy_with(task, prior_pose=None, rivals=NONE))
    with suppress(OutOfTime):
        named = searched.named if choice is None else searched.named[:NAMED]
        body = body.with_assignments(named or searched.every, predicted)
        missed = searched.facts.missed
        found = image_finding(copy_with(searched, task=task), body.alone(), body, missed=missed)
        return allow_point_errors(found, task, missed=missed)
    return searched


def is_motion_search_needless(model: PointSetModel, judged: Judged) -> bool:
    """Whether the best of some labellings explains more than any motion elsewhere could.

    As of `image_hypotheses.is_search_needless`: a motion elsewhere has the targets that are left, as many as there are
    points. Each is worth as much as those found, or as one that fits; a minimal set determines the motion, and is one
    of many.
    """
    assert model.prior is not None
    clouds, best = model.clouds, int(judged.log_odds.argmax())
    assignment, mass = judged.fit.assignments[best], float(judged.log_odds[best])
    # what is not where it was predicted may be something else than what is
    if judged.held[best] < 0 or not model.prior.allows(clouds, assignment, int(judged.held[best])):
        return False
    if (assignment >= 0).all():
        return True
    (free,) = np.nonzero(~used_mask(assignment[None], len(clouds.target))[0])
    maximum = min(len(free), len(assignment)) - FEWEST
    elsewhere = 0.0
    if maximum > 0:
        size, scale = clouds.target.shape[1], float(judged.fit.scale[best])
        variance = clouds.target_variance[free] + scale**2 * float(clouds.source_variance.mean())
        worth = -model.clutter.log_density[free] - 0.5 * size * (np.log(2.0 * math.pi * variance) + 1.0)
        each = max(mass, 0.0) / np.count_nonzero(assignment >= 0)
        elsewhere = max(maximum * each, maximum * float(worth.mean()) - FEWEST * math.log(len(free)))
    return mass >= math.log(model.prior.doubt) + elsewhere


def predicted_labellings(model: PointSetModel, *, narrowed: bool = False) -> list[Integers]:
    """Labellings (n,) about predicted motions, those that determine one; see `MotionPrior.labellings`."""
    every = [] if model.prior is None else model.prior.labellings(model.clouds, narrowed=narrowed)
    if model.allowed is not None:
        rows = np.arange(len(model.allowed))
        every = [np.where(model.allowed[rows, one], one, -1) for one in every]
    return [one for one in every if np.count_nonzero(one >= 0) >= FEWEST]
