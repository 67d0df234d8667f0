"""The judgement of several motions by the model of one: each is weighed with the points and detections others leave.

A packing names groups of one motion each by hyper-edges. Where the problem fits poses the model of one motion then
decides: what does not fit a motion's pose is unmatched, and a motion that is not beyond chance goes. One whose
residuals are too large for the stated noise stays, untrusted. What a motion leaves may belong to another one, which is
searched for. The motions are right together with the product of their probabilities, and the status follows from the
facts of all of them, each of which has to be trusted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, OutOfTime, checkpoint
from rootmatch.explain.decide import Facts, Status
from rootmatch.explain.finding import Finding, nothing_found
from rootmatch.explain.image_decision import is_modelled, told_by
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.missing_motions import Rest, with_missing
from rootmatch.explain.point_set_decision import model_of, of_one_motion
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.zoom_hypotheses import candidate_of
from rootmatch.solvers.packing.solver import inside_groups

ROUNDS = 3
"""Most rounds in which each motion is judged again where others have left points or detections. A round value."""


def judged_motions(
    found: Finding, solve: Callable[[MatchingTask], Finding] | None = None, *, proposed: bool = False
) -> Finding:
    """The finding of a packing, judged by the model of one motion; the same where the problem has no such model.

    Motions that were asked for and are missing are searched for by ``solve`` among what the others leave, if given.
    ``proposed``: whether its pairs were proposed by what tells nothing of where they lie, see `_body_of`.
    """
    asked = found.task.options.motions
    alone = replace(found.task, options=replace(found.task.options, motions=1, sampler=None, samples=None))
    if not is_modelled(alone) and model_of(alone) is None:
        return found
    assignment, labels = found.assignment.copy(), found.motion_labels.copy()
    parts: dict[int, Finding] = {}
    rest: Rest | None = None
    try:
        for _ in range(ROUNDS):
            rest = None if solve is None else with_missing(alone, solve, assignment, labels, asked)
            before = assignment.copy()
            for label in np.unique(labels[labels >= 0]).tolist():
                checkpoint()
                parts[label] = _judged(alone, assignment, labels, label, proposed=proposed)
            if np.array_equal(before, assignment):
                break
    except OutOfTime:
        return found.with_facts(confirmed=False)
    return _together(found, assignment, labels, parts, rest)


def _judged(alone: MatchingTask, assignment: Integers, labels: Integers, label: int, *, proposed: bool) -> Finding:
    """The finding of one motion among what the others leave, to which the assignment and its labels are changed.

    Its confidence is that of all points (n,), NaN where another motion has them.
    """
    part, points, pixels, own = _left_to(alone, assignment, labels, label)
    if is_modelled(part):
        body = _body_of(part, own, proposed)
        told = told_by(nothing_found(part, None), body.alone(), body)
    else:
        told = of_one_motion(part, own)
    beyond_chance = told.status is not Status.UNTRUSTED or told.in_view >= told.facts.min_probability
    matched = (told.assignment >= 0) & beyond_chance
    assignment[points] = np.where(matched, pixels[told.assignment], -1)
    labels[points] = np.where(matched, label, -1)
    confidence = np.full(len(assignment), math.nan)
    confidence[points] = math.nan if told.confidence is None else told.confidence
    return replace(told, confidence=confidence)


def _body_of(part: MatchingTask, own: Integers, proposed: bool) -> Candidate:
    """The body of one motion by its assignment.

    A false pair that was ``proposed`` is of a detection that may be any, and chance proposes one of m among n' with m /
    n'. That such a pair agrees with a pose is evidence, the more the fewer are proposed for its point. The model itself
    takes candidates for what restricts a choice alone: they may have been chosen by where they lie.
    """
    if not proposed or part.allowed is None:
        return candidate_of(part, [own])
    body = candidate_of(part, [])
    by_chance = np.maximum(part.allowed.sum(axis=1), 1) / part.shape[1]
    known = 0.0 if body.model.log_weights is None else body.model.log_weights
    weights = known - np.log(by_chance)[:, None] + np.zeros(part.shape)
    return replace(body, model=replace(body.model, log_weights=weights)).proposed([own])


def confidence_of_motions(task: MatchingTask, assignment: Integers, labels: Integers) -> Floats:
    """Confidence (n,) in each match of several motions, each with the points and detections that the others leave.

    For an unmatched point it is that of the least certain motion.
    """
    confidence = np.full(len(assignment), math.nan)
    alone = replace(task, options=replace(task.options, motions=1), deadline=NEVER)
    for label in range(int(labels.max(initial=-1)) + 1):
        part, points, _, own = _left_to(alone, assignment, labels, label)
        each = np.full(len(own), math.nan)
        if is_modelled(part):
            told = candidate_of(part, [own]).alone()
            each = told.confidence_in(own) if len(told.probabilities) else each
        confidence[points] = np.where(own >= 0, each, np.fmin(confidence[points], each))
    return confidence


def _left_to(
    alone: MatchingTask, assignment: Integers, labels: Integers, label: int
) -> tuple[MatchingTask, Integers, Integers, Integers]:
    """What the other motions leave to one: the task of it, its points and detections, and its assignment in them."""
    points = np.flatnonzero((labels == label) | (assignment < 0))
    others = assignment[(labels != label) & (assignment >= 0)]
    pixels = np.setdiff1d(np.arange(alone.shape[1]), others)
    place = np.searchsorted(pixels, np.maximum(assignment[points], 0))
    return alone.subset(points, pixels), points, pixels, np.where(assignment[points] >= 0, place, -1)


def _together(
    found: Finding, assignment: Integers, labels: Integers, parts: dict[int, Finding], rest: Rest | None
) -> Finding:
    """The finding of all motions that are left, the largest first.

    The confidence in an unmatched point is that of the motion that is least certain of it, found or not.
    """
    sizes = np.bincount(labels[labels >= 0])
    left = [label for label in np.argsort(-sizes, kind="stable").tolist() if sizes[label]]
    numbers, confidence = np.full(len(labels), -1), np.full(len(labels), math.nan)
    for number, label in enumerate(left):
        confidence = np.fmin(confidence, np.asarray(parts[label].confidence))
        numbers[labels == label] = number
    facts, incomplete = [parts[label].facts for label in left], False
    if rest is not None:
        confidence = rest.least_certain(assignment, confidence)
        incomplete = rest.may_show(found.facts.min_probability)
    nothing = Facts(present=0.0, probability=0.0, lead=0.0)
    return replace(
        found,
        assignment=assignment,
        labels=numbers,
        facts=replace(_of_all(facts), lead=found.facts.lead, incomplete=incomplete) if facts else nothing,
        scores=[inside_groups(found.tensor, assignment, numbers), *found.every_score[1:]],
        confidence=confidence,
        log_odds=sum(parts[label].log_odds or 0.0 for label in left),
    )


def _of_all(facts: list[Facts]) -> Facts:
    """The facts of several motions together."""
    return Facts(
        present=min(one.present or 0.0 for one in facts),
        probability=math.prod(one.probability or 0.0 for one in facts),
        contested=any(one.contested for one in facts),
        sure_of_the_rest=all(one.sure_of_the_rest for one in facts),
        min_probability=facts[0].min_probability,
        missed=max(one.missed for one in facts),
        false_alarms=max(one.false_alarms for one in facts),
    )
