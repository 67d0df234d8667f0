"""The judgement of several motions by the model of one: each is weighed with the points and detections others leave.

A packing names groups of one motion each by hyper-edges. Where the problem fits poses the model of one motion then
decides: what does not fit a motion's pose is unmatched, and a motion that is not beyond chance goes. One whose
residuals are too large for the stated noise stays, untrusted. What a motion leaves may belong to another one, which is
searched for. The motions are right together with the product of their probabilities and of that of how the points are
shared out, and the status follows from the facts of all of them, each of which has to be trusted. Matches that another
motion may have as well are left out where enough remains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, OutOfTime, checkpoint
from rootmatch.explain.assessment import assess
from rootmatch.explain.contested_matches import Claims, SharedOut, allot_claims, image_claims, space_claims
from rootmatch.explain.decide import TRUST, Facts, Status
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.image_decision import KEPT, image_finding, is_modelled
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.known_pose import QUICK
from rootmatch.explain.missing_motions import (
    Rest,
    add_missing_motions,
    join_searches,
    restrict_assignments,
    search_rest,
)
from rootmatch.explain.motion_groups import pack_motions
from rootmatch.explain.point_set_decision import judge_one_motion, make_point_set_model
from rootmatch.explain.sampling import sample
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.zoom_hypotheses import make_candidate
from rootmatch.hypergraph.enumeration import sweep_cost
from rootmatch.model.posterior import Believed, drop_doubtful_matches
from rootmatch.samplers.limits import LIMITS
from rootmatch.solvers.packing.solver import weight_inside_groups

ROUNDS = 3
"""Most rounds in which each motion is judged again where others have left points or detections. A round value."""


def judge_motions(
    found: Finding, solve: Callable[[MatchingTask], Finding] | None = None, *, proposed: bool = False
) -> Finding:
    """The finding of a packing, judged by the model of one motion; the same where the problem has no such model.

    Motions that were asked for and are missing are searched for by ``solve`` among what the others leave, if given.
    ``proposed``: whether its pairs were proposed by what tells nothing of where they lie, see `_motion_candidate`.
    """
    return _judge_and_search(found, solve, [], proposed=proposed) if is_judged(found.task) else found


def find_motions_in_turn(task: MatchingTask, solve: Callable[[MatchingTask], Finding]) -> Finding | None:
    """The finding of motions that ``solve`` finds one after the other, each among what those before leave.

    None where a packing is asked: if all hyper-edges are as quickly evaluated, if not every motion can be trusted, or
    if what is left may be others that only tell of each other.
    """
    cost = sweep_cost(*task.shape, task.problem.order, task.allowed)
    if not is_judged(task) or cost <= QUICK:
        return None
    searched: list[Rest] = []
    base = replace(
        make_empty_finding(task, None),
        tensor=join_searches(_single_motion_task(task), searched),
        scores=None,
        soft=None,
    )
    budget = max(int(cost) // LIMITS.per_searched, QUICK)
    found = _judge_and_search(base, solve, searched, budget=budget)
    if not found.status:
        return None
    if task.options.motions == "auto" and _has_more_motions(task, found):
        return None
    return found


def _has_more_motions(task: MatchingTask, found: Finding) -> bool:
    """Whether a packing of what motions leave shows another one."""
    points = np.flatnonzero(found.assignment < 0)
    detections = np.setdiff1d(np.arange(task.shape[1]), found.assignment)
    if min(len(points), len(detections)) < task.problem.order:
        return False
    part = task.subset(points, detections)
    sampled = sample(part)
    return bool((judge_motions(assess(part, pack_motions(part, sampled), sampled)).assignment >= 0).any())


def is_judged(task: MatchingTask) -> bool:
    """Whether the problem has a model of one motion."""
    alone = _single_motion_task(task)
    return is_modelled(alone) or make_point_set_model(alone) is not None


def _single_motion_task(task: MatchingTask) -> MatchingTask:
    """The task of one motion."""
    return replace(task, options=replace(task.options, motions=1, sampler=None, samples=None))


def _judge_and_search(
    found: Finding,
    solve: Callable[[MatchingTask], Finding] | None,
    searched: list[Rest],
    *,
    budget: int = QUICK,
    proposed: bool = False,
) -> Finding:
    """See `judge_motions`; each search is appended to ``searched``."""
    asked, alone = found.task.options.motions, _single_motion_task(found.task)
    assignment, labels = found.assignment.copy(), found.motion_labels.copy()
    parts: dict[int, _Part] = {}
    rest: Rest | None = None
    shared: SharedOut | None = None
    try:
        for _ in range(ROUNDS):
            if solve is not None:
                rest = add_missing_motions(alone, solve, assignment, labels, asked, searched=searched, budget=budget)
            shared = _allot_matches(alone, assignment, labels, proposed=proposed)
            before, by_search = assignment.copy(), {one.label: one for one in searched}
            for label in np.unique(labels[labels >= 0]).tolist():
                checkpoint()
                found_by = by_search.get(label)
                if solve is not None and found_by is not None and found_by.missed > TRUST.missed:
                    # what it may have missed may be another motion, which was found since
                    others = np.where(labels == label, -1, assignment)
                    if not found_by.is_left_by(others):
                        found_by = search_rest(alone, solve, others, budget=budget)
                        searched.append(found_by._replace(label=label))
                parts[label] = _judge_motion(alone, assignment, labels, label, found_by, proposed=proposed)
            if np.array_equal(before, assignment):
                break
    except OutOfTime:
        return found.with_facts(confirmed=False)
    evaluated = sum(one.told.evaluated for one in searched if one.told is not None)
    found = replace(found, evaluated=found.evaluated + evaluated)
    whole = _join_motions(found, assignment, labels, parts, rest)
    if shared is None or whole.confidence is None or not shared.together < 1.0:
        return whole
    confidence = shared.certainty * whole.confidence
    told = whole.lower_probability((whole.probability or 0.0) * shared.together, confidence)
    sure = None if told.status or not whole.status else _drop_contested(whole, shared.certainty, alone.minimal)
    if sure is None:
        return told
    kept = sure.assignment >= 0
    confidence = np.where((assignment >= 0) & ~kept, shared.unclaimed, confidence)
    whole = _join_motions(found, sure.assignment, np.where(kept, labels, -1), parts, rest)
    return whole.lower_probability(sure.probability, confidence)


def _drop_contested(found: Finding, certainty: Floats, minimal: int) -> Believed | None:
    """What is believed of motions without matches that others may have, (n,); None if that leaves too little of one."""
    own, minimum = found.motion_labels, found.facts.min_probability
    sure = drop_doubtful_matches(found.assignment, certainty, 1.0, minimum, pose=found.probability or 0.0)
    before = np.bincount(own[own >= 0])
    left = np.bincount(own[sure.assignment >= 0], minlength=len(before))
    return sure if (left >= np.maximum(KEPT * before, minimal + 1)).all() else None


def _allot_matches(alone: MatchingTask, assignment: Integers, labels: Integers, *, proposed: bool) -> SharedOut | None:
    """Change an assignment and its labels to what each motion has most claim to, if there are several."""
    claims, model = dict[int, Claims](), None if is_modelled(alone) else make_point_set_model(alone)
    for label in np.unique(labels[labels >= 0]).tolist():
        own = np.where(labels == label, assignment, -1)
        if model is None:
            claims[label] = image_claims(_motion_candidate(alone, own[None], proposed), own)
        else:
            claims[label] = space_claims(model, own)
    if len(claims) < 2:
        return None
    shared = allot_claims(claims, *alone.shape)
    assignment[:], labels[:] = shared.assignment, shared.labels
    return shared


def _judge_motion(
    alone: MatchingTask, assignment: Integers, labels: Integers, label: int, found_by: Rest | None, *, proposed: bool
) -> _Part:
    """One motion among what the others leave, to which the assignment and its labels are changed.

    What a search named beside what it found is weighed too, and what it missed counts.
    """
    part, points, pixels, own = remaining_task(alone, assignment, labels, label)
    if is_modelled(part):
        named, missed = [own[None]], 0.0
        if found_by is not None:
            missed = found_by.missed
            named += [restrict_assignments(one[None], points, pixels) for one in found_by.named(len(assignment))]
        body = _motion_candidate(part, np.concatenate(named), proposed)
        told = image_finding(make_empty_finding(part, None), body.alone(), body, missed=missed)
    else:
        told = judge_one_motion(part, own)
    beyond_chance = told.status is not Status.UNTRUSTED or told.presence_probability >= told.facts.min_probability
    matched = (told.assignment >= 0) & beyond_chance
    assignment[points] = np.where(matched, pixels[told.assignment], -1)
    labels[points] = np.where(matched, label, -1)
    return _Part(told, points, pixels)


class _Part(NamedTuple):
    """One motion: its finding among what the others leave, and which points and detections that are."""

    told: Finding
    points: Integers
    detections: Integers

    def confidence(self, count: int) -> Floats:
        """Confidence (count,) in all points, NaN where another motion has them."""
        out = np.full(count, math.nan)
        out[self.points] = math.nan if self.told.confidence is None else self.told.confidence
        return out

    def others(self, assignment: Integers) -> list[tuple[float, Integers]]:
        """Assignments (n,) of all points with another one of this motion, and how probable each is beside its own."""
        chances, every = self.told.alternative_probabilities, []
        own = max(self.told.probability or 0.0, 1e-300)
        for k, one in enumerate(self.told.others):
            whole = assignment.copy()
            whole[self.points] = np.where(one >= 0, self.detections[one], -1)
            every.append((0.0 if chances is None else chances[k] / own, whole))
        return every


def _motion_candidate(part: MatchingTask, named: Integers, proposed: bool) -> Candidate:
    """The body of one motion by its assignment, and others (K, n) in its stead.

    A false pair that was ``proposed`` is of a detection that may be any, and chance proposes one of m among n' with m /
    n'. That such a pair agrees with a pose is evidence, the more the fewer are proposed for its point. The model itself
    takes candidates for what restricts a choice alone: they may have been chosen by where they lie.
    """
    if not proposed or part.allowed is None:
        return make_candidate(part, list(named))
    body = make_candidate(part, [])
    by_chance = np.maximum(part.allowed.sum(axis=1), 1) / part.shape[1]
    known = 0.0 if body.model.log_weights is None else body.model.log_weights
    weights = known - np.log(by_chance)[:, None] + np.zeros(part.shape)
    return replace(body, model=replace(body.model, log_weights=weights)).with_assignments(list(named))


def motion_confidence(task: MatchingTask, assignment: Integers, labels: Integers) -> Floats:
    """Confidence (n,) in each match of several motions, each with the points and detections that the others leave.

    For an unmatched point it is that of the least certain motion.
    """
    confidence = np.full(len(assignment), math.nan)
    alone = replace(task, options=replace(task.options, motions=1), deadline=NEVER)
    for label in range(int(labels.max(initial=-1)) + 1):
        part, points, _, own = remaining_task(alone, assignment, labels, label)
        each = np.full(len(own), math.nan)
        if is_modelled(part):
            told = make_candidate(part, [own]).alone()
            each = told.confidence_in(own) if len(told.probabilities) else each
        confidence[points] = np.where(own >= 0, each, np.fmin(confidence[points], each))
    return confidence


def remaining_task(
    alone: MatchingTask, assignment: Integers, labels: Integers, label: int
) -> tuple[MatchingTask, Integers, Integers, Integers]:
    """What the other motions leave to one: the task of it, its points and detections, and its assignment in them."""
    points = np.flatnonzero((labels == label) | (assignment < 0))
    others = assignment[(labels != label) & (assignment >= 0)]
    pixels = np.setdiff1d(np.arange(alone.shape[1]), others)
    place = np.searchsorted(pixels, np.maximum(assignment[points], 0))
    return alone.subset(points, pixels), points, pixels, np.where(assignment[points] >= 0, place, -1)


def _join_motions(
    found: Finding, assignment: Integers, labels: Integers, parts: dict[int, _Part], rest: Rest | None
) -> Finding:
    """The finding of all motions that are left, the largest first.

    The confidence in an unmatched point is that of the motion that is least certain of it, found or not.
    """
    sizes = np.bincount(labels[labels >= 0])
    left = [label for label in np.argsort(-sizes, kind="stable").tolist() if sizes[label]]
    numbers, confidence = np.full(len(labels), -1), np.full(len(labels), math.nan)
    for number, label in enumerate(left):
        confidence = np.fmin(confidence, parts[label].confidence(len(labels)))
        numbers[labels == label] = number
    facts, incomplete = [parts[label].told.facts for label in left], False
    if rest is not None:
        confidence = rest.lower_confidence(assignment, confidence)
        incomplete = rest.may_show(found.facts.min_probability)
    nothing, others, scores = Facts(present=0.0, probability=0.0, lead=0.0), found.others, None
    if found.scores is not None:
        scores = [weight_inside_groups(found.tensor, assignment, numbers), *found.all_scores[1:]]
    else:
        ranked = sorted((pair for label in left for pair in parts[label].others(assignment)), key=lambda pair: -pair[0])
        others = [one for _, one in ranked[: TRUST.alternatives]]
    return replace(
        found,
        assignment=assignment,
        others=others,
        labels=numbers,
        facts=replace(_joint_facts(facts), lead=found.facts.lead, incomplete=incomplete) if facts else nothing,
        scores=scores,
        confidence=confidence,
        log_odds=sum(parts[label].told.log_odds or 0.0 for label in left),
    )


def _joint_facts(facts: list[Facts]) -> Facts:
    """The facts of several motions together."""
    probability = math.prod(one.probability or 0.0 for one in facts)
    return Facts(
        present=min(one.present or 0.0 for one in facts),
        probability=probability,
        contested=any(one.contested for one in facts),
        sure_of_the_rest=all(one.sure_of_the_rest for one in facts) and probability >= facts[0].min_probability,
        min_probability=facts[0].min_probability,
        missed=max(one.missed for one in facts),
        false_alarms=max(one.false_alarms for one in facts),
    )
