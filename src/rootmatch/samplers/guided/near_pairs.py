"""The guided search by pairs of a large object: points near each other are tried beside wide pairs.

An image shows a part of a large object: of three hundred points of which twenty are seen, one pair in two hundred is
seen as a whole, and of neighbours one pair in twenty. What a pair predicts is looked up at its neighbours alone, which
are seen where it is, so that a false one ends after a few of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.deadline import Deadline
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided.hypotheses import strongest_assignment
from rootmatch.samplers.guided.local_search import LOOKED_UP, MINIMUM, POINTS, VISIBLE
from rootmatch.samplers.guided.minimal_sets import nearest_neighbours, nearest_other_points
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.refinement import verify_known
from rootmatch.samplers.guided.rivals import LITTLE, RIVAL_MISSED
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.sequential_test import PreparedSets, SequentialTest, prepare_sets, sequential_test
from rootmatch.samplers.guided.visibility import LOST, TriedSets, random_miss_probability

WAVE = 8
"""Near pairs that are tried together: few, as a hundred are often enough. A round value."""
SEEN = 3
"""Neighbours of a near pair that have to be met where it predicts them: chance meets as many once in a hundred sets. A
round value."""
KEPT = 64
"""Most hypotheses of a batch that are kept: of each of several hundred points is remembered. A round value."""


class PairSearch(Search):
    """One search for one motion by pairs, which goes on where it was if it is run again; see `Search`."""

    def __init__(self, task: SamplingTask, options: GuidedOptions, deadline: Deadline | None = None) -> None:
        super().__init__(task, options, deadline)
        self.neighbours = (
            nearest_neighbours(self.positions, LOOKED_UP) if self.n >= MINIMUM else np.empty((self.n, 0), np.int64)
        )
        self.pairs = self._near_pairs()
        self.near, self.waves = False, 0
        """Whether the pairs that are tried are near ones, and how many waves of others were tried."""
        self.done = {False: 0, True: 0}
        """Wide and near pairs that were tried."""
        self.spent = {False: 0, True: 0}
        """Evaluations for them."""
        self.best: Integers | None = None
        """Assignment (n,) of the strongest hypothesis beyond chance, here or in another search."""
        self.strongest = 0.0
        """Evidence of the strongest hypothesis that was solved anew."""
        self._going: Iterator[None] | None = None

    def miss_probability(self, best: Integers) -> float:
        """Probability that a pose which would have been met as often as an assignment was met by no pair."""
        near = (1.0 - (1.0 - LOST) * self._met(best)) ** self.done[True]
        return near * random_miss_probability(self._matched(best), self.n, self.minimal, self.done[False])

    def _met(self, best: Integers) -> float:
        """Share of all near pairs that meet an assignment."""
        return float((best[self.pairs] >= 0).all(axis=1).mean()) if len(self.pairs) else 0.0

    def _matched(self, best: Integers) -> int:
        return max(int((best >= 0).sum()), self.minimal + 1)

    def _near_pairs(self) -> Integers:
        """Pairs (P, 2) of neighbours in random order: one about each point, then another about each."""
        near = self.rng.permuted(self.neighbours[:, : max(POINTS)], axis=1)
        about = [self.rng.permutation(np.column_stack([np.arange(self.n), other])) for other in near.T]
        return np.concatenate(about) if about else np.empty((0, 2), np.int64)

    def _steps(self) -> Iterator[None]:
        """See `Search`."""
        self.hypotheses = [batch for batch in self.hypotheses if len(batch.evidence)]  # to go on after none were found
        self._going = super()._steps() if self._going is None else self._going
        return self._going

    def _waves(self) -> Iterator[Integers]:
        """See `Search`: near pairs and wide ones."""
        wide = super()._waves()
        while True:
            self.near = self._is_turn_of_near()
            if self.near:
                wave = self.pairs[self.done[True] : self.done[True] + WAVE]
            elif (found := next(wide, None)) is None:
                return
            else:
                wave = found
            before, near = self.evaluated, self.near
            yield np.ascontiguousarray(wave)
            self.done[near] += len(wave)
            self.spent[near] += self.evaluated - before

    def _is_turn_of_near(self) -> bool:
        """Whether near pairs are tried next: each gets as much work until one meets a pose, then those that do so more.

        What was missed would be met as often, for the same cost.
        """
        if self.done[True] >= len(self.pairs):
            return False
        if self.best is None or not self.done[False]:
            return self.spent[True] <= self.spent[False]
        share, matched = self._met(self.best), self._matched(self.best)
        wide = matched * (matched - 1) / (self.n * (self.n - 1))
        return share * self.done[True] * self.spent[False] >= wide * self.done[False] * self.spent[True]

    def _prepare_sets(self, points: Integers, arrangements: int) -> PreparedSets:
        """See `Search`; near pairs look up their neighbours."""
        if not self.near:
            return super()._prepare_sets(points, arrangements)
        offset = self.rng.integers(0, arrangements, len(points))
        return prepare_sets(self.tables, points, nearest_other_points(points, self.neighbours), offset)

    def _test(self, wave: int, seen: float = np.inf) -> SequentialTest:
        """See `Search`."""
        if not self.near:
            self.waves += 1
            return super()._test(self.waves - 1, seen)
        minimum = min(self.minimal + SEEN, self.fewest)
        return sequential_test(self.clutter, VISIBLE, 0, minimum=minimum, normals=self.normals)

    def _verify(self, points: Integers, images: Integers) -> None:
        """See `Search`; few of a batch are kept."""
        before = len(self.hypotheses)
        super()._verify(points, images)
        self.hypotheses[before:] = [batch.strongest(KEPT) for batch in self.hypotheses[before:] if len(batch.evidence)]

    def _has_missed_none(self, tried: TriedSets | None, sets_done: int) -> bool:
        """See `Search`: by wide pairs, as what is seen need not be near."""
        return super()._has_missed_none(tried, self.done[False])

    def _has_enough(self) -> bool:
        """See `Search`; also where a pose that explains as much as what was found elsewhere would have been met."""
        self._look_closer()
        own = self.is_beyond_chance()
        if own:
            self.refine()
            self.best = self._cluster_hypotheses()[2].best[0] if self.best is None else self.best
        if self.best is not None and (missed := self.miss_probability(self.best)) <= RIVAL_MISSED:
            self.missed = missed
            return True
        return own and super()._has_enough()

    def _try_rivals(self) -> None:
        """See `Search`; what the search itself may spend now says nothing of what they may."""
        self.budget = max(self.budget, 2 * self.evaluated + LITTLE)
        super()._try_rivals()

    def _look_closer(self) -> None:
        """Solve wide pairs of the strongest hypothesis anew, if none before was as strong: near ones are vague."""
        if self._most_evidence() > self.strongest:
            verify_known(self, strongest_assignment(self.hypotheses)[None])
            self.strongest = self._most_evidence()
