"""The guided search: a loop over a source of minimal sets, until a hypothesis is beyond chance or the budget is spent.

The sets are tested batch by batch, the best survivors are verified, and a rule tells when to stop. This class takes
wide sets; `visible_search` and `local_search` have the other sources.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import Deadline, Pace, checkpoint
from rootmatch.hypergraph import enumeration
from rootmatch.jit.threads import worthwhile_threads
from rootmatch.problems.padding import pad_tables
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided import batches, rivals, visibility
from rootmatch.samplers.guided.crowding import CROWDING
from rootmatch.samplers.guided.detection_grid import grid_of
from rootmatch.samplers.guided.hypotheses import (
    Hypotheses,
    HypothesisClusters,
    recurrence_miss_probability,
    strongest_assignment,
)
from rootmatch.samplers.guided.hypothesis_clustering import cluster
from rootmatch.samplers.guided.minimal_sets import alternate, minimal_sets, remaining_points, sets_of_parts
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.refinement import SETS, SURE_SETS, refine_clusters
from rootmatch.samplers.guided.sequential_test import (
    VISIBLE,
    VISIBLE_OF_MANY,
    PreparedSets,
    SequentialTest,
    prepare_sets,
    run_sequential_tests,
    sequential_test,
)
from rootmatch.samplers.guided.stopping import false_alarm_level, has_found_enough, min_telling_matches
from rootmatch.samplers.guided.survivors import Survivors
from rootmatch.samplers.guided.verification import CANDIDATES, allowed_shares, verify
from rootmatch.samplers.guided.visibility import MISSED, TriedSets, covering_waves, detected_views

VERIFIED = 10_000_000
"""Pairs of a prediction and a detection that are compared between two looks at the time: some milliseconds."""
GROUPS = 1000
"""Most clusters of hypotheses whose hyper-edges are evaluated."""
LAG = 15.0
"""Evidence below the highest at which an assignment is not fitted any more; the most probable one lagged by 7 or less
(tuning seeds of benchmarks/constellations.py)."""
RIVAL_EVIDENCE = 0.5
"""Fraction of the highest evidence from which another hypothesis is a rival."""


class Search:
    """One search and its hypotheses so far.

    Parameters
    ----------
    task : SamplingTask
    options : GuidedOptions
    deadline : Deadline, optional
        When the search ends, unless the options say earlier; that of the task by default.
    """

    def __init__(self, task: SamplingTask, options: GuidedOptions, deadline: Deadline | None = None) -> None:
        self.deadline = (task.deadline if deadline is None else deadline).at_most(options.max_seconds)
        tables, motions = task.tables, task.motions
        self.tables, self.options, self.progress = tables, options, task.progress
        self.budget = options.budget  # less for the last part of a search
        self.n, self.n_target = self.shape = task.shape
        self.padded = pad_tables(tables, self.n_target)
        self.single = motions == 1
        self.motions = math.inf if motions == "auto" else float(motions)
        self.minimal = task.order - 1
        self.rng = np.random.default_rng([task.seed, *task.shape])
        self.allowed = task.allowed
        self.normals = bool(tables.normals[:3].any())
        self.grid = grid_of(tables.rays, np.sqrt(tables.variance), narrow=not self.normals)
        self.density = CROWDING * self.grid.density
        one_pair = 1.0 / (self.n * self.n_target)
        share = max(float(allowed_shares(self.allowed, self.n).mean()), one_pair)
        self.clutter = float(self.density.mean()) * math.pi * self.grid.gate2 * share
        """Mean number of clutter detections within a gate, of those that a point may have."""
        self.possible = share**self.minimal
        """Share of the images of a minimal set that its points may have, as if they may have theirs independently."""
        sets = self.possible * math.comb(self.n, self.minimal) * math.perm(self.n_target, self.minimal)
        self.fewest = min(min_telling_matches(self.density, tables.variance, self.minimal, sets), *self.shape)
        """Fewest matches that tell a pose from chance: a search need not go on for one that has fewer."""
        self.facing, self.view_cosine = np.ascontiguousarray(tables.normals[:3].T), task.view_cosine
        self.positions = np.ascontiguousarray(tables.points.T)
        self.solved = self.tested = self.evaluated = 0
        self.refined_at, self.refined_clusters = -1, 0
        self.sure_sets = SURE_SETS if self.single and not self.normals else SETS
        """Minimal sets solved anew of a cluster that is beyond chance."""
        self.drawn: list[Hypotheses] = []
        """Those of sets that were drawn, not made of what is known."""
        self._known: tuple[Integers, Integers, Hypotheses] | None = None
        self.hypotheses: list[Hypotheses] = []
        self.conclusive, self.missed = False, 1.0
        """Whether it ended in want of nothing, and the probability of having missed a pose as good as its best."""

    def run(self) -> None:
        """Batch after batch until enough is found, every minimal set was tried, or the budget is spent."""
        for _ in self._steps():
            if self.progress is not None:
                self.progress(min(self.evaluated, self.budget), self.budget)
            if not self.deadline.passed() and self._has_enough():
                self.conclusive = True  # also by the batch that spends the budget
                break
            if self._is_spent():
                return
            if len(self.hypotheses) > batches.APART:
                self._cluster_hypotheses()
        if self.conclusive and self.is_beyond_chance():  # what looks like itself has more poses than a batch verifies
            self._try_rivals()
        elif self.conclusive and self._best_match_count() >= self.options.stopping.complete * min(self.shape):
            rivals.try_elsewhere(self)  # it ended as no pose explains more; as probable is one that shows a point less

    def _steps(self) -> Iterator[None]:
        """Test batches of minimal sets, one a step, until none is left, none is needed or a deadline has passed."""
        arrangements = enumeration.shuffled_arrangements(self.rng, self.n_target, self.minimal - 1)
        whole = len(arrangements) == math.perm(self.n_target, self.minimal - 1)
        one_of_many = self.single and not self.normals
        batch = batches.START if one_of_many else batches.FIRST
        pace = Pace(self.deadline, batches.CHUNKS)
        tried, sets_done, solved = self._tried(), 0, 0
        for wave, points in enumerate(self._waves()):
            sets = self._prepare_sets(points, len(arrangements))
            test = self._test(wave)
            tasks, done = len(points) * len(arrangements), 0
            while done < tasks:
                wanted = max(batches.CHUNKS, int(batch / (self.possible * (self.n_target - self.minimal + 1))))
                last = min(tasks, done + pace.block(wanted))
                if last == done:
                    return
                before = self.solved
                self._try(sets, test, arrangements, first=done, last=last)
                solved += self.solved - before  # where others are tried between these, without them
                done, batch = last, batches.next_batch(batch, solved if one_of_many else None)
                yield
            if whole:
                sets_done += len(points)
                if tried is not None:
                    tried.add(points)
                if self._has_missed_none(tried, sets_done):
                    self.conclusive = True
                    return
        if whole:
            self.missed = 0.0  # everything was tried

    def _waves(self) -> Iterator[Integers]:
        """Waves of minimal sets, those first that are likely to be visible and to predict well."""
        if self.normals:
            return covering_waves(self.positions, self.facing, self.minimal, self.view_cosine)
        wide = minimal_sets(self.positions, self.minimal, self.rng)
        return alternate(wide, sets_of_parts(self.positions, self.minimal, self.rng)) if self.single else wide

    def _tried(self) -> TriedSets | None:
        """Record of the sets tried, which tells when nothing was missed; None without normals or for motions."""
        if not self.normals or not self.single:
            return None
        return TriedSets(partial(detected_views, normals=self.facing, view_cosine=self.view_cosine))

    def _has_missed_none(self, tried: TriedSets | None, sets_done: int) -> bool:
        """Whether a pose that explains as many points as the best one would have been met by the sets tried."""
        by_chance = self.options.stopping.in_part and not self.is_beyond_chance()
        matched = self.minimal + 1 if by_chance else self._best_match_count()
        if tried is not None:
            self.missed = tried.missed(matched)
            return self.missed <= MISSED
        if not self.single or not (by_chance or (matched := max(matched, self.fewest)) > self.minimal + 1):
            return False
        given = self.n, self.minimal, sets_done
        self.missed = unmet = visibility.random_miss_probability(matched, *given)
        if self.hypotheses and not by_chance:
            best = strongest_assignment(self.hypotheses)
            self.missed = unmet = min(self.missed, recurrence_miss_probability(best, self.drawn))
            if unmet <= visibility.MISSED_OF_NOTHING and not self.is_beyond_chance():
                unmet = min(unmet, visibility.unmet_probability(self.fewest, min(self.shape), *given))
        return unmet <= MISSED

    def _best_match_count(self) -> int:
        """Points that the hypothesis with the highest evidence matches, or a minimal set and one more."""
        return int((strongest_assignment(self.hypotheses) >= 0).sum()) if self.hypotheses else self.minimal + 1

    def _prepare_sets(self, points: Integers, arrangements: int) -> PreparedSets:
        """Minimal sets with what all their images share, each beginning elsewhere in the arrangements."""
        offset = self.rng.integers(0, arrangements, len(points))
        # in random order: were the first points all hidden, or of another motion, the test would end too soon
        others = self.rng.permuted(remaining_points(points, self.n), axis=1)
        return prepare_sets(self.tables, points, others, offset)

    def _test(self, wave: int, seen: float = math.inf) -> SequentialTest:
        """The sequential test of a wave: hopeful at first, then ever more patient. ``seen``: most points seen."""
        visible = (VISIBLE if self.single else VISIBLE_OF_MANY) * min(1.0, self.n_target / self.n)
        visible = min(visible, seen / self.n)
        return sequential_test(self.clutter, visible, wave, minimum=self.minimal + 1, normals=self.normals)

    def _is_spent(self) -> bool:
        return self.evaluated >= self.budget or self.deadline.passed()

    def _has_enough(self) -> bool:
        """Whether the search may stop."""
        if not self.is_beyond_chance():
            return False
        self.refine()
        if self.normals and self.single:
            return True  # another pose is sought among its rivals
        return has_found_enough(self)

    def is_beyond_chance(self) -> bool:
        """Whether any hypothesis is beyond chance."""
        return self._most_evidence() > self._false_alarm_level()

    def _most_evidence(self) -> float:
        return max((float(batch.evidence.max(initial=-math.inf)) for batch in self.hypotheses), default=-math.inf)

    refine, _try_rivals, _missed_among = refine_clusters, rivals.try_rivals, rivals.rival_miss_probability

    def _false_alarm_level(self) -> float:
        return false_alarm_level(self.tested, self.options.stopping)

    def _try(
        self,
        sets: PreparedSets,
        test: SequentialTest,
        arrangements: NDArray[np.int32],
        *,
        first: int,
        last: int,
        images: Integers | None = None,
        known: Integers | None = None,
    ) -> int:
        """Test one batch of tasks and verify the best survivors.

        If only some ``images`` may be matched, ``arrangements`` are places in them, and the survivors are rivals of the
        best hypothesis; of a ``known`` assignment (n,), if they are its own images. How many sets met that again.
        """
        columns = self.n_target if images is None else len(images)
        solved = int(self.possible * (last - first) * (columns - self.minimal + 1))
        maximum = batches.verification_count(solved, self.single) if images is None else rivals.RIVALS_KEPT
        survivors, ratios, counts = run_sequential_tests(
            self.padded, self.grid, test, sets, arrangements,
            first=first, last=last, allowed=self.allowed if images is None else rivals.allowed_pairs(self, images),
            keep=batches.survivors_per_chunk(maximum), chunks=batches.CHUNKS,
            threads=worthwhile_threads(solved // batches.WORTH_A_THREAD), images=images,
        )  # fmt: skip
        if images is None:
            self._keep(sets.points, survivors, ratios, counts, maximum)
            return 0
        self._count(counts)
        return rivals.verify_rivals(self, Survivors.of(sets.points, survivors, ratios, maximum), known)

    def _count(self, counts: Integers) -> None:
        """Count what the tests of some chunks did."""
        solved, tested, looked_up = counts.sum(axis=0).tolist()
        self.solved += solved
        self.tested += tested
        self.evaluated += solved + looked_up

    def _keep(self, points: Integers, survivors: Integers, ratios: Floats, counts: Integers, maximum: int) -> None:
        """Count what was done, and verify at most so many survivors of the sets ``points`` (S, m)."""
        self._count(counts)
        found, before = Survivors.of(points, survivors, ratios, maximum), len(self.hypotheses)
        if len(found.ratios):
            self._verify(found.points, found.images)
            self.drawn += [one.take(one.evidence > 0.0) for one in self.hypotheses[before:]]

    def _verify(self, points: Integers, images: Integers) -> None:
        """Keep solved minimal sets with their evidence and candidates; at the deadline in force, those verified."""
        size, found = max(VERIFIED // max(self.n * len(self.density), 1), 1), list[Hypotheses]()
        try:
            for k in range(0, len(points), size):
                checkpoint()
                p, q = points[k : k + size], images[k : k + size]
                judged = verify(self.tables, p, q, self.density, self.allowed)
                self.evaluated += len(p) * (self.n - self.minimal)
                found += Hypotheses(p, q, *judged).real()
        finally:
            self.hypotheses += [Hypotheses.joined(found)] if found else []

    def clusters(self) -> HypothesisClusters:
        """The clusters at the end; where one is beyond chance, it and its rivals."""
        leaders, lists, hypotheses = self._cluster_hypotheses()
        evidence, level = hypotheses.evidence[leaders], self._false_alarm_level()
        if self.single and len(leaders) and evidence[0] > level:
            own = self._rivals(evidence)
            evidence, lists = evidence[own], lists[own]
        return HypothesisClusters(lists, evidence, level)

    def assignments(self) -> Integers:
        """Assignments (K, n) of the hypotheses, each once, those of the highest evidence first.

        Where one is beyond chance, it and its rivals; also the best that shares none of its detections, beyond chance
        or not: a copy that shows less is judged by the model of the image, which knows how rare it is.
        """
        _, _, hypotheses = self._cluster_hypotheses()
        level, evidence = self._false_alarm_level(), hypotheses.evidence
        near = evidence > evidence.max(initial=0.0) - LAG
        if not near.all():
            near |= (evidence > level) & hypotheses.differs_from_first()
        if len(evidence) and evidence[0] > level:
            near &= self._rivals(evidence)
        told = hypotheses.assignments(near, self.options.hypotheses)
        return np.concatenate([told, hypotheses.assignments(hypotheses.apart_from_first(), 1)])

    def _rivals(self, evidence: Floats) -> Bools:
        """Which hypotheses, strongest first, come near the first one."""
        return evidence > min(self._false_alarm_level(), RIVAL_EVIDENCE * float(evidence[0]))

    def _cluster_hypotheses(self) -> tuple[Integers, Integers, Hypotheses]:
        """Leaders (G,) and candidates (G, n, c) of the clusters of all hypotheses, and these, strongest first."""
        if self._known is not None and len(self.hypotheses) == 1 and self.hypotheses[0] is self._known[2]:
            return self._known
        none = Hypotheses.empty(self.minimal, self.n, CANDIDATES)
        hypotheses = Hypotheses.joined(self.hypotheses or [none]).strongest(batches.REMEMBERED)
        self.hypotheses = [hypotheses]
        leaders, lists = cluster(hypotheses.evidence, hypotheses.best, hypotheses.candidates, GROUPS)
        self._known = leaders, lists, hypotheses
        return self._known
