"""Several motions in two views: one is found after the other among what is left, and all are weighed together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.deadline import OutOfTime
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.judged_motions import ROUNDS, remaining_task
from rootmatch.explain.missing_motions import Rest, add_missing_motions, join_searches, restrict_assignments
from rootmatch.explain.motion_groups import relabel_by_size
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.two_view_decision import (
    Rivals,
    make_two_view_model,
    reported_assignment,
    rival_labellings,
    two_view_finding,
)
from rootmatch.model.priors import IN_VIEW
from rootmatch.model.two_view_motions import Motion, motions_posterior
from rootmatch.model.two_view_places import reweigh_by_crowding
from rootmatch.model.two_view_posterior import TwoViewPosterior, sample_two_view_posterior


def match_motions(task: MatchingTask, solve: Callable[[MatchingTask], Finding]) -> Finding:
    """The finding of several motions in two views, of a task that asks for them; ``solve`` is the route of one."""
    alone = replace(task, options=replace(task.options, motions=1))
    if task.options.motions != "auto":
        alone = replace(alone, present=IN_VIEW)
    searched: list[Rest] = []
    assignment, labels = np.full((2, task.shape[0]), -1, np.int64)
    rest = add_missing_motions(alone, solve, assignment, labels, asked=task.options.motions, searched=searched)
    every = [one.told for one in searched if one.told is not None]
    base = replace(
        make_empty_finding(task, None),
        tensor=join_searches(alone, searched),
        converged=all(one.converged for one in every),
        evaluated=sum(one.evaluated for one in every),
        scores=None,
        soft=None,
    )
    minimum = task.options.required_probability
    try:
        while (weighed := _weigh_motions(alone, searched, assignment, labels)) is not None:
            told, rivals, left = weighed
            weakest = int(np.argmin(told.presences))
            if told.presences[weakest] >= minimum or len(left) == 1:
                break
            labels[labels == left[weakest]] = -1
    except OutOfTime:
        return base
    if weighed is None:
        return replace(every[0], task=task) if every else base
    found = two_view_finding(base, told, max(every[label].facts.missed for label in left), rivals)
    numbers, confidence = relabel_by_size(told.label_motions(found.assignment)), told.unmatched
    confidence = confidence if found.confidence is None else found.confidence
    incomplete = task.options.motions != "auto" and len(left) < task.options.motions
    if rest is not None:
        confidence = rest.lower_confidence(found.assignment, confidence)
        incomplete = rest.may_show(minimum)
    return replace(found.with_facts(incomplete=incomplete), labels=numbers, confidence=confidence)


def _weigh_motions(
    alone: MatchingTask, searched: list[Rest], assignment: Integers, labels: Integers
) -> tuple[TwoViewPosterior, Rivals, list[int]] | None:
    """The posterior of motions that searches found, what may be right in the place of each, and their labels.

    What is of which motion, (n,), is changed to what that says, and each weighed again among what others leave then.
    """
    model = make_two_view_model(alone)
    assert model is not None
    for _ in range(ROUNDS):
        left, motions, others = [], [], []
        assignment[labels < 0] = -1
        for label in np.unique(labels[labels >= 0]).tolist():
            left_over, points, detections, _ = remaining_task(alone, assignment, labels, label)
            part, rest = make_two_view_model(left_over), searched[label]
            assert part is not None
            assert rest.told is not None
            every = [np.where(labels == label, assignment, -1)]
            every += rest.named(len(labels))
            named = restrict_assignments(np.array(every), points, detections)
            told = sample_two_view_posterior(part, named, alone.options.seed)
            if told.parts:
                left.append(label)
                motions.append(Motion(told, points, detections))
                others.append(
                    rival_labellings(part, told, named[len(every) - len(rest.told.named) :], alone.options.seed)
                )
        if len(motions) < 2:
            return (reweigh_by_crowding(motions[0].told), others[0], left) if motions else None
        whole = motions_posterior(model, motions, alone.options.seed)
        first = reported_assignment(whole)
        numbers = whole.label_motions(first)
        now = np.where(numbers >= 0, np.array(left)[numbers], -1)
        if np.array_equal(first, assignment) and np.array_equal(now, labels):
            break
        assignment[:], labels[:] = first, now
    return whole, _joint_rivals(first, numbers, motions, others), left


def _joint_rivals(first: Integers, numbers: Integers, motions: list[Motion], others: list[Rivals]) -> Rivals:
    """What may be right in the place of an assignment (n,): rivals of each motion, beside the others of them."""
    every = [np.zeros((0, len(first)), np.int64)]
    for m, (motion, (elsewhere, _)) in enumerate(zip(motions, others, strict=True)):
        for one in elsewhere:
            own, rival = motion.detections[one[one >= 0]], np.where(numbers == m, -1, first)
            rival[np.isin(rival, own)] = -1
            rival[motion.points[one >= 0]] = own
            every.append(rival[None])
    return np.concatenate(every), np.concatenate([odds for _, odds in others])
