"""Assessment: unsupported points are unmatched, probability and margin found, and the status follows by one rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import NEVER, Deadline, Pace
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.assignment import margin, one_hot
from rootmatch.hypergraph.support import drop_unsupported, scores_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.pipeline.false_alarms import TRUE_WEIGHT, log10_false_alarms
from rootmatch.pipeline.multi_motion import log10_false_alarms_of_groups
from rootmatch.pipeline.posterior import DEFAULT_OPTIONS, Misfit, Ranked, misfit, ranked
from rootmatch.pipeline.task import MatchingTask
from rootmatch.problems.base import Problem
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Alternatives, Solution


@dataclass(frozen=True)
class TrustOptions:
    """Thresholds of the status. Set on the development scenes of docs/comparison.md (`benchmarks/accuracy.py`).

    Parameters
    ----------
    probability : float
        Least probability of a matched assignment: of those above, 99 in 100 are right (`benchmarks/reliability.py`).
    margin : float
        Least lead in score of a matched assignment where no probability is known.
    false_alarms : float
        Decimal logarithm of the expected number of false alarms.
    beyond_clutter, beyond_clutter_of_views : float
        Logarithm of the odds against clutter alone from which an assignment is trusted whatever its score, for an
        object in an image and for two views, …  For an object they are odds against clutter that crowds as the
        detections do: on the development seeds of `benchmarks/constellations.py` they never exceeded −3 where nothing
        was to be found (300 scenes of unrelated points, 40 of the headset against a stretched copy of itself).
    listed, listed_probability : int, float
        … if the right one is among it and so many alternatives, or the pose is right, with that probability.
    wrong : float
        Fraction of its matches that may be expected to be wrong in a matched assignment of many points. A round value.
    missed : float
        Probability of having missed another pose that explains as much, beyond which an assignment is ambiguous: the
        search was cut short before it looked for one. A round value; searches that end by themselves are below 0.05.
    kept : float
        Least fraction of its matches that is left where those that are not sure are left out of an assignment, to
        call it matched; else it is ambiguous. A round value.
    noise_factor, noise_chance : float
        Factor on σ, as the residuals about the best pose ask for it, from which an assignment is not trusted if
        residuals as large as that are rarer than this chance where σ is right: it was stated too small, and points may
        be missing. Where σ was 1.5 times too small no match is wrong, where it was four times, some are.
    most_named : float
        Factor up to which the advice blames the noise rather than the match. A round value.
    alternatives : int
        Most alternatives that are kept.
    support : float
        Share of the median support below which a matched point is left unmatched: true ones seldom have less than 0.3,
        and those that meet clutter by accident seldom more than 0.2.
    last_support, last_pairs : float, int
        That share where at most so many pairs would remain, too few for an accident to select from.
    clear_margin, clear_support, clear_rival : float
        Lead in score, least support of a matched point and most support of any other match, both over the median
        support, with which an assignment is clear and its neighbours are not fitted: of 2050 such on the development
        seeds none was wrong.
    """

    probability: float = 0.9
    margin: float = 0.2
    false_alarms: float = -2.0
    beyond_clutter: float = 1.0
    beyond_clutter_of_views: float = math.log(100.0)
    listed: int = 5
    listed_probability: float = 0.95
    noise_factor: float = 1.9
    noise_chance: float = 1e-3
    most_named: float = 8.0
    kept: float = 0.9
    wrong: float = 0.01
    missed: float = 0.5
    alternatives: int = 16
    support: float = 0.25
    last_support: float = 0.1
    last_pairs: int = 4
    clear_margin: float = 0.5
    clear_support: float = 0.4
    clear_rival: float = 0.05


TRUST = TrustOptions()
SUPPORTED = 0.5
"""Share of the time left at a deadline for the support of the alternatives; the rest is for fits of poses."""


class Status(Enum):
    """Whether to believe a match; `advice` says what to do in the words of its problem.

    One rule, see `judged`: UNTRUSTED where a false alarm could be as good, or no pose fits the assignment; else
    AMBIGUOUS where it is not sure: its probability below 0.9 or, where there is none, its margin below 0.2; else
    MATCHED. A `clear` assignment, with a margin of 0.5 and no other match supported, is judged by its margin and by the
    fit of its pose alone: of those all had a probability above 0.9 when that was measured, and fitting their
    neighbours would double the time of a small match.
    """

    MATCHED = "matched: the assignment is well supported and no other explains the points nearly as well"
    AMBIGUOUS = (
        "ambiguous: another assignment explains the points nearly as well; see `alternatives`, {to_tell}, "
        "or add points that break the symmetry"
    )
    UNTRUSTED = (
        "no trustworthy match: too few hyper-edges agree; check {to_check}, raise the noise, "
        "or evaluate more hyper-edges"
    )

    def __bool__(self) -> bool:
        """Only a match that can be believed is true."""
        return self is Status.MATCHED

    def __str__(self) -> str:
        return self.value.format(to_tell=Problem.to_tell, to_check=Problem.to_check)

    def advice(self, problem: Problem) -> str:
        """The text with what to check, and what to add, where this problem is solved."""
        return self.value.format(to_tell=problem.to_tell, to_check=problem.to_check)


@dataclass(frozen=True, eq=False)
class Assessment:
    """What is reported of a solution; see `rootmatch.result.Match`."""

    assignment: NDArray[np.int64]
    score: float
    margin: float
    probability: float | None
    alternatives: Alternatives
    status: Status
    confidence: NDArray[np.float64] | None = None
    noise_factor: float | None = None


def assess(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Assessment:
    """The solution without unsupported points, the most probable assignment near it, and whether to believe it."""
    if task.options.packs_motions:
        return _of_motions(solution, task.shape)
    assignment, score, alternatives = solution.assignment, solution.score, solution.alternatives
    if not task.options.is_paper:
        assignment, score, alternatives = supported(assignment, alternatives, sampled.tensor, task.deadline)
    scores = agreement(sampled.tensor, [assignment, *(other for other, _ in alternatives)])
    lead = margin(score, alternatives, assignment)
    probability, trusted, support = None, False, scores[0]
    found: Ranked | None = None
    fault: Misfit | None = None
    proposed = [] if sampled.assignments is None else list(sampled.assignments)
    if not proposed and clear(assignment, lead, sampled.tensor):
        # hyper-edges may agree pair by pair without a pose that suits all of them
        fault = misfit(task, assignment) if fits(task, assignment) else None
    elif fits(task, assignment) or (proposed and fits(task, proposed[0])):
        others = [other for other, _ in alternatives]
        found = ranked(task, [assignment, *others, *proposed], consensus=sampled.consensus)
        fault = found.misfit
        if found.assignments:
            kept = np.array(found.assignments[: TRUST.alternatives + 1])
            values = scores_of(sampled.tensor, kept)
            assignment, score = kept[0], float(values[0])
            alternatives = list(zip(kept[1:], values[1:].tolist(), strict=True))
            lead, probability = margin(score, alternatives, assignment), found.probability
            listed = found.probability_of(1 + TRUST.listed)
            views = task.problem.source_is_image
            beyond = TRUST.beyond_clutter_of_views if views else TRUST.beyond_clutter
            sure = max(listed, 0.0 if found.marginals is None else found.marginals.pose)
            trusted = found.beyond_chance > beyond and sure > TRUST.listed_probability
            # a search need not have evaluated the hyper-edges of its best assignment: one as probable may speak for it
            likely = found.probabilities[: len(values)] >= 1.0 - TRUST.probability
            support = max(agreement(sampled.tensor, [assignment, *kept[: len(values)][likely]]))
    alarms = -math.inf if trusted else false_alarms(task, support, scores, sampled)
    if fault is not None and _does_not_fit(fault):
        alarms = math.inf
    status = judged(math.inf if trusted else support, alarms, lead, probability)
    if status is Status.MATCHED and sampled.missed > TRUST.missed:
        status = Status.AMBIGUOUS
    assessed = Assessment(
        assignment, score, lead, probability, alternatives, status=status,
        noise_factor=None if fault is None else fault.sigma,
    )  # fmt: skip
    if found is None:
        return assessed
    return _point_by_point(task, assessed, found, sampled)


def _does_not_fit(fault: Misfit) -> bool:
    """Whether no pose fits an assignment within the noise that was given."""
    if not fault.variances <= DEFAULT_OPTIONS.most_inflation:
        return True
    return fault.sigma >= TRUST.noise_factor and fault.chance < TRUST.noise_chance


def _point_by_point(task: MatchingTask, assessed: Assessment, found: Ranked, sampled: SampledTensor) -> Assessment:
    """The assessment with the confidence of each match.

    Where the pose is sure and some of the matches are not, those are left out, and the rest is matched.
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
    return replace(
        assessed,
        assignment=sure,
        score=float(scores_of(sampled.tensor, sure[None])[0]),
        probability=each.pose * float(np.prod(each.each[sure >= 0] / each.pose)),
        alternatives=[(assessed.assignment, assessed.score), *assessed.alternatives][: TRUST.alternatives],
        status=Status.MATCHED,
        confidence=np.where(left_out, each.unmatched, each.each),
    )


