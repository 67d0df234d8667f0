"""Motions that were asked for and not found: a search among what the others leave, and what a point may belong to.

A packing of hyper-edges may miss a motion of few points. So the model of one motion searches what is left, as for one
more body. If it finds nothing either, the motion may still be there and show no more points than any pose has: its
points would have images that nobody can tell from clutter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.body_findings import join_hyperedges, restore_columns
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.known_pose import QUICK
from rootmatch.explain.motion_groups import distinct_hyperedges
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.priors import PRESENT_ODDS


class Rest(NamedTuple):
    """What the motions found leave to one more."""

    points: Integers
    detections: Integers
    told: Finding | None
    """Of one motion among them; None of fewer than a search takes."""
    few: Floats
    """Odds (K,), against no motion, of one that shows 0, 1, … K − 1 of the points, as few as any pose has.

    None unless one more is asked for, which only what is seen tells then."""
    missing: int
    """How many more motions are asked for; each may be there or not, whatever the others are."""
    label: int = -1
    """Of the motion that was found there; −1 if none was."""

    def is_left_by(self, assignment: Integers) -> bool:
        """Whether other motions, by their assignment (n,) of all points, leave as much as was searched."""
        used = assignment[assignment >= 0]
        same = np.array_equal(self.points, np.flatnonzero(assignment < 0))
        return same and not np.isin(self.detections, used).any()

    @property
    def odds(self) -> float:
        """Odds, against no motion, of one that shows more points than that."""
        present = 0.0 if self.told is None else self.told.facts.present or 0.0
        return present / max(1.0 - present, 1e-12)

    @property
    def missed(self) -> float:
        """Probability that another pose explains as much as what was found, and was never met."""
        return 0.0 if self.told is None else self.told.facts.missed

    @property
    def empty_probability(self) -> float:
        """Probability that no point has an image."""
        return float((1.0 + self.few[:1].sum()) / (1.0 + self.few.sum() + self.odds)) ** self.missing

    @property
    def unmatched(self) -> Floats:
        """Probability (n,) that each of the points has no image."""
        own = np.ones(len(self.points))
        if self.told is not None and self.told.confidence is not None:
            own = np.where(self.told.assignment >= 0, 1.0 - self.told.confidence, self.told.confidence)
        hidden = 1.0 - np.arange(len(self.few)) / max(len(self.points), 1)
        above = (1.0 + self.odds) * own + (self.few * hidden).sum()
        return np.asarray((above / (1.0 + self.odds + self.few.sum())) ** self.missing)

    def lower_confidence(self, assignment: Integers, confidence: Floats) -> Floats:
        """Confidence (n,) of motions that were found, and in unmatched points what is left of one more, if less."""
        unmatched = np.full(len(assignment), math.nan)
        unmatched[self.points] = self.unmatched
        return np.where(assignment < 0, np.fmin(confidence, unmatched), confidence)

    def may_show(self, minimum: float) -> bool:
        """Whether one more that is asked for may be in view: nothing of it with less than this probability."""
        return len(self.few) > 0 and self.empty_probability < minimum

    def named(self, count: int) -> list[Integers]:
        """What the search named beside what it found, each (count,) as an assignment of all points."""
        every = np.full((0 if self.told is None else len(self.told.others) + len(self.told.named), count), -1, np.int64)
        if self.told is not None and len(every):
            named = np.array([*self.told.others, *self.told.named])
            every[:, self.points] = np.where(named >= 0, self.detections[named], -1)
        return list(every)


def add_missing_motions(
    alone: MatchingTask,
    solve: Callable[[MatchingTask], Finding],
    assignment: Integers,
    labels: Integers,
    asked: int | Literal["auto"],
    *,
    searched: list[Rest],
    budget: int = QUICK,
) -> Rest | None:
    """What is left where no more motions are found, or None of as many as were asked for.

    Those that the model of one motion finds, by ``solve``, are added to the assignment (n,) and its labels (n,), and
    each search, of so many evaluations, to ``searched``. ``alone``: the task of one motion among all points.
    """
    while asked == "auto" or len(np.unique(labels[labels >= 0])) < asked:
        missing = 0 if asked == "auto" else asked - len(np.unique(labels[labels >= 0]))
        rest = search_rest(alone, solve, assignment, missing, budget=budget)
        told = rest.told
        if told is not None and told.status is not Status.UNTRUSTED and (told.assignment >= 0).any():
            rest = rest._replace(label=int(labels.max(initial=-1)) + 1)
        searched.append(rest)
        if told is None or rest.label < 0:
            return rest
        matched = told.assignment >= 0
        assignment[rest.points[matched]] = rest.detections[told.assignment[matched]]
        labels[rest.points[matched]] = rest.label
    return None


def restrict_assignments(assignments: Integers, points: Integers, detections: Integers) -> Integers:
    """Assignments (K, n) as those of some points to some detections."""
    wanted = assignments[:, points]
    place = np.searchsorted(detections, wanted).clip(max=len(detections) - 1)
    return np.where(detections[place] == wanted, place, -1)


def join_searches(alone: MatchingTask, searched: Sequence[Rest]) -> DeferredTensor:
    """The hyper-edges of all searches, when they are asked for."""

    def every() -> AffinityTensor:
        detections, found = np.arange(alone.shape[1]), []
        for one in searched:
            if one.told is not None:
                found.append(
                    (one.points, restore_columns(one.told, alone.subset(one.points, detections), one.detections))
                )
        return distinct_hyperedges(join_hyperedges(alone, found))

    return DeferredTensor.of(every, alone.shape, alone.weights)


def search_rest(
    alone: MatchingTask,
    solve: Callable[[MatchingTask], Finding],
    assignment: Integers,
    missing: int = 0,
    *,
    budget: int,
) -> Rest:
    """What the model of one motion finds among the points and detections that an assignment leaves."""
    points = np.flatnonzero(assignment < 0)
    detections = np.setdiff1d(np.arange(alone.shape[1]), assignment[assignment >= 0])
    few = np.zeros(0)
    if missing:
        few = math.exp(PRESENT_ODDS) * _detected_count_distribution(len(points), alone.options.detection_rate)
        few = few[: min(alone.minimal, len(detections)) + 1]
    if min(len(points), len(detections)) < alone.problem.order:
        return Rest(points, detections, None, few, max(missing, 1))
    part = replace(alone.subset(points, detections), budget=budget, weighs_parts=False)
    told = solve(replace(part, options=replace(part.options, solver=None)))
    return Rest(points, detections, told, few, max(missing, 1))


def _detected_count_distribution(count: int, rate: float | None) -> Floats:
    """Probability (count + 1,) that so many of some points are detected: any number alike, unless the rate is known."""
    if rate is None:
        return np.full(count + 1, 1.0 / (count + 1))
    from scipy.stats import binom  # slow to import, rarely needed

    return np.asarray(binom.pmf(np.arange(count + 1), count, rate))
