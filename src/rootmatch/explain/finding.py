"""The finding of a stage: an assignment, the facts that decide whether to trust it, and its origin.

Stages exchange findings, which are plain values. `rootmatch.result.report` makes the public `Match` of the last one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import TRUST, Facts, Status, least_trusted
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with, once
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.assignment import margin, one_hot
from rootmatch.hypergraph.enumeration import sweep_cost
from rootmatch.hypergraph.support import score_assignments
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.modes import Modes
from rootmatch.model.point_set_posterior import PointSetPosterior
from rootmatch.model.posterior import Others, Posterior
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.samplers.base import SampledTensor
from rootmatch.samplers.limits import LIMITS
from rootmatch.solvers.base import Alternatives, Solution

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, eq=False, kw_only=True)
class Finding:
    """An assignment and what is known about it; `rootmatch.Match` explains what the attributes mean to a caller.

    The finding of a rig has a row for each sighting of a point, see `MatchingTask.rows`: n is their number.
    """

    task: MatchingTask
    assignment: Integers
    """(n,) index into the target points; −1 where unmatched."""
    others: Sequence[Integers]
    """Each (n,): the best different assignments, the most probable first where probabilities are known."""
    facts: Facts
    """From which `status` follows."""
    tensor: AffinityTensor
    other_probabilities: Sequence[float] | None = None
    """Of the others, if they are known and `Others` does not tell them; see `alternative_probabilities`."""
    scores: Sequence[float] | None = None
    """Scores of the assignment and of the others, if already known; see `all_scores`."""
    scoreless: bool = False
    """Whether a model decided without any hyper-edge: there are no scores then."""
    soft: Floats | None = None
    """(n, n') soft assignment of a solver; None if none ran."""
    labels: Integers | None = None
    """(n,) motion of each point; None if all matches are one motion."""
    converged: bool = True
    evaluated: int = 0
    confidence: Floats | None = None
    """(n,) where the status needed it."""
    log_odds: float | None = None
    """Of the assignment against clutter alone, where the status needed it."""
    noise_factor: float | None = None
    noise_dof: int = 0
    """Degrees of freedom of the residuals that tell it."""
    moved: float = 0.0
    """See `Misfit.moved`."""
    alike: Floats | None = None
    """(W,) log-odds of points that are off by each of `rootmatch.model.image_alike.ERRORS`, of those as given, where
    there is something near points that have no match."""
    another: float = -math.inf
    """Log-odds of something else that shares some of the points, see `rootmatch.model.elsewhere`."""
    mode: int = 0
    """Which mode of ``posterior`` it tells."""
    sequence_factor: float = 1.0
    """Factor on the stated σ that the frames before suggest, with which this one was matched; 1 for a single image."""
    motion_factor: float = 1.0
    """Factor on the stated accelerations that the frames suggest, where it is the largest that is believed; else 1."""
    point_error: float = 0.0
    """Standard deviation of the points' coordinates which it takes, though none was stated."""
    unmet: float = 0.0
    """Probability that the search would have met no mode of a body that is in view, see `SampledTensor`."""
    reason: str | None = None
    """Why nothing could be matched, or why the match is not trusted."""
    prior_holds: bool | None = None
    contradicted: bool = False
    """Whether something that is known of the pose in part, and was combined with a prediction, all but excludes it."""
    fitted: Pose | None = None
    """Its pose, where that is more than the one of its mode, as if a prediction is part of it."""
    is_posed: bool = False
    """Whether its pose is otherwise that of its mode."""
    posterior: Posterior | None = None
    """Of which it is told, where a model of the image decides."""
    model: DetectionModel | None = None
    """That model."""
    labellings: PointSetPosterior | None = None
    """Of which it is told, where a model of two point sets decides."""
    parts: dict[Label, Finding] | None = None
    """The findings of several bodies by their labels."""
    named: Sequence[Integers] = ()
    """Each (n,): all that a search named, where no model has judged them, or two views show a scene that repeats."""
    left: MatchingTask | None = None
    """What remains to be searched if they are not believed."""
    mirrored: Sequence[Integers] = ()
    """Each (n,): of two point sets, those by reflections, which are no answers."""

    @once
    def status(self) -> Status:
        """Status from the facts; with several bodies, that of the least trusted one."""
        if self.parts is not None:
            return least_trusted(part.status for part in self.parts.values())
        return self.facts.status

    @once
    def pose(self) -> Pose | None:
        """Of which a model of the image tells the assignment; a prediction that holds is part of it."""
        if self.fitted is not None or not self.is_posed:
            return self.fitted
        told, model = self.posterior_and_model
        return mode_pose(model, told.modes, self.mode)

    @property
    def posterior_and_model(self) -> tuple[Posterior, DetectionModel]:
        """The posterior of which it is told, and the model of the image: of a finding that has both."""
        assert self.posterior is not None
        assert self.model is not None
        return self.posterior, self.model

    @property
    def is_cut(self) -> bool:
        """Whether the search of a tracker's frame spent the evaluations that it may take."""
        return self.task.budget is not None and self.evaluated >= self.task.budget

    @property
    def is_pose_certain(self) -> bool:
        """Whether one pose is as probable as a match has to be, whatever its matches."""
        minimum, told = self.facts.min_probability, self.posterior
        if self.labellings is not None:
            return self.labellings.motion >= minimum
        return told is not None and bool((told.probabilities[:1] >= minimum).any())

    @property
    def longer_search(self) -> str:
        """What lets the search evaluate more, by the names of the options; more points where all was evaluated."""
        chosen = self.task.options.chosen_sampler
        if self.is_cut:
            return "raise `search_budget` in `TrackingOptions`"
        if chosen == "exhaustive":
            return "give more points or detections"
        if chosen == "random":
            return "evaluate more hyper-edges with larger `samples`"
        sweep = sweep_cost(*self.task.shape, self.task.problem.order, self.task.allowed)
        if self.labellings is None and sweep <= LIMITS.exhaustive:  # of two point sets no hyper-edge is asked for
            return 'evaluate more hyper-edges with `sampler="exhaustive"`'
        return "evaluate more hyper-edges with a larger `budget` of `Guided`"

    @property
    def presence_probability(self) -> float:
        """Probability that the body is in view, or what has nearly its shape: whether or not a pose fits."""
        if self.posterior is not None:
            return self.posterior.shown
        return 0.0 if self.labellings is None else self.labellings.present

    @once
    def matched_count(self) -> int:
        """Number of its matches."""
        return int(np.count_nonzero(self.assignment >= 0))

    def is_exchanged(self, mode: int | None) -> bool:
        """Whether a mode of the posterior is where another body of its family was expected."""
        every = None if self.posterior is None else self.posterior.exchanged
        return every is not None and mode is not None and mode < len(every) and bool(every[mode])

    def with_facts(self, **facts: Any) -> Self:
        """A copy with some facts changed, from which another status may follow."""
        return copy_with(self, facts=copy_with(self.facts, **facts))

    def lower_probability(self, probability: float, confidence: Floats) -> Self:
        """A copy that is less probable, as are its matches (n,); ambiguous if it is less so than what is trusted."""
        contested = {"contested": True, "sure_of_the_rest": False} if probability < self.facts.min_probability else {}
        return copy_with(self, facts=copy_with(self.facts, probability=probability, **contested), confidence=confidence)

    def scale_probability(self, factor: float) -> Self:
        """A copy that is less probable by a factor, as is each of its matches; ambiguous as of `lower_probability`."""
        if self.facts.probability is None or self.confidence is None:
            return self
        less = np.where(self.assignment >= 0, factor, 1.0) * self.confidence
        return self.lower_probability(factor * self.facts.probability, less)

    @property
    def all_confidence(self) -> Floats | None:
        """Confidence (n,) in each match, of several bodies in those of each; None if none is known."""
        if self.confidence is not None:
            return self.confidence
        if self.parts is None:
            return None if self.posterior is None else self.posterior.confidence_in(self.assignment)
        out = np.full(self.task.rows, np.nan)
        for rows, part in self._part_rows:
            own = part.all_confidence
            out[rows] = np.nan if own is None else own
        return out

    @property
    def _part_rows(self) -> list[tuple[Integers, Finding]]:
        """The rows of each of several bodies, and its finding."""
        if self.parts is None or self.task.bodies is None:
            return []
        points = map(self.task.bodies.points_of, range(len(self.parts)))
        return [(self.task.sighting_rows(own), part) for own, part in zip(points, self.parts.values(), strict=True)]

    @property
    def probability(self) -> float | None:
        """Probability of the assignment, if the status needed it."""
        return self.facts.probability

    @property
    def every(self) -> list[Integers]:
        """The assignment and the others."""
        return [self.assignment, *self.others]

    @property
    def score(self) -> float:
        """Total weight of the hyper-edges inside the assignment; NaN without any."""
        return math.nan if self.scores is None and self.scoreless else self.all_scores[0]

    @once
    def all_scores(self) -> list[float]:
        """Total weight of the hyper-edges inside the assignment, and inside each of the others."""
        if self.scores is not None:
            return list(self.scores)
        if self.parts is not None:
            known = [part.score for part in self.parts.values() if not math.isnan(part.score)]
            return [sum(known) if known else math.nan]
        if self.scoreless:
            return [math.nan] * len(self.every)
        return [float(score) for score in score_assignments(self.tensor, np.array(self.every))]

    @property
    def alternative_probabilities(self) -> Sequence[float] | None:
        """Probability of each of the others, where a model tells it."""
        if isinstance(self.others, Others):
            return [chance for _, chance in self.others.ranked]
        return self.other_probabilities

    @property
    def alternatives(self) -> Alternatives:
        """The other assignments with their scores."""
        return list(zip(self.others, self.all_scores[1:], strict=True))

    @once
    def margin(self) -> float:
        """Lead in score over the best different assignment, of several bodies that of the least sure one.

        See `rootmatch.hypergraph.assignment.margin`.
        """
        if self.facts.lead is not None:
            return self.facts.lead
        if self.parts is not None:
            return min(part.margin for part in self.parts.values())
        return margin(self.all_scores[0], self.alternatives, self.assignment)

    @once
    def soft_assignment(self) -> Floats:
        """Soft assignment (n, n') of the solver; if none ran, the support of each correspondence, row by row.

        Without hyper-edges, the confidence in each match. Of several bodies, that of each.
        """
        if self.soft is not None:
            return self.soft
        if self.parts is not None:
            soft = np.zeros(self.task.row_shape)
            for rows, part in self._part_rows:
                soft[rows] = part.soft_assignment
            return soft
        if self.scoreless:
            soft, matched = np.zeros(self.tensor.shape), np.flatnonzero(self.assignment >= 0)
            if self.confidence is not None:
                soft[matched, self.assignment[matched]] = self.confidence[matched]
            return soft
        gains = np.maximum(self.tensor.contract(one_hot(self.assignment, self.tensor.shape[1])), 0.0)
        rows = gains.sum(axis=1, keepdims=True)
        return np.asarray(gains / np.where(rows > 0.0, rows, 1.0))

    @once
    def motion_labels(self) -> Integers:
        """Label of the rigid motion of each point, −1 where unmatched; (n,)."""
        return np.where(self.assignment >= 0, 0, -1) if self.labels is None else self.labels


def mode_pose(model: DetectionModel, modes: Modes, k: int) -> Pose:
    """The pose of one of the modes, of the points as they were given."""
    return model.pose_of_origin(modes.rotation[k], modes.position[k], modes.covariance[k])


def make_unjudged(
    task: MatchingTask, sampled: SampledTensor, solution: Solution | None
) -> tuple[list[Integers], Finding]:
    """Assignments that a solver or a search named, and the finding of them before a model has judged any."""
    named = [] if solution is None else [solution.assignment, *(other for other, _ in solution.alternatives)]
    named += [] if sampled.assignments is None else list(sampled.assignments)
    return named, Finding(
        task=task,
        assignment=named[0] if named else np.full(task.rows, -1, np.int64),
        others=named[1 : 1 + TRUST.alternatives],
        facts=Facts(confirmed=False, missed=sampled.missed),
        tensor=sampled.tensor,
        soft=None if solution is None else solution.soft,
        converged=solution is None or solution.converged,
        evaluated=sampled.evaluated,
        unmet=sampled.unmet,
    )


def make_empty_finding(task: MatchingTask, reason: str | None) -> Finding:
    """The finding of a task that leaves nothing to match; as of an image without a mode, nothing has the odds 1.

    Of problems without a model no odds are known, here as elsewhere.
    """
    by_noise = task.affinity.residual.kind in NOISE_KINDS and not task.options.is_paper
    told = 0.0 if by_noise and task.problem.min_for_pose else None
    return Finding(
        task=task,
        assignment=np.full(task.rows, -1, np.int64),
        others=[],
        facts=Facts(confirmed=False, lead=0.0, probability=told),
        log_odds=told,
        tensor=empty_tensor(task),
        scores=[0.0],
        soft=np.zeros(task.row_shape),
        reason=reason,
    )


def empty_tensor(task: MatchingTask) -> AffinityTensor:
    """The tensor of a task of which no hyper-edge was evaluated."""
    return _make_empty_tensor(task.problem.order, task.row_shape)


@lru_cache(maxsize=256)
def _make_empty_tensor(order: int, shape: tuple[int, int]) -> AffinityTensor:
    return AffinityTensor.unchecked(np.empty((0, order), np.int32), np.empty(0), shape)