def confidence_against_chance(found: Ranked, assignment: NDArray[np.int64]) -> NDArray[np.float64]:
    """Confidence (n,) in each match where all of them may be chance: then being unmatched is right."""
    assert found.marginals is not None
    odds = found.beyond_chance if math.isfinite(found.beyond_chance) else 0.0
    real = 1.0 / (1.0 + math.exp(min(-odds, 700.0)))
    return np.asarray(np.where(assignment >= 0, 0.0, 1.0 - real) + real * found.marginals.each)


def fits(task: MatchingTask, assignment: NDArray[np.int64]) -> bool:
    """Whether an assignment has a probability: where the problem fits poses, and residuals are in units of σ."""
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    # a prior for views from one position is no part of the fits
    able = task.problem.fits_answers and in_noise and task.problem.small_baseline == 0.0
    alone = not task.options.is_paper and not task.options.packs_motions
    return able and alone and int((assignment >= 0).sum()) > task.problem.minimal


def probability_of(task: MatchingTask, assignment: NDArray[np.int64], alternatives: Alternatives) -> float | None:
    """Probability of a clear assignment, whose fit the status had no need of; None where there is none."""
    if not fits(task, assignment):
        return None
    found = ranked(task, [assignment, *(other for other, _ in alternatives)])
    return found.probability_of_assignment(assignment) if found.assignments else None


