"""The search for motions between two point sets: triples of source points, and the triples of targets like them.

Three points give the motion. A wide triple of source points is compared with the triangles of the targets: pairs of
targets as far apart as its first two points are looked up in a sorted list, third ones are those at the right distances
from both. Few triangles are alike by chance; the motion of each is judged by how many of all points it explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import Deadline, checkpoint
from rootmatch.problems.points import PointClouds, distances
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided.hypotheses import HypothesisClusters
from rootmatch.samplers.point_sets.motions import Motions, fitted_motions

ROUNDS = 4
"""Rounds in which a motion is fitted to the points that it explains; the gate narrows from one to the next."""
BLOCK = 64
"""Motions that are judged together, at most."""
SECONDS_PER_PAIR = 1e-7
"""Time to sort a pair of targets by distance, for looking it up."""
ENTRIES = 2_000_000
"""Pairs of points that are compared at once, so that a block of them takes some ten milliseconds."""

TRIPLES, LEAST = 6_000, 12
"""Most triples of source points that are tried, and least, however clear the best motion is: three of ten matched
points in a hundred are among so many with 99.5 %."""
DRAWS = 4
"""Random triples of which the widest is tried: fewer are flat, more are all at the rim."""
MISSED = 0.005
"""Probability at which a motion that explains as many points as the best one may have been missed."""
GATE, WIDE_GATE = 3.7, 8.0
"""Deviation in σ up to which distances within a triple agree (of 10,000 right ones two are lost), and within which a
point counts for the motion of a triple, whose own error it covers too."""
PAIRS = 20_000
"""Most pairs of targets that are tried for a side; a seeded selection of more."""
REFINED = 4
"""Motions of a triple, those that explain the most points, that are refined on these points."""
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
    ratios: Floats
    """(n, n') logarithm of the likelihood of each correspondence over that by chance; −∞ beyond the gate."""


class MotionSearch:
    """Motions between the point sets of a task, the highest evidence first."""

    def __init__(self, task: SamplingTask, clouds: PointClouds, deadline: Deadline) -> None:
        self.clouds, self.deadline, self.task = clouds, deadline, task
        self.rng = np.random.default_rng(task.seed)
        self.n, self.n_target = task.shape
        self.dimension = clouds.source.shape[1]
        self.near, self.far = distances(clouds.source), distances(clouds.target)
        checkpoint(SECONDS_PER_PAIR * self.n_target**2)
        self.allowed = task.candidates
        first, second = np.triu_indices(self.n_target, 1)
        order = np.argsort(self.far[first, second], kind="stable")
        self.pairs = np.stack([first[order], second[order]], axis=1)
        self.lengths = self.far[self.pairs[:, 0], self.pairs[:, 1]]
        variance = clouds.target_variance
        self.widest = math.sqrt(2.0 * float(variance.max()) + 2.0 * float(clouds.source_variance.max()))
        # the density of detections that chance spreads over the box of the targets
        box = np.ptp(clouds.target, axis=0)
        box = np.maximum(box * (self.n_target + 1) / (self.n_target - 1), 2.0 * np.sqrt(2.0 * np.pi * variance.max()))
        self.log_density = math.log(self.n_target) - float(np.log(box).sum())
        self.hypotheses: list[MotionHypothesis] = []
        self.evaluated = self.judged = self.tried = 0
        self._whole: set[frozenset[int]] = set()
        """Triples that were compared with all triangles of the targets: once more would find nothing new."""

    @property
    def level(self) -> float:
        """Evidence that chance may reach."""
        return math.log(self.judged + 1.0) + BEYOND

    @property
    def conclusive(self) -> bool:
        """Whether the best motion is beyond chance."""
        return bool(self.hypotheses) and self.hypotheses[0].evidence > self.level

    def run(self, budget: int = 500_000_000) -> None:
        """Try triples until a motion as good as the best one can hardly have been missed, or the budget is spent."""
        while self.tried < TRIPLES and self.evaluated < budget and not self.deadline.passed():
            if self.tried >= LEAST and self._finished():
                return
            triple = self._triple()
            key = frozenset(triple.tolist())
            # few points have few triples, which are drawn again and again
            if key not in self._whole:
                if self._sees_all_pairs(triple):
                    self._whole.add(key)
                self._take(triple, self._alike(triple))
            self.tried += 1
            if self.task.progress is not None and self.tried % BLOCK == 0:
                self.task.progress(self.tried, TRIPLES)

    def _finished(self) -> bool:
        """Whether a motion that explains as many points would have been found, at least once, by now."""
        if self.task.motions != 1 or not self.conclusive:
            return False
        matched = float((self.hypotheses[0].assignment >= 0).mean())
        return self.tried * math.log1p(-min(matched**3, 1.0 - 1e-12)) < math.log(MISSED)

    def _triple(self) -> Integers:
        """The widest of some random triples, by area."""
        drawn = self.rng.integers(0, self.n, (DRAWS, 3))
        a, b, c = drawn.T
        sides = np.sort(np.stack([self.near[a, b], self.near[b, c], self.near[a, c]]), axis=0)
        # Heron: 16 times the squared area, 0 for a point drawn twice
        low, middle, high = sides
        area = (low + middle + high) * (low + middle - high) * (high + low - middle) * (high + middle - low)
        return np.asarray(drawn[int(np.argmax(area))], dtype=np.int64)

    def _pairs_as_long(self, length: float) -> Integers:
        """Pairs of targets (P, 2) that may be two source points so far apart; all where the scale is unknown."""
        if self.clouds.scaled:
            return self.pairs
        window = GATE * self.widest
        low, high = np.searchsorted(self.lengths, [length - window, length + window])
        return self.pairs[low:high]

    def _sees_all_pairs(self, triple: Integers) -> bool:
        """Whether none of the pairs is left out for being too many, whichever two of the points come first."""
        a, b, c = triple.tolist()
        sides = (self.near[a, b], self.near[b, c], self.near[a, c])
        return max(len(self._pairs_as_long(side)) for side in sides) <= PAIRS

    def _alike(self, triple: Integers) -> Integers:
        """Triples of targets (H, 3) whose triangle is that of the source points, up to noise."""
        a, b, c = triple.tolist()
        if len({a, b, c}) < 3:
            return np.empty((0, 3), np.int64)
        clouds = self.clouds
        ab, ac, bc = self.near[a, b], self.near[a, c], self.near[b, c]
        pairs = self._pairs_as_long(ab)
        if len(pairs) > PAIRS:
            pairs = pairs[np.sort(self.rng.permutation(len(pairs))[:PAIRS])]
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        if self.allowed is not None:
            pairs = pairs[self.allowed[a, pairs[:, 0]] & self.allowed[b, pairs[:, 1]]]
        self.evaluated += len(pairs) * self.n_target
        u, v = clouds.source_variance, clouds.target_variance
        k, l = pairs.T  # noqa: E741
        length = self.far[k, l]
        scale = length / ab if clouds.scaled else np.ones(len(pairs))
        own = v[k] + v[l] + scale**2 * (u[a] + u[b])
        alike = np.abs(length - scale * ab) <= GATE * np.sqrt(own)
        k, l, scale, own = k[alike], l[alike], scale[alike, None], own[alike, None]  # noqa: E741
        # an unknown scale has the noise of the side that it is taken from
        of_scale = own / ab**2 if clouds.scaled else np.zeros_like(own)
        third = np.ones((len(k), self.n_target), np.bool_)
        step = max(1, ENTRIES // self.n_target)
        for first in range(0, len(k), step):
            checkpoint()
            rows = slice(first, first + step)
            for corner, image, side in ((a, k[rows], ac), (b, l[rows], bc)):
                variance = v[image][:, None] + v + scale[rows] ** 2 * (u[corner] + u[c]) + of_scale[rows] * side**2
                third[rows] &= (self.far[image] - scale[rows] * side) ** 2 <= GATE**2 * variance
        if self.allowed is not None:
            third &= self.allowed[c]
        row, m = np.nonzero(third)
        k, l = k[row], l[row]  # noqa: E741
        distinct = (m != k) & (m != l)
        found: Integers = np.stack([k, l, m], axis=1)[distinct]
        if self.dimension == 2 and not clouds.mirror:
            turns = _turn(clouds.target[found]) * _turn(clouds.source[triple][None])
            found = found[turns > 0.0]
        return found

    def _take(self, triple: Integers, images: Integers) -> None:
        """Judge the motions that take the triple onto its images; refine and keep the best."""
        clouds = self.clouds
        if not len(images):
            return
        counts, every = np.empty(len(images)), []
        block = max(1, min(BLOCK, ENTRIES // (self.n * self.n_target)))
        for start in range(0, len(images), block):
            checkpoint()
            part = slice(start, start + block)
            target = clouds.target[images[part]]
            source = np.broadcast_to(clouds.source[triple], target.shape)
            every.append(fitted_motions(source, target, clouds.scaled, clouds.mirror))
            squared, variance = every[-1].squares(clouds)
            close = squared <= WIDE_GATE**2 * variance
            if self.allowed is not None:
                close &= self.allowed
            # as many as have one, of either set
            counts[part] = np.minimum(close.any(axis=2).sum(axis=1), close.any(axis=1).sum(axis=1))
        self.judged += len(images)
        self.evaluated += len(images) * self.n
        for one in np.argsort(-counts, kind="stable")[:REFINED].tolist():
            if counts[one] > 3:
                self._refine(every[one // block].take(np.array([one % block])))

    def _refine(self, motion: Motions) -> None:
        """Fit a motion to the points that it explains, several times, and keep it if it is among the best."""
        clouds = self.clouds
        gates = np.geomspace(WIDE_GATE, GATE, ROUNDS)
        for gate in gates.tolist():
            checkpoint()
            squared, variance = (part[0] for part in motion.squares(clouds))
            ratios = self._ratios(squared, variance, gate)
            members, images = _mutual(ratios)
            if len(members) <= 3:
                return
            weight = 1.0 / variance[members, images]
            motion = fitted_motions(
                clouds.source[members][None], clouds.target[images][None], clouds.scaled, clouds.mirror, weight[None]
            )
        squared, variance = (part[0] for part in motion.squares(clouds))
        ratios = self._ratios(squared, variance, GATE)
        members, images = _mutual(ratios)
        worth = np.sort(ratios[members, images])
        assignment = np.full(self.n, -1, np.int64)
        assignment[members] = images
        evidence = float(worth[:-3].sum())
        if any(np.array_equal(assignment, other.assignment) for other in self.hypotheses):
            return
        self.hypotheses.append(MotionHypothesis(evidence, assignment, ratios))
        self.hypotheses.sort(key=lambda one: -one.evidence)
        del self.hypotheses[KEPT:]

    def _ratios(self, squared: Floats, variance: Floats, gate: float) -> Floats:
        """Log-likelihood ratios (n, n') of correspondences against chance; −∞ beyond the gate."""
        with np.errstate(divide="ignore"):
            log = -0.5 * (squared / variance + self.dimension * np.log(2.0 * np.pi * variance)) - self.log_density
        possible = squared <= gate**2 * variance
        if self.allowed is not None:
            possible &= self.allowed
        # where chance puts targets as near, a match says nothing, and nothing against the motion
        return np.where(possible, np.maximum(log, 0.0), -np.inf)

    def clusters(self) -> HypothesisClusters:
        """The motions that are kept, each with the targets that its points may have."""
        width = min(CANDIDATES, self.n_target)
        lists = np.full((len(self.hypotheses), self.n, width), -1, np.int64)
        for g, one in enumerate(self.hypotheses):
            order = np.argsort(-one.ratios, axis=1, kind="stable")[:, :width]
            lists[g] = np.where(np.isfinite(np.take_along_axis(one.ratios, order, axis=1)), order, -1)
        evidence = np.array([one.evidence for one in self.hypotheses])
        return HypothesisClusters(lists, evidence, self.level)

    def assignments(self) -> Integers:
        """Assignments (K, n) of the motions, the highest evidence first."""
        return np.array([one.assignment for one in self.hypotheses], np.int64).reshape(-1, self.n)


def _turn(corners: Floats) -> Floats:
    """Twice the signed areas (H,) of triangles (H, 3, 2)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _mutual(ratios: Floats) -> tuple[Integers, Integers]:
    """Correspondences that are the best of both of their points."""
    forward, back = ratios.argmax(axis=1), ratios.argmax(axis=0)
    members = np.flatnonzero((back[forward] == np.arange(len(ratios))) & np.isfinite(ratios.max(axis=1)))
    return members, forward[members]
