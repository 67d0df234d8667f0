"""What an answer is worth: points that nothing supports are left out, and the status says whether to believe it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.affinity import NOISE_KINDS, Affinity
from rootmatch.hypergraph.assignment import margin as lead
from rootmatch.hypergraph.assignment import one_hot
from rootmatch.hypergraph.support import scores_of, supported_answers
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.pipeline.false_alarms import TRUE_WEIGHT, log10_false_alarms
from rootmatch.pipeline.multi_motion import log10_by_chance
from rootmatch.pipeline.posterior import Evidence, ranked
from rootmatch.problems.base import Problem
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Alternatives, Solution

AMBIGUOUS_MARGIN = 0.2
"""Lead in score below which a different answer is nearly as good, for problems that cannot fit answers."""
SURE = 0.9
"""Probability from which an answer is sure: of those above, 99 in 100 are right (docs/comparison.md)."""
CLEAR, CLEAR_SUPPORT, CLEAR_RIVAL = 0.5, 0.4, 0.05
"""Lead in score, least support of a matched point and most support of any other match, both over the median support,
with which nothing is left to be asked: no answer like that was wrong in the scenes of docs/comparison.md."""
BEYOND_CHANCE = math.log(100.0)
"""Logarithm of the odds against clutter alone from which an answer is trusted whatever its score, …"""
SHOWN, SHOWN_IN = 5, 0.95
"""… if the right one is among it and so many alternatives with that probability."""
KEPT = 16
"""Alternatives that are told."""
SUPPORT, SUPPORT_OF_LAST = 0.25, 0.1
"""Share of the median support below which a matched point is left unmatched: true ones seldom have less than 0.3, and
those that meet clutter by chance seldom more than 0.2; …"""
LAST = 4
"""… and the share where no more than so many pairs would be left over, which chance could hardly have chosen from."""
TRUSTED_FALSE_ALARMS = -2.0
"""Decimal logarithm of the number of answers as good that chance may be expected to find in a trusted match."""


class Status(Enum):
    """What became of a match; `advice` says what to do in the words of a problem."""

    MATCHED = "matched: the answer is well supported and leads over every other"
    AMBIGUOUS = (
        "ambiguous: another answer explains the points nearly as well; look at `alternatives`, tell more of the scene, "
        "or add points that break the symmetry"
    )
    UNTRUSTED = (
        "no trustworthy match: too few hyper-edges agree; check what the problem was given, raise the noise, "
        "or look at more hyper-edges"
    )

    def __str__(self) -> str:
        return self.value

    def advice(self, problem: Problem) -> str:
        """The text with what there is to check, and to tell, where this problem is solved."""
        return self.value.replace("what the problem was given", problem.to_check).replace(
            "tell more of the scene", problem.to_tell
        )


@dataclass(frozen=True)
class Verdict:
    """What is told of an answer; see `rootmatch.match.Match`."""

    assignment: NDArray[np.int64]
    score: float
    margin: float
    alternatives: Alternatives
    status: Status


def of_all(
    solution: Solution, weighed: SampledTensor, problem: Problem, weigh: Affinity, keep_all: bool, evidence: Evidence
) -> Verdict:
    """Of a solution that is one group; ``keep_all``: points without support stay matched."""
    assignment, score, alternatives = solution.assignment, solution.score, solution.alternatives
    if not keep_all:
        assignment, score, alternatives = supported(assignment, alternatives, weighed.tensor)
    lead_over, least = lead(score, alternatives, assignment), AMBIGUOUS_MARGIN
    found = None
    known = [score, *(value for _, value in alternatives)]
    # a prior for views from one place is no part of the fits
    likely = not keep_all and weigh.residual.kind in NOISE_KINDS and problem.fits_answers
    likely = likely and problem.small_baseline == 0.0
    if likely and (assignment >= 0).sum() > problem.minimal and not clear(assignment, lead_over, weighed.tensor):
        found = ranked(evidence, [assignment, *(other for other, _ in alternatives)])
        if found.answers:
            lead_over, least = max(0.0, 2.0 - 1.0 / found.probability), 2.0 - 1.0 / SURE
            told = np.array(found.answers[: KEPT + 1])
            scores = scores_of(
                weighed.tensor.indices, weighed.tensor.weights, weighed.tensor.unary, told, weighed.tensor.shape[1]
            )
            assignment, score = told[0], float(scores[0])
            alternatives = list(zip(told[1:], scores[1:].tolist(), strict=True))
    alarms = false_alarms(problem, score, known, weighed, weigh)
    if found is not None and found.beyond_chance > BEYOND_CHANCE and found.probability_of(1 + SHOWN) > SHOWN_IN:
        alarms = -math.inf
    return Verdict(assignment, score, lead_over, alternatives, judged(score, lead_over, alarms, least))


def clear(assignment: NDArray[np.int64], lead_over: float, tensor: AffinityTensor) -> bool:
    """Whether every match is well supported and no other one is, nor another answer."""
    if lead_over < CLEAR:
        return False
    support = tensor.contract(one_hot(assignment, tensor.shape[1]))
    matched = np.flatnonzero(assignment >= 0)
    own = support[matched, assignment[matched]]
    support[matched, assignment[matched]] = 0.0
    median = float(np.median(own))
    return bool(own.min() >= CLEAR_SUPPORT * median and support.max() <= CLEAR_RIVAL * median)


def of_groups(solution: Solution, shape: tuple[int, int]) -> Verdict:
    """Of a solution that is several groups, each supported for itself."""
    lead_over = solution.statistics.get("lead", 0.0)
    status = judged(solution.score, lead_over, log10_by_chance(solution, shape))
    return Verdict(solution.assignment, solution.score, lead_over, solution.alternatives, status)


def judged(score: float, margin: float, alarms: float, least: float = AMBIGUOUS_MARGIN) -> Status:
    """Whether chance could have found as good an answer, and whether another answer is nearly as good."""
    if score <= 0.0 or alarms > TRUSTED_FALSE_ALARMS:
        return Status.UNTRUSTED
    return Status.AMBIGUOUS if margin < least else Status.MATCHED


def false_alarms(problem: Problem, score: float, known: list[float], weighed: SampledTensor, weigh: Affinity) -> float:
    """Decimal logarithm of the number of answers as good that chance is expected to find.

    ``known`` are the scores of the answers that were found.
    The mean weight of a random hyper-edge is that of those outside of the answer where it is not known.
    """
    tensor, evaluated, share, chance = weighed[:4]
    true_weight = TRUE_WEIGHT[problem.constraints] if weigh.residual.kind in NOISE_KINDS else 1.0
    # what answers of nearly this score share out is structure (a symmetric object), not chance
    explained = sum(value for value in known if value >= (1.0 - AMBIGUOUS_MARGIN) * score)
    others = max(float(tensor.weights.sum()) - explained, true_weight)
    random = others / evaluated if chance is None else chance
    return log10_false_alarms(problem, *tensor.shape, score / max(share, 1e-300), true_weight, random / true_weight)


def supported(
    assignment: NDArray[np.int64], alternatives: list[tuple[NDArray[np.int64], float]], tensor: AffinityTensor
) -> tuple[NDArray[np.int64], float, list[tuple[NDArray[np.int64], float]]]:
    """Answers without the points that nothing supports, distinct, best first."""
    asked = np.array([assignment, *(other for other, _ in alternatives)])
    of = tensor.indices, tensor.weights, tensor.unary, tensor.shape[1], asked
    kept, scores = supported_answers(*of, SUPPORT)
    matched = (kept >= 0).sum(axis=1)
    last = (tensor.shape[0] - matched) * (tensor.shape[1] - matched) <= LAST
    if last.any():
        more, more_scores = supported_answers(*of, SUPPORT_OF_LAST)
        kept[last], scores[last] = more[last], more_scores[last]
    answers = {answer.tobytes(): (answer, float(value)) for answer, value in zip(kept, scores, strict=True)}
    ranked = sorted(answers.values(), key=lambda pair: -pair[1])
    (best, score), rest = ranked[0], ranked[1:]
    # an answer that merely leaves some of the points out is not a different one
    different = [pair for pair in rest if np.any((pair[0] >= 0) & (pair[0] != best))]
    return best, score, different
