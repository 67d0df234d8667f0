"""The guided search for one motion of a large object: local triples, whose hypotheses grow to the whole object.

Wide triples are tried beside them until one of both finds something: where few points are detected, here and there,
neighbours of a triple are hardly ever among them and do not tell a true one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.deadline import Deadline, Pace
from rootmatch.jit.threads import worthwhile_threads
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided import batches
from rootmatch.samplers.guided.dispatch import hypothesis_kernels
from rootmatch.samplers.guided.listed_triples import Ring, run_listed_tests
from rootmatch.samplers.guided.local_growth import VERIFIED, Lead, PartialVerification, grow_lead
from rootmatch.samplers.guided.minimal_sets import nearest_neighbours, nearest_other_points
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.refinement import SETS
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.sequential_test import prepare_sets, sequential_test
from rootmatch.samplers.guided.visibility import FAILURE

MINIMUM = 50
"""Source points from which local triples are tried; what they find and cost: benchmarks/targets.py. The recorded
headset without its normals, 32 points of which 7 to 12 are seen, takes twice as long by local triples (`rootmatch
benchmark real`, eight scenes: 1.3 against 0.65 s)."""
CROWDED = 1.0
"""`crowding` of the detections from which they are not: they are the vaguest. With 60 points of a surface and σ = 2 px,
local triples take 9 s and wide ones .2 to .4; with σ = 1 px and a crowding of .6 both take .2 s (`rootmatch benchmark
blind`, surfaces from seed 1050)."""
POINTS, IMAGES = (4, 6, 8, 12), (4, 8, 16, 32)
"""Neighbours of a point that triples are taken from, level after level, and neighbours of a detection that are taken as
images; about as much work goes to each. Of neighbours among the nearest four as many images are the nearest four in
seven views of benchmarks/targets.py as of those among eight are the nearest eight, for a fifth of the work."""
LOCAL = 0.5
"""Fraction of the other detections that are tried as images near one at the most: triples of more are not local, and
those of parts of the points (`minimal_sets.sets_of_parts`) are tried as wide ones. A round value."""
SOLVED = 30_000_000
"""Image triples after which wide triples are tried, or the search ends with what it has found: some seconds."""
FIRST_WAVE, LARGEST_WAVE = 4, 64
"""Triples of the first wave of a level, and of the largest; each has twice those of the one before."""
LOOKED_UP = 24
"""Neighbours that a triple predicts in the sequential test."""
VISIBLE = 0.4
"""Fraction of them that is assumed to be detected in the first wave of a level. With 0.6 true triples of the views of
benchmarks/targets.py that show 15 and 22 points were dropped twice as often; with 0.25 all take half as long again."""
WHOLE = 256
"""Source points up to which hypotheses are verified on the whole object at once: it is not much larger then than what
is near a triple."""
LEADS = 2
"""Most local hypotheses beyond chance that grow after each wave."""
ROUNDS, GROWTH = 6, 3.0
"""Most rounds of growth, a bound that is hardly met, and the evidence that another one has to bring."""
MISSED = 0.05
"""Probability of having missed a pose that explains as much, below which the search ends. By construction."""
MAX_MATCHED, RARER = 2.0 / 3.0, 7.0
"""Share of the points, or of the detections if these are fewer, that the best pose matches from which no other explains
much more; and how many times less often one that does may be met: along a row many places fit a pose that is shifted or
stretched. Of 100 railings (40 from seed 151200, 60 from 1200) 19 missed the true pose, and 4 do."""


@dataclass
class Level:
    """Local triples of one size, and how many of them were tried."""

    points: int
    """Neighbours of a point that they are taken from."""
    ring: Ring
    """Their images: the detections near that of the first point."""
    size: int = FIRST_WAVE
    """Triples of the next wave."""
    triples: Integers | None = None
    """(T, 3) all of them, a point and two of its neighbours; made when they are first needed."""
    done: int = 0
    """Triples tried so far."""
    waves: int = 0
    """Waves of triples tried so far."""

    @property
    def ahead(self) -> int:
        """Number of image triples tried so far and in the next wave."""
        return (self.done + self.size) * self.ring.cost

    @property
    def open(self) -> bool:
        """Whether any triples of this level are left."""
        return self.triples is None or self.done < len(self.triples)


class LocalSearch(Search):
    """One search for one motion that begins with local triples; see `Search`."""

    def __init__(self, task: SamplingTask, options: GuidedOptions, deadline: Deadline | None = None) -> None:
        super().__init__(task, options, deadline)
        self.wide, self.spent = False, {False: 0, True: 0}
        """Whether the last triples tried were wide ones, and image triples solved of local and of wide ones."""
        self.sure_sets = SETS  # hypotheses grow by them
        self.neighbours = nearest_neighbours(self.positions, max(*POINTS, LOOKED_UP))
        near, every = nearest_neighbours(self.grid.positions.T, max(IMAGES)), np.arange(self.n_target)
        n, maximum = self.neighbours.shape[1], LOCAL * (self.n_target - 1)
        sizes = [(min(p, n), q) for p, q in zip(POINTS, IMAGES, strict=True) if q <= maximum]
        self.levels = [Level(p, Ring(every, np.ascontiguousarray(near[:, :q]))) for p, q in sizes]
        self.in_parts = self.n > WHOLE
        """Whether hypotheses of local triples are verified near their triple first."""
        self.nearby = False
        """Whether those are verified now."""
        self.partly = PartialVerification(self.tables, self.positions, self.density, self.allowed)
        self.leads: list[Lead] = []
        self.best: Integers | None = None
        """Assignment of a hypothesis beyond chance, the strongest."""
        self.shares = np.zeros(len(self.levels))
        """Fraction of the triples of each level that meet that hypothesis."""

    def _steps(self) -> Iterator[None]:
        """See `Search`: waves of local triples and of wide ones, then of those that find something."""
        pace, wide = Pace(self.deadline, batches.FIRST), super()._steps()
        while not (self.wide and self.is_beyond_chance()):
            level, before = self._next_level(), self.solved
            if self._is_turn_of_wide(level):
                self.wide = True
                if next(wide, self) is self:
                    return
            elif level is None:
                return
            else:
                wanted = min(level.size, max(1, batches.LARGEST // level.ring.cost))
                if (work := pace.block(wanted * level.ring.cost)) == 0:
                    return
                self.wide = False
                self._try_local(level, max(1, work // level.ring.cost))
            self.spent[self.wide] += self.solved - before
            yield
        yield from wide

    def _is_turn_of_wide(self, level: Level | None) -> bool:
        """Whether wide triples are tried next: until something is found they get about as much work as each level."""
        if self.conclusive or level is None:
            return not self.conclusive
        return self.spent[True] * sum(one.open for one in self.levels) < self.spent[False]

    def _has_enough(self) -> bool:
        """Whether a pose that explains as much as the best one would have been met.

        Local triples go on to tell, whatever found it, unless all of them could not; of wide ones see `Search`.
        """
        if not self.is_beyond_chance():
            return False
        if self.wide:
            self._update_miss_probability()
            if self._miss_probability_after([len(self._triples(level)) for level in self.levels]) > MISSED:
                return super()._has_enough()
        self.conclusive, self.wide = True, False
        self._grow()
        self._update_miss_probability()
        matched = 0 if self.best is None else np.count_nonzero(self.best >= 0)
        return bool(self.missed <= MISSED ** (1.0 if matched >= MAX_MATCHED * min(self.shape) else RARER))

    def _try_rivals(self) -> None:
        """See `Search`; local triples would have met them, unless too few of them meet even the best pose."""
        if self.wide or self.missed > MISSED:
            super()._try_rivals()

    def _next_level(self) -> Level | None:
        """The level of the next wave; None if enough triples were tried.

        About as much work goes to each level until something is found, and then to the one that meets it most often
        for its cost: what was missed would be met as often.
        """
        waiting = [number for number, level in enumerate(self.levels) if level.open]
        if not waiting or sum(level.done * level.ring.cost for level in self.levels) >= SOLVED:
            return None
        if self.best is None:
            return self.levels[min(waiting, key=lambda number: self.levels[number].ahead)]
        return self.levels[max(waiting, key=lambda number: self.shares[number] / self.levels[number].ring.cost)]

    def _triples(self, level: Level) -> Integers:
        """All triples (T, 3) of a level, in random order: one about each point, then another about each."""
        if level.triples is not None:
            return level.triples
        pairs = np.array(list(combinations(range(level.points), 2)))
        order = np.argsort(self.rng.random((self.n, len(pairs))), axis=1)
        others = np.take_along_axis(self.neighbours[:, : level.points], pairs[order].reshape(self.n, -1), axis=1)
        first = np.broadcast_to(np.arange(self.n)[:, None, None], (self.n, len(pairs), 1))
        triples = np.concatenate([first, others.reshape(self.n, -1, 2)], axis=2)
        level.triples = np.concatenate([self.rng.permutation(triples[:, turn]) for turn in range(len(pairs))])
        return level.triples

    def _try_local(self, level: Level, count: int) -> None:
        """Test the next ``count`` triples of a level, and verify the survivors of the highest ratio."""
        triples = self._triples(level)
        points = np.ascontiguousarray(triples[level.done : level.done + count])
        solved = len(points) * level.ring.cost
        maximum = batches.listed_verification_count(solved)
        others = nearest_other_points(points, self.neighbours)
        sets = prepare_sets(self.tables, points, others, np.zeros(len(others), np.int64))
        # ever more patient with hidden points
        test = sequential_test(self.clutter, VISIBLE, level.waves, minimum=self.minimal + 1, normals=False)
        survivors, ratios, counts = run_listed_tests(
            self.tables, self.grid, test, sets, level.ring, allowed=self.allowed,
            keep=batches.survivors_per_chunk(maximum), chunks=batches.CHUNKS,
            threads=worthwhile_threads(solved // batches.WORTH_A_THREAD),
        )  # fmt: skip
        self.nearby = self.in_parts
        self._keep(points, survivors, ratios, counts, maximum)
        self.nearby = False
        self._follow()
        level.done, level.waves = level.done + len(points), level.waves + 1
        level.size = min(2 * level.size, LARGEST_WAVE)

    def _verify(self, points: Integers, images: Integers) -> None:
        """Verify as `Search` does; local triples of a large object near each: what is beyond chance becomes a lead."""
        if not self.nearby:
            super()._verify(points, images)
            return
        level = self._false_alarm_level()
        for first in np.unique(points[:, 0]).tolist():
            own = np.flatnonzero(points[:, 0] == first)
            near = self.partly.nearest(first, VERIFIED)
            found = self.partly(near, points[own], images[own])
            self.evaluated += len(own) * len(near)
            for k in np.flatnonzero(found.evidence > level).tolist():
                self.leads.append(Lead(float(found.evidence[k]), found.points[k], found.images[k, 1:], found.best[k]))

    def _follow(self) -> None:
        """Let the strongest leads grow, those that are no part of a hypothesis that did."""
        known = [batch.best[int(batch.evidence.argmax())] for batch in self.hypotheses]
        followed = 0
        for lead in sorted(self.leads, key=lambda lead: -lead.evidence):
            if followed == LEADS or self.deadline.passed():
                break
            if any(np.array_equal(best[lead.points], lead.images) for best in known):
                continue
            found, looked_up = grow_lead(
                lead, self.partly, self._false_alarm_level(), hypothesis_kernels(self.tables).solutions, self.rng
            )
            self.evaluated += looked_up
            followed += 1
            if len(found.evidence):
                self.hypotheses.append(found)
                known.append(found.best[int(found.evidence.argmax())])
        self.leads = []

    def _grow(self) -> None:
        """Refine the best clusters until they grow no more: each round reaches farther than the one before."""
        strongest = -math.inf
        for _ in range(0 if self.in_parts else ROUNDS):
            self.refined_at = -1
            self.refine()
            before, strongest = strongest, float(self._cluster_hypotheses()[2].evidence[0])
            if strongest <= before + GROWTH:
                return

    def _update_miss_probability(self) -> None:
        """Find the probability that a pose which explains as much as the best one was met by none of the triples tried.

        It is met by as many as the best one is: those with all three points matched, to images near each other.
        """
        best = self._cluster_hypotheses()[2].best[0]
        if self.best is None or not np.array_equal(best, self.best):
            self.best = best
            self.shares = np.array([self._met(self._triples(level), level.ring, best) for level in self.levels])
        self.missed = self._miss_probability_after([level.done for level in self.levels])

    def _miss_probability_after(self, tried: list[int]) -> float:
        """Probability that none of so many triples of each level met a pose that is met as often as the best one."""
        return float(np.prod((1.0 - (1.0 - FAILURE) * self.shares) ** np.array(tried)))

    def _met(self, triples: Integers, ring: Ring, best: Integers) -> float:
        """Fraction of some triples that meet an assignment."""
        matched = triples[(best[triples] >= 0).all(axis=1)]
        near = ring.near[best[matched[:, 0]]]
        met = (near == best[matched[:, 1], None]).any(axis=1) & (near == best[matched[:, 2], None]).any(axis=1)
        return float(met.sum()) / len(triples)
