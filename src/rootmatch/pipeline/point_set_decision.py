"""The assessment of a match of two point sets by the posterior of its labellings."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends import selection
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.assignment import margin
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.support import scores_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.point_set_posterior import posterior
from rootmatch.on_demand import Once
from rootmatch.pipeline.assessment import Assessment
from rootmatch.pipeline.detection_odds import MOST_DETECTED
from rootmatch.pipeline.near_symmetries import symmetries_of
from rootmatch.pipeline.sampling import sample
from rootmatch.pipeline.status import TRUST, Status
from rootmatch.pipeline.task import MatchingTask
from rootmatch.samplers.base import SampledTensor
from rootmatch.samplers.point_sets.congruent import congruent_labellings, grown, is_small
from rootmatch.solvers.base import Solution

Integers = NDArray[np.int64]

LEAST = 3
"""Matches that tell a motion."""
LEADING = 4
"""Labellings of a search of which the self-motions of the source make others. A round value."""


def model_of(task: MatchingTask) -> PointSetModel | None:
    """The model of a task of two point sets of one space and one motion; None for every other one."""
    clouds = task.problem.point_clouds(task.points)
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    if clouds is None or not in_noise or task.options.motions != 1 or task.options.is_paper:
        return None
    rate = task.options.detection
    return PointSetModel(
        clouds,
        mirror=bool(getattr(task.problem, "mirror", False)),
        allowed=task.allowed,
        weights=task.prior,
        detection_rate=None if rate is None else min(rate, MOST_DETECTED),
    )


def decided_by_model(task: MatchingTask) -> tuple[SampledTensor, Assessment] | None:
    """The sampled tensor and the assessment of a task by default options; None for what the model does not do."""
    options = task.options
    model = model_of(task)
    default = options.sampler == "auto" and options.solver is None and options.scheduler is None
    if model is None or not default or options.backend in selection.ON_CARD:
        return None
    if is_small(model.clouds):
        tensor = DeferredTensor.of(lambda: sample(task).tensor, task.shape, task.prior)
        labellings = congruent_labellings(model.clouds, model.mirror, task.allowed)
        sampled = SampledTensor(tensor, labellings.tried)
        return sampled, assessed(model, labellings.proper, tensor, labellings.mirrored)
    sampled = sample(task)
    return sampled, assessed(model, proposed(task, model, sampled, []), sampled.tensor)


def solution_by_model(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Assessment | None:
    """The assessment of what a caller's own sampler or solver found; None for what the model does not do."""
    model = model_of(task)
    if model is None:
        return None
    named = [solution.assignment, *(other for other, _ in solution.alternatives)]
    if not is_small(model.clouds):
        return assessed(model, proposed(task, model, sampled, named), sampled.tensor)
    labellings = congruent_labellings(model.clouds, model.mirror, task.allowed)
    return assessed(model, np.concatenate([named, labellings.proper]), sampled.tensor, labellings.mirrored)


def proposed(task: MatchingTask, model: PointSetModel, sampled: SampledTensor, named: list[Integers]) -> Integers:
    """Labellings (K, n) of large sets: those of a search, what self-motions of the source make of them, and others."""
    every = [*([] if sampled.assignments is None else sampled.assignments), *named]
    if not every:
        return np.empty((0, task.shape[0]), np.int64)
    if task.points.source.shape[1] == 3:
        for symmetry in symmetries_of(task.points.source, None):
            every += [np.where(symmetry.image >= 0, one[symmetry.image], -1) for one in every[:LEADING]]
    return grown(model.clouds, np.array(every), model.mirror, task.allowed)


def lead_over_others(task: MatchingTask, assignment: Integers, others: list[MatchingTask]) -> float | None:
    """Log-odds of a body's labelling against the best one of another body with half of its targets or more.

    Infinite where no other body explains them, None for what the model does not do. All tasks have the same targets.
    """
    model = model_of(task)
    if model is None or (assignment >= 0).sum() < LEAST:
        return None
    used = np.sort(assignment[assignment >= 0])
    best = -math.inf
    for other in others:
        rival = model_of(other)
        if rival is None:
            continue
        part = rival.clouds._replace(
            target=rival.clouds.target[used], target_variance=rival.clouds.target_variance[used]
        )
        if not is_small(part):
            continue
        allowed = None if rival.allowed is None else rival.allowed[:, used]
        named = congruent_labellings(part, rival.mirror, allowed).proper
        named = named[2 * (named >= 0).sum(axis=1) >= len(used)]
        if len(named):
            best = max(best, float(rival.log_odds(rival.fit(np.where(named >= 0, used[named], -1))).max()))
    return float(model.log_odds(model.fit(assignment[None]))[0]) - best


def assessed(
    model: PointSetModel, proposals: Integers, tensor: AffinityTensor, mirrored: Integers | None = None
) -> Assessment:
    """What is reported of proposed labellings; their scores are computed when they are asked for."""
    found = posterior(model, proposals, mirrored)
    n = len(model.clouds.source)
    if not len(found.assignments):
        nothing = np.full(n, -1, np.int64)
        return Assessment(
            assignment=nothing, score=0.0, margin=0.0, probability=found.present, alternatives=[],
            status=Status.UNTRUSTED, confidence=np.full(n, 1.0),
        )  # fmt: skip
    assignment, probability = found.assignments[0], float(found.probabilities[0])
    confidence, unmatched = found.confidence()
    others, status = found.assignments[1:], Status.UNTRUSTED
    if found.present >= TRUST.probability:
        status = Status.AMBIGUOUS
        if (sure := found.sure(TRUST.probability, LEAST)) is not None:
            status = Status.MATCHED
            left_out = (sure[0] < 0) & (assignment >= 0)
            if left_out.any():
                others = found.assignments
            (assignment, probability), confidence = sure, np.where(left_out, unmatched, confidence)
    different = ((others >= 0) & (others != assignment)).any(axis=1)
    kept = np.concatenate([assignment[None], others[different][: TRUST.alternatives]])

    @Once
    def scores() -> list[float]:
        """Of the assignment and its alternatives."""
        return [float(score) for score in scores_of(tensor, kept)]

    def alternatives() -> list[tuple[Integers, float]]:
        """The other assignments and their scores."""
        return list(zip(kept[1:], scores()[1:], strict=True))

    return Assessment(
        assignment=assignment,
        score=lambda: scores()[0],
        margin=lambda: margin(scores()[0], alternatives(), assignment),
        probability=min(probability, found.present),
        alternatives=alternatives,
        status=status,
        confidence=confidence,
        noise_factor=found.noise_factor,
    )
