"""Matching with a predicted pose: directly if the prediction decides, otherwise also without it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from rootmatch.deadline import OutOfTime
from rootmatch.explain.bodies import SURE
from rootmatch.explain.body_findings import among_all
from rootmatch.explain.finding import Finding, nothing_found
from rootmatch.explain.image_bodies import Choice, SearchPart
from rootmatch.explain.image_decision import told_by
from rootmatch.explain.image_hypotheses import NAMED, Candidate, is_enough, proposals_by_prediction
from rootmatch.explain.in_time import to_predict
from rootmatch.explain.inexact_points import allowing_for_errors
from rootmatch.explain.rivals import NONE
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copied

UNCONFIRMED = "the predicted pose is not confirmed"
UNSEARCHED = "no pose is predicted, and nothing was searched for in this frame"


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
    predicted, found = None, nothing_found(task, UNSEARCHED if task.prior_pose is None else UNCONFIRMED)
    with to_predict(task.deadline).within():
        predicted = proposals_by_prediction(body.model)
        body = body.proposed([], predicted)
        told = body.alone()
        if choice is not None or not searchable or is_enough(body.model, told, task.minimal):
            found = allowing_for_errors(told_by(found, told, body), task)
            found = copied(found, reason=None) if found.prior_holds else found
            if found.prior_holds and (choice is None or not searchable):
                return found
    part = SearchPart(0) if choice is None else choice(found)
    if solve is None or part is None:
        return found
    if not searchable:
        return nothing_found(
            copied(task, prior_pose=None, rivals=NONE),
            f"{UNCONFIRMED}, and {task.shape[1]} detections are given where a search without it "
            f"needs {task.problem.order}",
        )
    task = part.of(task)
    if part.rest and found.posterior is not None:
        columns = np.flatnonzero(found.posterior.used(task.shape[1]) < SURE)
        if len(columns) < task.problem.order:
            return found
        searched = among_all(solve(task.subset(np.arange(task.shape[0]), columns)), task, columns)
    else:
        searched = solve(copied(task, prior_pose=None, rivals=NONE))
    with suppress(OutOfTime):
        named = searched.named if choice is None else searched.named[:NAMED]
        body = body.proposed(named or searched.every, predicted)
        missed = searched.facts.missed
        found = told_by(copied(searched, task=task), body.alone(), body, missed=missed)
        return allowing_for_errors(found, task, missed=missed)
    return searched
