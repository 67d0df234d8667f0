"""Matching with a predicted pose: directly if the prediction decides, otherwise also without it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

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
    predicted, found = None, make_empty_finding(task, why_unsearched(task))
    with prediction_deadline(task.deadline).within():
        predicted = propose_predicted(body.model)
        body = body.with_assignments([], predicted)
        told = body.alone()
        if choice is not None or not searchable or is_search_needless(body.model, told, task.minimal):
            found = allow_point_errors(image_finding(found, told, body), task)
            found = copy_with(found, reason=None) if found.prior_holds else found
            if found.prior_holds and (choice is None or not searchable):
                return found
    part = SearchPart(0) if choice is None else choice(found)
    if solve is None or part is None:
        return found
    if not searchable:
        return make_empty_finding(
            copy_with(task, prior_pose=None, rivals=NONE),
            f"{UNCONFIRMED}, and {task.shape[1]} detections are given where a search without it "
            f"needs {task.problem.order}",
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
