"""The search for motions between two point sets: triples of either set, and the triples of the other like them.

Three points give the motion. A triple of one set is compared with the triangles of the other, see
`rootmatch.samplers.point_sets.triangles`. Few triangles are alike by chance; the motion of each is judged by how many
of all points it explains. Triples are drawn from both sets in turn: all of one lie in what both sets show, and only a
few of the other where that is large; see `rootmatch.samplers.point_sets.shown_parts`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import Deadline, checkpoint
from rootmatch.problems.points import PointClouds
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided.hypotheses import HypothesisClusters
from rootmatch.samplers.guided.visibility import MISSED
from rootmatch.samplers.point_sets.motions import WIDE, Motions, concatenate_motions, fit_motions, fit_triangles
from rootmatch.samplers.point_sets.place_grid import PlaceGrid
from rootmatch.samplers.point_sets.shown_parts import ShownParts
from rootmatch.samplers.point_sets.triangles import GATE, Triangles

ROUNDS = 4
"""Rounds in which a motion is fitted to the points that it explains; the gate narrows from one to the next."""
FITTED = 5_000
"""Motions of triples that are fitted at once."""
TRIPLES, MINIMUM, BLOCK = 6_000, 12, 64
"""Most triples that are tried, and least, however clear the best motion is, and how many at once later on: three of ten
matched points in a hundred are among so many with 99.5 %."""
BLOCKS = 50
"""Part of the budget that the motions of triples which are tried at once take at most. A round value: where the noise
tells triples apart, as it nearly always does, they take a hundredth of that."""
REFINED = 4
"""Motions of a triple, those that explain the most points, that are refined on these points."""
WORTH = 0.5
"""Share of the matches of the best motion that another one has to explain to be refined. A round value: evidence grows
with each match beyond three, so that half as many are never of account."""
TOGETHER, GROWTH = 256, 8
"""Most of them that are refined at once, and how many times as many as before. Round values."""
KEPT, CANDIDATES = 20, 3
"""Distinct motions that are kept, and targets that a point may have in each."""
BEYOND = 5.0
"""Evidence by which the best motion has to exceed the logarithm of the motions tried: e⁻⁵ is 0.7 %."""


@dataclass(frozen=True, eq=False)
class MotionHypothesis:
    """A motion that was refined on the points which it explains."""

    evidence: float
    """Log-likelihood ratio of its matches against chance, without those of three of them."""
    assignment: Integers
    """(n,) target of each source point, −1 for none."""
    motion: Motions
    """The one motion."""


class MotionSearch:
    """Motions between the point sets of a task, the highest evidence first."""

    def __init__(self, task: SamplingTask, clouds: PointClouds, deadline: Deadline) -> None:
        self.clouds, self.deadline, self.task = clouds, deadline, task
        self.rng = np.random.default_rng(task.seed)
        self.n, self.n_target = task.shape
        self.dimension = clouds.source.shape[1]
        self.allowed = task.candidates
        self.triangles = (
            Triangles(clouds.source, clouds.source_variance, clouds.scaled),
            Triangles(clouds.target, clouds.target_variance, clouds.scaled),
        )
        points = (clouds.source, clouds.target)
        self.parts = [ShownParts(own, of.far, self.rng) for own, of in zip(points, self.triangles, strict=True)]
        self.places = PlaceGrid(clouds, WIDE, self.allowed)
        # the density of detections that chance spreads over the box of the targets
        variance = clouds.target_variance.max()
        box = np.ptp(clouds.target, axis=0)
        box = np.maximum(box * (self.n_target + 1) / (self.n_target - 1), 2.0 * np.sqrt(2.0 * np.pi * variance))
        self.log_density = math.log(self.n_target) - float(np.log(box).sum())
        minimum = clouds.target_variance.min() + (0.0 if clouds.scaled else clouds.source_variance.min())
        self.maximum = max(-0.5 * self.dimension * math.log(2.0 * math.pi * minimum) - self.log_density, 1e-9)
        """Log-likelihood ratio of a match that is exactly in its place."""
        self.hypotheses: list[MotionHypothesis] = []
        self.evaluated = self.judged = self.tried = 0

    @property
    def level(self) -> float:
        """Evidence that chance may reach."""
        return math.log(self.judged + 1.0) + BEYOND

    @property
    def conclusive(self) -> bool:
        """Whether the best motion is beyond chance."""
        return bool(self.hypotheses) and self.hypotheses[0].evidence > self.level

    @property
    def missed(self) -> float:
        """Probability that a motion which explains as much as the best one was never met."""
        return self._miss_probability(self.hypotheses[0].evidence) if self.hypotheses else 1.0

    @property
    def is_over(self) -> bool:
        """Whether a motion beyond chance with as much evidence as the best one can hardly have been missed."""
        best = self.hypotheses[0].evidence if self.hypotheses else 0.0
        return self._miss_probability(max(best, self.level)) < MISSED

    def _miss_probability(self, evidence: float) -> float:
        """Probability that a motion with so much evidence, by matches that noise puts off their places, was not met."""
        matched = 3 + math.ceil(evidence / max(self.maximum - 0.5 * self.dimension, 1e-9))
        return math.prod(part.missed(matched) for part in self.parts)

    def run(self, budget: int = 500_000_000) -> None:
        """Try triples until a motion as good as the best one can hardly have been missed, or the budget is spent.

        Where none is beyond chance, one with as much evidence as that takes must not have been missed either.
        """
        # those of the smaller set first: more of them lie in what both sets show
        sides = (0, 1) if self.n <= self.n_target else (1, 0)
        count = MINIMUM
        maximum = max(budget // BLOCKS // self.places.cost, 1)
        while self.tried < TRIPLES and self.evaluated < budget and not self.deadline.passed():
            for side in sides:
                self._try(side, self.parts[side].triples(count), maximum)
                if any(part.is_exhausted for part in self.parts):
                    return
                if self.task.motions == 1 and self.is_over:
                    return
            count = min(2 * count, BLOCK)
            if self.task.progress is not None:
                self.task.progress(min(self.tried, TRIPLES), TRIPLES)

    def _try(self, side: int, triples: Integers, maximum: int) -> None:
        """Look for triples (T, 3) of one set, 0 of the source, in the other one, and judge so many motions at most.

        Those of the triples with the fewest come first, as it takes as long to judge one that is vague.
        """
        clouds, (own, other) = self.clouds, self.triangles[:: 1 if side == 0 else -1]
        allowed = self.allowed if side == 0 or self.allowed is None else self.allowed.T
        found = other.alike(triples, own.far, own.variance, allowed, self.rng)
        self.evaluated += found.compared
        number, corners, share = found.number, found.corners, found.share
        if len(number) > maximum:
            kept, taken = _share_out(number, len(triples), maximum, self.rng)
            number, corners, share = number[kept], corners[kept], share * taken
        self.tried += int(np.count_nonzero(share))
        sources, images = (triples[number], corners)[:: 1 if side == 0 else -1]
        if self.dimension == 2 and not clouds.mirror:
            right = _turn(clouds.target[images]) * _turn(clouds.source[sources]) > 0.0
            sources, images, number = sources[right], images[right], number[right]
        self._take(number, sources, images)
        self.parts[side].add(triples, share)

    def _take(self, number: Integers, sources: Integers, images: Integers) -> None:
        """Judge the motions that take triples (H, 3) onto images, by their triples; refine and keep the best."""
        clouds = self.clouds
        self.judged += len(images)
        self.evaluated += len(images) * self.places.cost
        motions = concatenate_motions(
            [
                fit_triangles(clouds.source[sources[part]], clouds.target[images[part]], clouds.scaled, clouds.mirror)
                for part in _slices(len(images), FITTED)
            ]
        )
        counts = self.places.explained(motions)
        # the best ones of each triple
        order = np.lexsort((-counts, number))
        ordered = number[order]
        rank = np.arange(len(order)) - np.searchsorted(ordered, ordered)
        chosen = order[(rank < REFINED) & (counts[order] > 3)]
        if not len(chosen):
            return
        chosen, at = chosen[np.argsort(-counts[chosen], kind="stable")], 0
        together = 1  # few at first: where one of them is right, hardly any other is of account
        while at < len(chosen):
            some = chosen[at : at + together]
            some = some[self._are_new(sources[some], images[some], counts[some])]
            if len(some):
                self._refine(motions.take(some))
            at, together = at + together, min(GROWTH * together, TOGETHER)

    def _are_new(self, triples: Integers, images: Integers, explained: Integers) -> Bools:
        """Whether the motions of triples (H, 3) may be none of those that are kept, and of account beside them."""
        minimum = 0.0
        if self.task.motions == 1 and self.conclusive:
            minimum = WORTH * np.count_nonzero(self.hypotheses[0].assignment >= 0)
        if len(self.hypotheses) == KEPT:  # with so many it could at best be kept
            minimum = max(minimum, 3.0 + self.hypotheses[-1].evidence / self.maximum)
        known = (self.assignments()[:, triples] == images).all(axis=2).any(axis=0)
        return np.asarray((explained >= minimum) & ~known)

    def _refine(self, motions: Motions) -> None:
        """Fit motions to the points that each explains, several times, and keep those that are among the best."""
        clouds = self.clouds
        for gate in np.geomspace(WIDE, GATE, ROUNDS).tolist():
            checkpoint()
            ratios, images, variance = self._matched(motions, gate)
            enough = (images >= 0).sum(axis=1) > 3
            if not enough.any():
                return
            images, own = images[enough], variance[enough]
            sources = np.broadcast_to(clouds.source, (len(images), *clouds.source.shape))
            weight = np.where(images >= 0, 1.0 / own, 0.0)
            motions = fit_motions(sources, clouds.target[images], clouds.scaled, clouds.mirror, weight)
        ratios, images, _ = self._matched(motions, GATE)
        evidence = np.sort(ratios, axis=1)[:, :-3].sum(axis=1)
        for k in range(len(images)):
            self._keep(float(evidence[k]), images[k], motions.take(slice(k, k + 1)))

    def _matched(self, motions: Motions, gate: float) -> tuple[Floats, Integers, Floats]:
        """Of each point (H, n) that is the best one of its best target: the ratio, that target and the variance.

        Of others 0, −1 and 1.
        """
        found = self.places.pairs(motions)
        found = found.take(found.square <= gate**2 * found.variance)
        ratio = self._ratios(found.square, found.variance)
        first = found.motion * self.n + found.source, found.motion * self.n_target + found.target
        best = np.ones(len(ratio), np.bool_)
        for own, other in (first, first[::-1]):
            order = np.lexsort((other, -ratio, own))
            best[order[1:][own[order[1:]] == own[order[:-1]]]] = False
        h, i = found.motion[best], found.source[best]
        ratios, images, variance = (np.full((len(motions.scale), self.n), fill) for fill in (0.0, -1, 1.0))
        ratios[h, i], images[h, i], variance[h, i] = ratio[best], found.target[best], found.variance[best]
        return ratios, images, variance

    def _keep(self, evidence: float, assignment: Integers, motion: Motions) -> None:
        """Keep a motion, of which the evidence and the assignment are given, if it is among the best."""
        if len(self.hypotheses) == KEPT and evidence <= self.hypotheses[-1].evidence:
            return
        if any(np.array_equal(assignment, other.assignment) for other in self.hypotheses):
            return
        self.hypotheses.append(MotionHypothesis(evidence, assignment, motion))
        self.hypotheses.sort(key=lambda one: -one.evidence)
        del self.hypotheses[KEPT:]

    def _ratios(self, squared: Floats, variance: Floats) -> Floats:
        """Log-likelihood ratios of correspondences against chance."""
        with np.errstate(divide="ignore"):
            log = -0.5 * (squared / variance + self.dimension * np.log(2.0 * np.pi * variance)) - self.log_density
        # where chance puts targets as near, a match says nothing, and nothing against the motion
        return np.asarray(np.maximum(log, 0.0))

    def clusters(self) -> HypothesisClusters:
        """The motions that are kept, each with the targets that its points may have."""
        width = min(CANDIDATES, self.n_target)
        lists = np.full((len(self.hypotheses), self.n, width), -1, np.int64)
        for g, one in enumerate(self.hypotheses):
            squared, variance = (part[0] for part in one.motion.squares(self.clouds))
            possible = squared <= GATE**2 * variance
            if self.allowed is not None:
                possible &= self.allowed
            ratios = np.where(possible, self._ratios(squared, variance), -np.inf)
            order = np.argsort(-ratios, axis=1, kind="stable")[:, :width]
            lists[g] = np.where(np.isfinite(np.take_along_axis(ratios, order, axis=1)), order, -1)
        evidence = np.array([one.evidence for one in self.hypotheses])
        return HypothesisClusters(lists, evidence, self.level)

    def assignments(self) -> Integers:
        """Assignments (K, n) of the motions, the highest evidence first."""
        return np.array([one.assignment for one in self.hypotheses], np.int64).reshape(-1, self.n)


def _share_out(number: Integers, count: int, maximum: int, rng: np.random.Generator) -> tuple[Bools, Floats]:
    """Which of the motions of ``count`` triples, of which the numbers (H,) are given, are judged, and each one's share.

    All of the triples that have the fewest, and a seeded selection of the next one's.
    """
    alike = np.bincount(number, minlength=count)
    order = np.argsort(alike, kind="stable")
    taken = np.empty_like(alike)
    taken[order] = np.diff(np.minimum(np.cumsum(alike[order]), maximum), prepend=0)
    kept = (taken == alike)[number]
    for part in np.flatnonzero((taken > 0) & (taken < alike)).tolist():
        kept[rng.choice(np.flatnonzero(number == part), taken[part], replace=False)] = True
    return kept, np.where(alike > 0, taken / np.maximum(alike, 1), 1.0)


def _slices(count: int, step: int) -> list[slice]:
    """Slices of so many rows at most; one that is empty where there are none."""
    return [slice(start, start + step) for start in range(0, max(count, 1), step)]


def _turn(corners: Floats) -> Floats:
    """Twice the signed areas (H,) of triangles (H, 3, 2)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
