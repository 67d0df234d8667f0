"""Batches of minimal sets, tried until something is beyond chance or the budget is spent."""

from __future__ import annotations

import math
import time

import numba
import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph import enumeration
from rootmatch.problems.padding import padded
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.clutter import CROWDING
from rootmatch.samplers.guided import hypothesis_clustering
from rootmatch.samplers.guided.detection_grid import build_raster
from rootmatch.samplers.guided.hypotheses import Found, Proposals
from rootmatch.samplers.guided.minimal_sets import minimal_sets, others_of, widest
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.sequential_test import ROOTS, Rules, Sets, prepare_sets, propose
from rootmatch.samplers.guided.verification import weigh

Integers = NDArray[np.int64]

SEEN = (0.95, 0.6, 0.25, 0.1)
"""Chances that a source point is seen, over which the evidence of a proposal is averaged."""
BEYOND_CHANCE = 7.0
"""Evidence above the logarithm of the number of trials from which a proposal is no accident: one in a thousand."""
COMPLETE = 0.9
"""Part of the points that can be matched from which a proposal cannot be bettered by much."""
PATIENCE = 1.0
"""True minimal sets that must have been met, on average, before an incomplete proposal is believed to be the best."""
RIVAL_SETS = 3.0
"""Minimal sets, all of them seen, for which the detections of the answer are tried in every other arrangement."""
MANY_PARTS = 16
"""Batches whose proposals are kept apart until they are joined and the weakest forgotten."""
NEAR = 0.5
"""Part of the best evidence from which another proposal is an alternative."""
CANDIDATE2 = 3.5**2
"""χ² of a detection about a prediction within which it is a candidate."""
CHUNKS = 8
"""Pieces of a batch, whatever the number of threads, so that the result does not depend on it."""
FIRST_BATCH, LARGEST_BATCH = 8_000, 400_000
"""Minimal sets solved between two looks at what was found; each batch is twice the one before."""
LEAST_WEIGHED, SOLVED_A_WEIGHED = 32, 500
"""How many of a batch's survivors are weighed: so many, or one in so many minimal sets solved; …"""
LEAST_WEIGHED_OF_MANY, SOLVED_A_WEIGHED_OF_MANY = 1024, 20
"""… and with several motions, whose few points hardly stand out before they are weighed."""
REMEMBERED = 4_000
"""Proposals that are kept from batch to batch."""
WORTH_A_THREAD = 4_000
"""Minimal sets to be solved that are worth waking a thread for."""
REFINED, RESAMPLED = 8, 8
"""Groups that are proposed anew from within, at the least, and minimal sets drawn from each."""
ALIKE = 0.5
"""Part of their correspondences that two proposals of one group share."""
WEAK = 0.5
"""Part of the evidence of the first of a group from which others add candidates to it."""
SHARPNESS = 2.5
"""The gate over the deviation of a true detection from its prediction, while minimal sets are tried."""


