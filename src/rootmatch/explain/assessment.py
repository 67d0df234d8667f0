"""Assessment of a solution that no model judges: unmatch unsupported points, weigh the score, and state the facts.

That is so with several motions before each is judged, for problems of one's own, and with the residuals of the paper.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import Deadline, OutOfTime, Pace
from rootmatch.explain.decide import TRUST, Facts
from rootmatch.explain.finding import Finding
from rootmatch.explain.motion_groups import label_motions, log10_false_alarms_of_groups
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.assignment import margin
from rootmatch.hypergraph.support import drop_unsupported, score_assignments
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.base import Problem
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Alternatives, Solution

TRUE_WEIGHT = {degrees: math.sqrt(0.5**degrees) for degrees in range(1, 9)}
"""Mean of exp(−χ²/2) of a true hyper-edge, by degrees of freedom of χ²."""

SUPPORTED = 0.5
"""Share of the time left at a deadline for the support of the alternatives; the rest is for fits of poses."""


def supported_points(score: float, order: int, true_weight: float) -> float:
    """Number of points, all of one motion and all right, that would give this score: C(m, order) · true_weight = score.

    Between whole numbers, C(m, d) is continued as m (m − 1) … (m − d + 1) / d!. The result is at least the order.
    """
    wanted = score / true_weight

    def tuples(m: float) -> float:
        return math.prod(m - k for k in range(order)) / math.factorial(order)

    low, high = float(order), float(order + 1)
    if wanted <= 1.0:
        return low
    while tuples(high) < wanted:
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tuples(middle) < wanted else (low, middle)
    return low


def log10_false_alarms(
    problem: Problem, shape: tuple[int, int], *, score: float, true_weight: float, chance: float
) -> float:
    """Decimal logarithm of the expected number of false alarms (a contrario, Desolneux et al. 2000).

    There are C(n, m) n'! / (n' − m)! ways to match m points. A minimal set of them fixes the motion, up to the roots
    of its polynomial, and each further point agrees accidentally with the probability that a random hyper-edge does.

    ``score``: of the assignment, all hyper-edges among its points evaluated. ``true_weight``: mean weight of a true
    hyper-edge. ``chance``: that of a random one over it.
    """
    n, n_target = shape
    m = min(supported_points(score, problem.order, true_weight), float(n), float(n_target))

    ways = math.lgamma(n + 1.0) - math.lgamma(m + 1.0) - math.lgamma(n - m + 1.0)
    ways += math.lgamma(n_target + 1.0) - math.lgamma(n_target - m + 1.0)
    agreement = (m - problem.minimal) * math.log(min(max(chance, 1e-12), 1.0))
    return (ways + math.log(problem.degree) + agreement) / math.log(10.0)


def assess(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Finding:
    """A solution without unsupported points, and whether to trust it; if there is no time for that, it is untrusted.

    The score of groups of one motion each is the evidence of their packing.
    """
    told, labels = solution, None
    try:
        if task.options.packs_motions:
            alarms, lead = log10_false_alarms_of_groups(solution, task.shape), solution.statistics.get("lead", 0.0)
            facts = Facts(support=solution.score, false_alarms=alarms, lead=lead)
        else:
            if not task.options.is_paper:
                kept = drop_weak_points(solution.assignment, solution.alternatives, sampled.tensor, task.deadline)
                solution = replace(solution, assignment=kept[0], score=kept[1], alternatives=kept[2])
            tensor, every = sampled.tensor, [solution.assignment, *(other for other, _ in solution.alternatives)]
            # prior weights do not say whether the points agree
            alone = AffinityTensor.unchecked(tensor.indices, tensor.weights, tensor.shape)
            scores = [float(value) for value in score_assignments(alone, np.array(every))]
            lead = margin(solution.score, solution.alternatives, solution.assignment)
            alarms = expected_false_alarms(task, scores[0], scores, sampled)
            facts = Facts(support=scores[0], false_alarms=alarms, lead=lead, missed=sampled.missed)
        labels = solution.groups
        if labels is None:
            labels = label_motions(solution.assignment, sampled.tensor, task.options.motions)
        told = solution
    except OutOfTime:
        facts = Facts(confirmed=False, lead=told.margin)
    return Finding(
        task=task,
        assignment=told.assignment,
        others=[other for other, _ in told.alternatives],
        facts=facts,
        tensor=sampled.tensor,
        scores=[told.score, *(value for _, value in told.alternatives)],
        soft=told.soft,
        labels=labels,
        converged=told.converged,
        evaluated=sampled.evaluated,
    )


def expected_false_alarms(task: MatchingTask, score: float, known: list[float], sampled: SampledTensor) -> float:
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


def drop_weak_points(
    assignment: Integers, alternatives: Alternatives, tensor: AffinityTensor, deadline: Deadline
) -> tuple[Integers, float, Alternatives]:
    """Assignments without unsupported points, distinct, best first; as many as the deadline allows."""
    candidates = np.array([assignment, *(other for other, _ in alternatives)])
    pace = Pace(deadline.part(SUPPORTED))
    # the first one in any case
    parts = [_drop_weak_points(candidates[:1], tensor)] if deadline.is_set else []
    done = len(parts)
    while done < len(candidates) and (few := pace.block(len(candidates) - done)):
        parts.append(_drop_weak_points(candidates[done : done + few], tensor))
        done += few
    kept = np.concatenate([part[0] for part in parts])
    scores = np.concatenate([part[1] for part in parts])
    distinct = {one.tobytes(): (one, float(value)) for one, value in zip(kept, scores, strict=True)}
    ranked = sorted(distinct.values(), key=lambda pair: -pair[1])
    (best, score), rest = ranked[0], ranked[1:]
    # an assignment that merely leaves some of the points out is not a different one
    different = [pair for pair in rest if np.any((pair[0] >= 0) & (pair[0] != best))]
    return best, score, different


def _drop_weak_points(candidates: Integers, tensor: AffinityTensor) -> tuple[Integers, Floats]:
    """Assignments (K, n) without unsupported points, and their scores (K,)."""
    kept, scores = drop_unsupported(tensor, candidates, TRUST.support)
    matched = (kept >= 0).sum(axis=1)
    last = (tensor.shape[0] - matched) * (tensor.shape[1] - matched) <= TRUST.last_pairs
    if last.any():
        more, more_scores = drop_unsupported(tensor, candidates, TRUST.last_support)
        kept[last], scores[last] = more[last], more_scores[last]
    return kept, scores