def confidence_of(task: MatchingTask, assignment: NDArray[np.int64], alternatives: Alternatives) -> NDArray[np.float64]:
    """Confidence (n,) in each match of a clear assignment; NaN where there is no probability."""
    unknown = np.full(len(assignment), math.nan)
    if not fits(task, assignment):
        return unknown
    found = ranked(task, [assignment, *(other for other, _ in alternatives)])
    if found.marginals is None:
        return unknown
    if np.array_equal(found.assignments[0], assignment):
        return found.marginals.each
    return np.asarray(found.probabilities @ (np.array(found.assignments) == assignment))


def confidence_of_motions(
    task: MatchingTask, assignment: NDArray[np.int64], motions: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Confidence (n,) in each match of several motions, each with the points and detections that the others leave.

    Being unmatched is right as often as for the least sure of the motions.
    """
    confidence = np.full(len(assignment), math.nan)
    alone = replace(task, options=replace(task.options, motions=1), deadline=NEVER)
    for label in range(int(motions.max(initial=-1)) + 1):
        points = np.flatnonzero((motions == label) | (assignment < 0))
        others = assignment[(motions != label) & (assignment >= 0)]
        pixels = np.setdiff1d(np.arange(task.shape[1]), others)
        place = np.searchsorted(pixels, np.maximum(assignment[points], 0))
        own = np.where(assignment[points] >= 0, place, -1)
        each = confidence_of(alone.subset(points, pixels), own, [])
        confidence[points] = np.where(own >= 0, each, np.fmin(confidence[points], each))
    return confidence


def judged(score: float, alarms: float, lead: float, probability: float | None = None) -> Status:
    """The status of an assignment: could it be a false alarm, and is it the only good one.

    Parameters
    ----------
    score : float
    alarms : float
        Decimal logarithm of the expected number of false alarms.
    lead : float
        Lead in score over the best different assignment.
    probability : float, optional
        Of the assignment; it decides instead of the lead where it is known.
    """
    if score <= 0.0 or alarms > TRUST.false_alarms:
        return Status.UNTRUSTED
    sure = lead >= TRUST.margin if probability is None else probability >= TRUST.probability
    return Status.MATCHED if sure else Status.AMBIGUOUS


def clear(assignment: NDArray[np.int64], lead: float, tensor: AffinityTensor) -> bool:
    """Whether every match is well supported and no other one is, nor another assignment."""
    if lead < TRUST.clear_margin:
        return False
    support = tensor.contract(one_hot(assignment, tensor.shape[1]))
    matched = np.flatnonzero(assignment >= 0)
    own = support[matched, assignment[matched]]
    support[matched, assignment[matched]] = 0.0
    median = float(np.median(own))
    return bool(own.min() >= TRUST.clear_support * median and support.max() <= TRUST.clear_rival * median)


def _of_motions(solution: Solution, shape: tuple[int, int]) -> Assessment:
    """Of groups of one motion each, every one supported by itself; its score is the evidence of the packing."""
    lead = solution.statistics.get("lead", 0.0)
    alarms = log10_false_alarms_of_groups(solution, shape)
    status = judged(solution.score, alarms, lead)
    return Assessment(
        assignment=solution.assignment,
        score=solution.score,
        margin=lead,
        probability=None,
        alternatives=solution.alternatives,
        status=status,
    )


def false_alarms(task: MatchingTask, score: float, known: list[float], sampled: SampledTensor) -> float:
    """Decimal logarithm of the expected number of false alarms with such a score.

    ``known`` are the scores of the assignments that were found. The mean weight of a random hyper-edge is that of those
    outside of the assignment where it is not known.
    """
    tensor, evaluated, share, chance = sampled[:4]
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


def agreement(tensor: AffinityTensor, assignments: Sequence[NDArray[np.int64]]) -> list[float]:
    """Scores of assignments by hyper-edges alone: what was likely before says nothing of whether the points agree."""
    alone = AffinityTensor.unchecked(tensor.indices, tensor.weights, tensor.shape)
    return [float(value) for value in scores_of(alone, np.array(assignments))]


def supported(
    assignment: NDArray[np.int64], alternatives: Alternatives, tensor: AffinityTensor, deadline: Deadline = NEVER
) -> tuple[NDArray[np.int64], float, Alternatives]:
    """Assignments without the points that nothing supports, distinct, best first; those in time for the deadline."""
    candidates = np.array([assignment, *(other for other, _ in alternatives)])
    pace = Pace(deadline.part(SUPPORTED))
    # the first one whatever the time
    parts = [_supported(candidates[:1], tensor)] if deadline.is_set else []
    done = len(parts)
    while done < len(candidates) and (few := pace.block(len(candidates) - done)):
        parts.append(_supported(candidates[done : done + few], tensor))
        done += few
    kept = np.concatenate([part[0] for part in parts])
    scores = np.concatenate([part[1] for part in parts])
    distinct = {one.tobytes(): (one, float(value)) for one, value in zip(kept, scores, strict=True)}
    ranked = sorted(distinct.values(), key=lambda pair: -pair[1])
    (best, score), rest = ranked[0], ranked[1:]
    # an assignment that merely leaves some of the points out is not a different one
    different = [pair for pair in rest if np.any((pair[0] >= 0) & (pair[0] != best))]
    return best, score, different


def _supported(candidates: NDArray[np.int64], tensor: AffinityTensor) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Assignments (K, n) without the points that nothing supports, and their scores (K,)."""
    kept, scores = drop_unsupported(tensor, candidates, TRUST.support)
    matched = (kept >= 0).sum(axis=1)
    last = (tensor.shape[0] - matched) * (tensor.shape[1] - matched) <= TRUST.last_pairs
    if last.any():
        more, more_scores = drop_unsupported(tensor, candidates, TRUST.last_support)
        kept[last], scores[last] = more[last], more_scores[last]
    return kept, scores
