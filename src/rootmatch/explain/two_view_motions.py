"""Several motions in two views: one is found after the other among what is left, and all are weighed together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.deadline import OutOfTime
from rootmatch.explain.decide import MIN_PROBABILITY
from rootmatch.explain.finding import Finding, nothing_found
from rootmatch.explain.image_decision import lead_by_odds
from rootmatch.explain.missing_motions import Rest, with_missing
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.two_view_decision import Rivals, model_of, reported, rivals_of, told_by
from rootmatch.model.two_view_motions import Motion, MotionsPosterior, motions_posterior
from rootmatch.model.two_view_posterior import posterior


def match_motions(task: MatchingTask, solve: Callable[[MatchingTask], Finding]) -> Finding:
    """The finding of several motions in two views.

    Parameters
    ----------
    task : MatchingTask
        Which asks for them.
    solve : callable
        The route of a task of one motion.
    """
    alone = replace(task, options=replace(task.options, motions=1))
    searched: list[Rest] = []
    assignment, labels = np.full((2, task.shape[0]), -1, np.int64)
    rest = with_missing(alone, solve, assignment, labels, task.options.motions, searched)
    every = [one.told for one in searched if one.told is not None]
    if labels.max(initial=-1) < 0:
        return replace(every[0], task=task) if every else nothing_found(task, None)
    base = replace(
        nothing_found(task, None),
        converged=all(one.converged for one in every),
        evaluated=sum(one.evaluated for one in every),
        scores=None,
        scoreless=True,
        soft=None,
    )
    least = task.options.least_probability(MIN_PROBABILITY)
    try:
        while True:
            told, rivals, left = _weighed(alone, searched, assignment, labels)
            found = told_by(base, told, max(one.facts.missed for one in every), rivals)
            weakest = int(np.argmin(told.present_each))
            if found.facts.present is None or told.present_each[weakest] >= least or len(left) == 1:
                break
            assignment[labels == left[weakest]] = -1
            labels[labels == left[weakest]] = -1
    except OutOfTime:
        return base
    numbers = _by_size(told.motions_of(found.assignment))
    assert found.confidence is not None
    confidence, incomplete = found.confidence, False
    if rest is not None:
        confidence, incomplete = rest.least_certain(found.assignment, confidence), rest.may_show(least)
    incomplete |= task.options.motions != "auto" and len(left) < task.options.motions
    found = found.with_facts(incomplete=incomplete, lead=lead_by_odds(found.facts.probability))
    return replace(found, labels=numbers, confidence=confidence)


def _weighed(
    alone: MatchingTask, searched: list[Rest], assignment: Integers, labels: Integers
) -> tuple[MotionsPosterior, Rivals, list[int]]:
    """The posterior of the motions of an assignment (n,), their labels, and what may be right in place of each."""
    model = model_of(alone)
    assert model is not None
    left = np.unique(labels[labels >= 0]).tolist()
    motions, others = [], []
    for label in left:
        points = np.flatnonzero((labels == label) | (assignment < 0))
        detections = np.setdiff1d(np.arange(model.shape[1]), assignment[(labels != label) & (assignment >= 0)])
        part = model_of(alone.subset(points, detections))
        assert part is not None

        def among(one: Integers, points: Integers = points, detections: Integers = detections) -> Integers:
            place = np.searchsorted(detections, one[points]).clip(max=len(detections) - 1)
            return np.where(detections[place] == one[points], place, -1)

        rest = searched[label]
        assert rest.told is not None
        own = np.where(labels == label, assignment, -1)
        named = [among(rest.of_all(one, len(assignment))) for one in rest.told.named]
        every = [among(own), *(among(rest.of_all(one, len(assignment))) for one in rest.told.others), *named]
        told = posterior(part, np.array(every), alone.options.seed)
        if not told.parts:
            continue
        motions.append(Motion(told, points, detections))
        others.append(rivals_of(part, told, np.array(named).reshape(-1, len(points)), alone.options.seed))
    whole = motions_posterior(model, motions, alone.options.seed)
    first = reported(whole)
    numbers = whole.motions_of(first)
    rivals = []
    for m, (motion, (elsewhere, _)) in enumerate(zip(motions, others, strict=True)):
        for one in elsewhere:
            other = np.where(numbers == m, -1, first)
            own = motion.detections[one[one >= 0]]
            other[np.isin(other, own)] = -1
            other[motion.points[one >= 0]] = own
            rivals.append(other)
    odds = np.concatenate([chances for _, chances in others])
    return whole, (np.array(rivals, np.int64).reshape(-1, len(first)), odds), left


def _by_size(labels: Integers) -> Integers:
    """Labels (n,) that count from the largest motion on."""
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    rank = np.argsort(np.argsort(-sizes, kind="stable"), kind="stable")
    return np.where(labels >= 0, rank[labels], -1)
