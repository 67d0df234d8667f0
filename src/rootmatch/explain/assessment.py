"""Assessment of a solution that no model judges: unmatch unsupported points, weigh the score, and state the facts.

That is so with several motions, for problems of one's own, and with the residuals of the paper.
"""

from __future__ import annotations

import math

from rootmatch.deadline import OutOfTime
from rootmatch.explain.agreement import agreement, supported
from rootmatch.explain.decide import TRUST, Facts
from rootmatch.explain.false_alarms import TRUE_WEIGHT, log10_false_alarms
from rootmatch.explain.finding import Finding
from rootmatch.explain.motion_labels import motion_labels
from rootmatch.explain.multi_motion import log10_false_alarms_of_groups
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.assignment import margin
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Solution


def assess(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Finding:
    """A solution without unsupported points, and whether to trust it.

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
    return Finding(
        task=task,
        assignment=assignment,
        others=[other for other, _ in alternatives],
        facts=Facts(
            support=scores[0],
            false_alarms=false_alarms(task, scores[0], scores, sampled),
            lead=lead,
            missed=sampled.missed,
        ),
        tensor=sampled.tensor,
        scores=[score, *(value for _, value in alternatives)],
        soft=solution.soft,
        labels=motion_labels(solution, assignment, sampled.tensor, task.options.motions),
        converged=solution.converged,
        evaluated=sampled.evaluated,
    )


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