class Search:
    """What one search has proposed so far.

    Parameters
    ----------
    task : SamplingTask
    options : Guided
    """

    def __init__(self, task: SamplingTask, options: GuidedOptions) -> None:
        tables, motions = task.tables, task.motions
        self.tables, self.options, self.progress = tables, options, task.progress
        self.n, self.n_target = task.shape
        self.padded = padded(tables, self.n_target)
        self.single = motions == 1
        self.motions = math.inf if motions == "auto" else float(motions)
        self.minimal = task.order - 1
        self.rng = np.random.default_rng([task.seed, *task.shape])
        self.allowed = task.allowed
        spread = np.sqrt(tables.variance)
        self.raster = build_raster(tables.rays, options.gate * max(float(np.median(spread)), float(spread.max()) / 2.0))
        self.density = CROWDING * self.raster.density
        self.seen = np.array(SEEN)
        self.normals = bool(np.any(tables.normals))
        self.places = np.ascontiguousarray(tables.points.T)
        self.solved = self.tested = self.evaluated = 0
        self.refined = -1
        self.parts: list[Proposals] = []
        self.found = False
        self.started = time.perf_counter()

    def run(self) -> None:
        """Batch after batch until enough is found, every minimal set was tried, or the budget is spent."""
        arrangements = self.rng.permutation(enumeration.target_arrangements(self.n_target, self.minimal - 1))
        batch = FIRST_BATCH
        for wave, points in enumerate(minimal_sets(self.places, self.minimal, self.rng)):
            sets = self._sets(points, len(arrangements))
            rules = self._rules(wave)
            tasks, done = len(points) * len(arrangements), 0
            while done < tasks:
                last = min(tasks, done + max(CHUNKS, batch // (self.n_target - self.minimal + 1)))
                self._try(sets, rules, arrangements, done, last, self.allowed)
                done, batch = last, min(2 * batch, LARGEST_BATCH)
                if self.progress is not None:
                    self.progress(min(self.evaluated, self.options.budget), self.options.budget)
                if self._spent():
                    return
                if self._enough():
                    self.found = True
                    self._seek_rivals()
                    return
                if len(self.parts) > MANY_PARTS:
                    self._groups()

    def _sets(self, points: Integers, arrangements: int) -> Sets:
        """Minimal sets with what is the same for all their images, each beginning elsewhere in the arrangements."""
        offset = self.rng.integers(0, arrangements, len(points))
        # in random order: were the first ones looked up all hidden, or of another motion, the test would end too soon
        others = self.rng.permuted(others_of(points, self.n), axis=1)
        sets: Sets = prepare_sets(self.tables, points, others, offset)
        return sets

    def _spent(self) -> bool:
        limit = self.options.max_seconds
        late = limit is not None and time.perf_counter() - self.started > limit
        return late or self.evaluated >= self.options.budget

    def _enough(self) -> bool:
        """Whether as many proposals as there are motions are beyond chance, and stronger ones would have been met."""
        if not self.parts or max(part.evidence.max() for part in self.parts) <= self._accident():
            return False
        self.refine()
        leaders, _, every = self._groups()
        covered = np.zeros(self.n, np.bool_)
        sizes: list[int] = []
        for leader in leaders[every.evidence[leaders] > self._accident()]:
            matched = every.best[leader] >= 0
            if (matched & covered).sum() <= ALIKE * matched.sum():
                covered |= matched
                sizes.append(int(matched.sum()))
        if covered.sum() >= COMPLETE * min(self.n, self.n_target):
            return True
        # how many minimal sets must be solved for one of the smallest motion's to be among them, on average
        expected = math.perm(self.n_target, self.minimal) * (self.n / min(sizes)) ** self.minimal
        return len(sizes) >= self.motions and self.solved >= PATIENCE * expected

    def _seek_rivals(self) -> None:
        """Whether the detections of the strongest proposal could as well be other points: a symmetric object.

        Only they are tried as images, so this takes a fraction of what the search took.
        """
        _, _, every = self._groups()
        images = every.best[0][every.best[0] >= 0]
        mask = np.zeros((self.n, self.n_target), np.bool_)
        mask[:, images] = True
        if self.allowed.size:
            mask &= self.allowed
        few = enumeration.target_arrangements(len(images), self.minimal - 1)
        arrangements = np.ascontiguousarray(images[few].astype(np.int32))
        wanted = math.ceil(RIVAL_SETS * (self.n / len(images)) ** self.minimal)
        for points in minimal_sets(self.places, self.minimal, self.rng):
            some = points[:wanted]
            sets = self._sets(some, len(arrangements))
            self._try(sets, self._rules(0), arrangements, 0, len(some) * len(arrangements), mask)
            wanted -= len(some)
            if wanted <= 0 or self._spent():
                return

    def _accident(self) -> float:
        """Evidence that chance reaches once in a thousand searches as long as this one."""
        return math.log(max(self.tested, 1)) + BEYOND_CHANCE

    def _rules(self, wave: int) -> Rules:
        """The sequential test: hopeful at first, then ever more patient with points that are not seen."""
        met = min(1.0 - math.exp(-self.density * math.pi * self.raster.gate2), 0.6)
        hope = (0.85 if self.single else 0.3) * min(1.0, self.n_target / self.n)
        seen = max(hope * 0.75**wave, 0.2, 1.5 * met)
        return Rules(
            hit=math.log(seen / met) + math.log(0.5 * SHARPNESS**2),
            fall=0.5 * SHARPNESS**2,
            miss=math.log((1.0 - seen) / (1.0 - met)),
            floor=math.log(0.03),
            least=self.minimal + 1,
            normals=self.normals,
        )

    def _try(
        self,
        sets: Sets,
        rules: Rules,
        arrangements: NDArray[np.int32],
        first: int,
        last: int,
        allowed: NDArray[np.bool_],
    ) -> None:
        """One batch of tasks."""
        solved = (last - first) * (self.n_target - self.minimal + 1)
        if self.single:
            most = max(LEAST_WEIGHED, solved // SOLVED_A_WEIGHED)
        else:
            most = max(LEAST_WEIGHED_OF_MANY, solved // SOLVED_A_WEIGHED_OF_MANY)
        threads = max(1, min(numba.get_num_threads(), solved // WORTH_A_THREAD))
        found, ratios, counts = propose(
            self.padded, self.raster, rules, sets, arrangements, first, last, allowed,
            max(8, most // (CHUNKS // 2)), CHUNKS, threads,
        )  # fmt: skip
        self.solved += int(counts[:, 0].sum())
        self.tested += int(counts[:, 1].sum())
        self.evaluated += int(counts[:, 0].sum() + counts[:, 2].sum())
        found, ratios = found.reshape(-1, found.shape[2]), ratios.reshape(-1)
        survivors = np.flatnonzero(found[:, 0] >= 0)
        survivors = survivors[np.argsort(-ratios[survivors], kind="stable")[:most]]
        if len(survivors):
            self._weigh(sets.points[found[survivors, 0]], np.ascontiguousarray(found[survivors, 1:]))

    def _weigh(self, points: Integers, images: Integers) -> None:
        """Evidence and candidates of solved minimal sets."""
        evidence, best, candidates = weigh(
            self.tables, points, images, self.density, CANDIDATE2, self.allowed, self.seen
        )
        self.evaluated += len(points) * (self.n - self.minimal)
        real = evidence > -np.inf
        if real.any():
            self.parts.append(Proposals(points, images, evidence, best, candidates).taken(real))

    def refine(self) -> None:
        """Propose anew from within the best groups: minimal sets of their own correspondences, wide ones.

        Another set predicts what the first one missed, and often better.
        """
        if self.refined == self.solved:
            return
        self.refined = self.solved
        leaders, _, every = self._groups()
        sure = int((every.evidence[leaders] > self._accident()).sum())
        points, images = [], []
        for leader in leaders[: sure or max(REFINED, len(leaders) // 4)]:
            matched = np.flatnonzero(every.best[leader] >= 0)
            chosen = widest(self.places, matched, self.minimal, RESAMPLED, self.rng)
            points.append(np.repeat(chosen, ROOTS, axis=0))
            images.append(np.repeat(every.best[leader][chosen], ROOTS, axis=0))
        if points:
            stacked = np.concatenate(points)
            roots = np.tile(np.arange(ROOTS), len(stacked) // ROOTS)
            self._weigh(stacked, np.column_stack([roots, np.concatenate(images)]))

    def settle(self) -> Found:
        """The groups of what was found: where one is beyond chance, it and those that come near it."""
        leaders, lists, every = self._groups()
        evidence, accident = every.evidence[leaders], self._accident()
        if self.single and len(leaders) and evidence[0] > accident:
            near = evidence > min(accident, NEAR * evidence[0])
            evidence, lists = evidence[near], lists[near]
        return Found(lists, evidence, accident)

    def _groups(self) -> tuple[Integers, Integers, Proposals]:
        """Leaders (G,) and candidates (G, n, c) of the groups of all that was proposed, and that, strongest first."""
        every = Proposals.joined(self.parts, self.minimal, self.n).strongest(REMEMBERED)
        self.parts = [every]
        leaders, lists = hypothesis_clustering.group(
            every.evidence, every.best, every.candidates, self.options.groups, ALIKE, WEAK
        )
        return leaders, lists, every
