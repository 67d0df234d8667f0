"""Assessment of a solution: unmatch unsupported points, find probability and margin, and state the facts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import OutOfTime
from rootmatch.explain.agreement import agreement, supported
from rootmatch.explain.assignment_posterior import Misfit, Ranked, misfit, ranked
from rootmatch.explain.decide import TRUST, Facts, Status
from rootmatch.explain.detection_odds import DEFAULT_OPTIONS
from rootmatch.explain.false_alarms import TRUE_WEIGHT, log10_false_alarms
from rootmatch.explain.finding import Finding
from rootmatch.explain.motion_labels import motion_labels
from rootmatch.explain.multi_motion import log10_false_alarms_of_groups
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.assignment import margin, one_hot
from rootmatch.hypergraph.support import scores_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Solution


def assess(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Finding:
    """The most probable assignment near a solution, without unsupported points, and whether to trust it.

    If there is no time for that, it is untrusted.
    """
    try:
        return _assessed(task, solution, sampled)
    except OutOfTime:
        return Finding(
            task=task,
            assignment=solution.assignment,
            others=[other for other, _ in solution.alternatives],
            facts=Facts(confirmed=False, lead=solution.margin),
            tensor=sampled.tensor,
            scores=[solution.score, *(value for _, value in solution.alternatives)],
            soft=solution.soft,
            converged=solution.converged,
            evaluated=sampled.evaluated,
        )


def _assessed(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Finding:
    """See `assess`."""
    if task.options.packs_motions:
        return _of_motions(task, solution, sampled)
    assignment, score, alternatives = solution.assignment, solution.score, solution.alternatives
    if not task.options.is_paper:
        assignment, score, alternatives = supported(assignment, alternatives, sampled.tensor, task.deadline)
    scores = agreement(sampled.tensor, [assignment, *(other for other, _ in alternatives)])
    lead = margin(score, alternatives, assignment)
    probability, trusted, support = None, False, scores[0]
    found: Ranked | None = None
    fault: Misfit | None = None
    proposed = [] if sampled.assignments is None else list(sampled.assignments)
    if task.problem.point_clouds(task.points) is not None:
        fault = misfit_of_motion(task, assignment)
    elif not proposed and clear(assignment, lead, sampled.tensor):
        # hyper-edges may agree pair by pair without a pose that suits all of them
        if fits(task, assignment):
            fault = misfit(task, assignment)
    elif fits(task, assignment) or (proposed and fits(task, proposed[0])):
        searched = [assignment, *(other for other, _ in alternatives), *proposed]
        found = ranked(task, searched, consensus=sampled.consensus)
        fault = found.misfit
        if found.assignments:
            kept = np.array(found.assignments[: TRUST.alternatives + 1])
            values = scores_of(sampled.tensor, kept)
            assignment, score = kept[0], float(values[0])
            alternatives = list(zip(kept[1:], values[1:].tolist(), strict=True))
            lead, probability = margin(score, alternatives, assignment), found.probability
            trusted = sure_beyond_chance(found)
            # a search need not have evaluated the hyper-edges of its best assignment: one as probable may speak for it
            likely = found.probabilities[: len(values)] >= 1.0 - TRUST.probability
            support = max(agreement(sampled.tensor, [assignment, *kept[: len(values)][likely]]))
            # a fit of few noisy points proves nothing by itself: hyper-edges have to agree as well
            trusted = trusted and support > 0.0
    alarms = -math.inf if trusted else false_alarms(task, support, scores, sampled)
    if fault is not None and does_not_fit(fault):
        alarms = math.inf
    assessed = Finding(
        task=task,
        assignment=assignment,
        others=[other for other, _ in alternatives],
        facts=Facts(
            support=math.inf if trusted else support,
            false_alarms=alarms,
            lead=lead,
            probability=probability,
            missed=sampled.missed,
            min_probability=task.options.least_probability(TRUST.probability),
        ),
        tensor=sampled.tensor,
        scores=[score, *(value for _, value in alternatives)],
        soft=solution.soft,
        labels=motion_labels(solution, assignment, sampled.tensor, task.options.motions),
        converged=solution.converged,
        evaluated=sampled.evaluated,
        noise_factor=None if fault is None else fault.sigma,
    )
    if found is None:
        return assessed
    return point_by_point(task, assessed, found, sampled)


def sure_beyond_chance(found: Ranked) -> bool:
    """Whether the first of some weighed assignments is beyond clutter, and its pose or a short list is certain."""
    sure = max(found.probability_of(1 + TRUST.listed), 0.0 if found.marginals is None else found.marginals.pose)
    return found.beyond_chance > TRUST.beyond_clutter and sure > TRUST.listed_probability


def misfit_of_motion(task: MatchingTask, assignment: NDArray[np.int64]) -> Misfit | None:
    """Misfit of the motion of one point set onto another; None if too few points determine one.

    Three points of a set in space have no handedness, so all hyper-edges of a mirrored set agree without a motion.
    """
    problem = task.problem
    if task.affinity.residual.kind not in NOISE_KINDS or (assignment >= 0).sum() <= problem.least_for_pose:
        return None
    (pose,) = problem.poses(task.points, assignment[None])
    if pose is None or pose.chi2 is None or not pose.dof:
        return None
    return Misfit.of(pose.chi2, pose.dof)


def does_not_fit(fault: Misfit) -> bool:
    """Whether no pose fits an assignment within the noise that was given."""
    if not fault.variances <= DEFAULT_OPTIONS.most_inflation:
        return True
    return fault.sigma >= TRUST.noise_factor and fault.chance < TRUST.noise_chance


def point_by_point(task: MatchingTask, assessed: Finding, found: Ranked, sampled: SampledTensor) -> Finding:
    """The finding with the confidence of each match.

    If the pose is certain but some matches are not, these are left out and the rest is called matched.
    """
    each = found.marginals
    if each is None:
        return assessed
    if assessed.status is Status.UNTRUSTED:
        return replace(assessed, confidence=confidence_against_chance(found, assessed.assignment))
    if assessed.status is not Status.AMBIGUOUS or sampled.missed > TRUST.missed:
        return replace(assessed, confidence=each.each)
    matched = int((assessed.assignment >= 0).sum())
    doubt = max(1.0 - TRUST.probability, TRUST.wrong * matched)
    sure = each.without_unsure(assessed.assignment, max(task.problem.order + 1, TRUST.kept * matched), doubt)
    if sure is None:
        return replace(assessed, confidence=each.each)
    left_out = (sure < 0) & (assessed.assignment >= 0)
    probability = each.pose * float(np.prod(each.each[sure >= 0] / each.pose))
    labels = assessed.labels
    return replace(
        assessed,
        assignment=sure,
        others=assessed.every[: TRUST.alternatives],
        facts=replace(assessed.facts, probability=probability, sure_of_the_rest=True),
        scores=None,
        labels=None if labels is None else np.where(sure >= 0, labels, -1),
        confidence=np.where(left_out, each.unmatched, each.each),
    )


def confidence_against_chance(found: Ranked, assignment: NDArray[np.int64]) -> NDArray[np.float64]:
    """Confidence (n,) in each match if all of them may be chance, in which case unmatched is right."""
    odds = found.beyond_chance if math.isfinite(found.beyond_chance) else 0.0
    real = 1.0 / (1.0 + math.exp(min(-odds - TRUST.present, 700.0)))
    return np.asarray(np.where(assignment >= 0, 0.0, 1.0 - real) + real * confidence_in(found, assignment))


def fits(task: MatchingTask, assignment: NDArray[np.int64]) -> bool:
    """Whether an assignment has a probability: the problem must fit poses, with residuals in units of σ."""
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    # a prior for views from one position is no part of the fits
    able = task.problem.fits_answers and in_noise and task.problem.small_baseline == 0.0
    alone = not task.options.is_paper and not task.options.packs_motions
    return able and alone and int((assignment >= 0).sum()) > task.problem.minimal


def weighed(task: MatchingTask, assignments: list[NDArray[np.int64]]) -> Ranked | None:
    """Assignments and their neighbours by probability, for a status that did not need the fit of the first one.

    None where there is no probability.
    """
    if not fits(task, assignments[0]):
        return None
    found = ranked(task, assignments)
    return found if found.assignments else None


def confidence_in(found: Ranked | None, assignment: NDArray[np.int64]) -> NDArray[np.float64]:
    """Confidence (n,) in each match of a weighed assignment; NaN if there is no probability."""
    if found is None or found.marginals is None:
        return np.full(len(assignment), math.nan)
    if np.array_equal(found.assignments[0], assignment):
        return found.marginals.each
    return np.asarray(found.probabilities @ (np.array(found.assignments) == assignment))


def clear(assignment: NDArray[np.int64], lead: float, tensor: AffinityTensor) -> bool:
    """Whether every match is well supported, and neither another match nor another assignment is."""
    if lead < TRUST.clear_margin:
        return False
    support = tensor.contract(one_hot(assignment, tensor.shape[1]))
    matched = np.flatnonzero(assignment >= 0)
    own = support[matched, assignment[matched]]
    support[matched, assignment[matched]] = 0.0
    median = float(np.median(own))
    return bool(own.min() >= TRUST.clear_support * median and support.max() <= TRUST.clear_rival * median)


def _of_motions(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Finding:
    """The finding of groups of one motion each; its score is the evidence of the packing."""
    lead = solution.statistics.get("lead", 0.0)
    alarms = log10_false_alarms_of_groups(solution, task.shape)
    return Finding(
        task=task,
        assignment=solution.assignment,
        others=[other for other, _ in solution.alternatives],
        facts=Facts(support=solution.score, false_alarms=alarms, lead=lead),
        tensor=sampled.tensor,
        scores=[solution.score, *(value for _, value in solution.alternatives)],
        soft=solution.soft,
        labels=motion_labels(solution, solution.assignment, sampled.tensor, task.options.motions),
        converged=solution.converged,
        evaluated=sampled.evaluated,
    )


def false_alarms(task: MatchingTask, score: float, known: list[float], sampled: SampledTensor) -> float:
    """Decimal logarithm of the expected number of false alarms with such a score.

    ``known`` are the scores of the assignments that were found. The mean weight of a random hyper-edge is that of those
    outside of the assignment where it is not known.
    """
    tensor, evaluated, share, chance = sampled.tensor, sampled.evaluated, sampled.share, sampled.chance
    if evaluated == 0 and chance is None:
        return math.inf  # no hyper-edge was possible: nothing speaks for anything
    problem, in_noise = task.problem, task.affinity.residual.kind in NOISE_KINDS
    true_weight = TRUE_WEIGHT[problem.constraints] if in_noise else 1.0
    # what assignments of nearly this score share out is structure (a symmetric object), not accident
    explained = sum(value for value in known if value >= (1.0 - TRUST.margin) * score)
    others = max(float(tensor.weights.sum()) - explained, true_weight)
    random = others / max(evaluated, 1) if chance is None else chance
    return log10_false_alarms(
        problem, tensor.shape, score=score / max(share, 1e-300), true_weight=true_weight, chance=random / true_weight
    )
