"""The multi-start: where ascents start, step by step, and which optima are kept."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers, median
from rootmatch.deadline import NEVER, Deadline, checkpoint
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.alternatives import best_neighbours
from rootmatch.solvers.ascent.assignment_state import State
from rootmatch.solvers.ascent.bounded_ascents import SECONDS_PER_GAIN, BoundedAscents
from rootmatch.solvers.ascent.options import AscentOptions
from rootmatch.solvers.ascent.random_walk_start import WALK, random_walk_start
from rootmatch.solvers.ascent.start_ranking import rank_candidates
from rootmatch.solvers.ascent.start_selection import are_cores_covered, force_cores, next_starts, pack_cores
from rootmatch.solvers.ascent.subset_index import SubsetIndex
from rootmatch.solvers.base import Alternatives, Solution

LEAD = 1.5
"""Score of the best assignment over that of any other from which it stands out. The work that it saves is in
benchmarks/solvers.py."""
LEAD_AFTER = 24
"""Ascents without which the lead says nothing. benchmarks/solvers.py."""
PATIENCE = 24
"""Candidates in a row that bring nothing better after which no more are tried, at least: 87 ascents then do what 255
did (docs/notebook/performance.md)."""
CORRESPONDENCES_PER_CANDIDATE = 16
"""Correspondences for which one more candidate is tried in large problems. Set with `PATIENCE`."""
READS = 110_000
"""Entries of the index that candidates may read if ascents are cheap. Set with `PATIENCE`."""
PATIENCE_AFTER_WALK = 14
"""Patience where nothing better than the ascent from the random walk has come yet: 52 ascents then do what 83 did, and
after 6 two of 226 tensors end lower (docs/notebook/performance.md)."""

POOL = 4
"""Best supported hyper-edges that are candidates, for each start."""
STARTS_PER_CORRESPONDENCE = 2
"""Starts of small problems, which have no more that differ."""
RANKED = 1 << 23
"""Entries of the index that are read to rank hyper-edges by their support: of more subsets the heaviest ones alone."""
DOMINANT = 2.0 / 3.0
"""Share of all weight from which the assignment that the walk leads to is not searched beyond: any other has what it
shares with it and at most half as much again. What it changes: benchmarks/record.py, benchmarks/constellations.py."""
FIRST_ROUND, LARGEST_ROUND = 2, 64
"""Candidates tried together at first, twice as many each time, and at most: the first few often find the optimum, and
those inside it are then not tried."""
USUAL_WEIGHT = 0.5
"""Usual weight of a hyper-edge over the largest, for the score that a candidate may lead to."""
CORE_DENSITY = 0.2
"""Weight over the largest that the hyper-edges of a core must have on average, those missing counted as 0."""
HOPELESS = 1e-3
"""Score over the best below which a candidate is not tried."""
FORCED_GAIN = 0.5
"""Score of a core over the gains that it displaces from which it is forced into the best assignment: an ascent may win
the rest."""
POLISHED, POLISHED_SCORE = 12, 0.7
"""Optima that go on with exchanges of two points, at a time, and their least score over the best.
benchmarks/solvers.py: for all of them it would cost most of the time."""
CLAIMED = 0.2
"""Gain over the median gain from which a point is claimed by an assignment: alternatives that move a claimed point come
first. As `rootmatch.hypergraph.support.drop_unsupported`."""
DOUBTFUL_PART = 0.25
"""Fraction of the alternatives left to those that move only doubtful points."""
NEIGHBOURS_PER_KEPT = 4
"""Single changes that are scored for each alternative to report."""


def patience(correspondences: int, reads_per_ascent: float) -> int:
    """Candidates in a row from which nothing better comes, after which a problem of some size is given up.

    Where the score tells the truth, its optimum is reached from one of the first candidates. Where it does not, later
    ones are as likely as any to lead a little higher, to no use. The numbers were set on 226 tensors and 200 instances
    of each cell of the published protocols, seeds from 1000 on (docs/hypergraph.md).
    """
    by_reads = int(READS / max(reads_per_ascent, 1.0))
    return max(PATIENCE, correspondences // CORRESPONDENCES_PER_CANDIDATE, by_reads)


def stands_out(values: list[float], ascents: int) -> bool:
    """Whether the best objective of these ascents is far above every other."""
    ranked = sorted(values, reverse=True)
    return ascents > LEAD_AFTER and (len(ranked) < 2 or ranked[0] > LEAD * ranked[1])


class MultiStart:
    """One run of `MultiStartAscent` and what it has found so far; its steps are numbered as there."""

    def __init__(self, options: AscentOptions, index: SubsetIndex, deadline: Deadline = NEVER) -> None:
        self.options, self.index, self.deadline = options, index, deadline
        self.ascents = BoundedAscents(options, index, deadline)
        n, n_target = index.n, index.n_target
        self.starts = min(options.starts, STARTS_PER_CORRESPONDENCE * n * n_target)
        self.heaviest = index.weights.max(initial=0.0) or 1.0
        self.density = max(CORE_DENSITY * self.heaviest, options.penalty)
        self.found: dict[bytes, tuple[Integers, float]] = {}
        self.reached: dict[bytes, int] = {}
        self.polished: set[bytes] = set()
        self.cores, self.core_values = np.empty((0, n), np.int64), np.empty(0)
        self.empty = self.ascents.state
        self.best, self.value = self.empty.image, 0.0
        self.patience = patience(n * n_target, self.ascents.usual_reads)

    def climb(self, root: State, bases: Integers, stage: str, *, exchanges: bool = False, due: int = 0) -> None:
        """Ascents of the objective itself, see `BoundedAscents.ascend`; the optima are kept."""
        images, values = self.ascents.ascend(
            root, bases, self.options.penalty, stage=stage, exchanges=exchanges, due=due
        )
        for image, value in zip(images, values.tolist(), strict=True):
            key = image.tobytes()
            self.found[key] = (image, value)
            self.reached[key] = self.reached.get(key, 0) + 1
            if exchanges:
                self.polished.add(key)
            if value > self.value:
                self.best, self.value = image, value

    @cached_property
    def ranked(self) -> tuple[NDArray[np.int32], Floats]:
        """Candidates, (P, d), and their ranks."""
        return rank_candidates(self.index, POOL * self.starts, RANKED)

    @property
    def candidates(self) -> NDArray[np.int32]:
        """Hyper-edges to start from, (P, d), the best supported first."""
        return self.ranked[0]

    @cached_property
    def promise(self) -> Floats:
        """The score of each candidate with all those that support it, were they one group of usual weights."""
        order, usual = self.index.indices.shape[1], USUAL_WEIGHT * self.heaviest
        return usual * _choose(order + self.ranked[1] / (order * usual), order)

    def dominates(self) -> bool:
        """Whether the best assignment so far holds so much of all weight that no other can score much more."""
        index = self.index
        return self.options.penalty == 0.0 and not index.unary.any() and self.value >= DOMINANT * index.weights.sum()

    def alone(self, chosen: Integers) -> Integers:
        """Assignments (B, n) of some candidates alone."""
        source, target = np.divmod(self.candidates[chosen], self.index.n_target)
        bases = np.full((len(chosen), self.index.n), -1)
        bases[np.arange(len(chosen))[:, None], source] = target
        return bases

    def found_assignments(self) -> Integers:
        """Assignments found, (F, n)."""
        return np.array([image for image, _ in self.found.values()], np.int64).reshape(-1, self.index.n)

    def start_from_walk(self) -> None:
        """Step 1; without a walk from nothing, of which unary weights alone may make something."""
        steps = self.options.walk
        balancing = WALK.balancing * SECONDS_PER_GAIN
        checkpoint(2.0 * steps * balancing * self.index.n * self.index.n_target)
        start = random_walk_start(self.index, steps) if steps else self.empty.image
        self.climb(self.empty, start[None], "walk")

    def start_from_cores(self) -> None:
        """Steps 2 and 3, in rounds: cores are grown, and ascents made from them."""
        after_walk = min(PATIENCE_AFTER_WALK, self.patience)
        open_ = self.promise >= HOPELESS * self.value
        grown: dict[bytes, tuple[Integers, float]] = {}
        shared = max(2, self.candidates.shape[1] - 1)
        tried, size, idle, walked = 0, FIRST_ROUND, 0, self.value
        images = np.empty((0, self.index.n), np.int64)
        while tried < self.starts and not self.settled() and not self.ascents.left_out:
            if idle >= (self.patience if self.value > walked else after_walk):
                break
            maximum = min(size, self.starts - tried)
            chosen = next_starts(self.candidates, open_, images, self.index.n_target, minimum=shared, count=maximum)
            if chosen.size == 0:
                break
            images, values = self.ascents.ascend(self.empty, self.alone(chosen), self.density, stage="growth")
            # The empty one is no core: its candidate was too light for its own penalty.
            new = {image.tobytes(): (image, v) for image, v in zip(images, values.tolist(), strict=True) if v > 0}
            cores, core_values = self.as_cores([pair for key, pair in new.items() if key not in grown])
            grown.update(new)
            before = self.value
            useful = (core_values > HOPELESS * before) & ~are_cores_covered(cores, self.found_assignments())
            if useful.any():
                self.climb(self.empty, cores[useful], "cores")
            idle = 0 if self.value > before else idle + len(chosen)
            tried += len(chosen)
            size = min(2 * size, LARGEST_ROUND)
        self.cores, self.core_values = self.as_cores(_sort_by_value(grown))

    def as_cores(self, grown: Alternatives) -> tuple[Integers, Floats]:
        """Assignments (C, n) that were grown, and their objectives (C,)."""
        cores = np.array([image for image, _ in grown], np.int64).reshape(-1, self.index.n)
        sizes = [math.comb(size, self.candidates.shape[1]) for size in (cores >= 0).sum(axis=1).tolist()]
        extra = (self.density - self.options.penalty) * np.array(sizes, np.float64)
        return cores, np.array([value for _, value in grown]) + extra

    def settled(self) -> bool:
        """Whether enough ascents reached the best assignment, or it stands far out among enough others."""
        if self.reached.get(self.best.tobytes(), 0) >= self.options.agreement:
            return True
        values = [value for _, value in self.found.values()]
        return stands_out(values, sum(self.reached.values()))

    def start_from_rivals(self) -> None:
        """The rest of step 3, whether or not the best assignment is settled: its rivals."""
        order = self.candidates.shape[1]
        open_ = self.promise >= HOPELESS * self.value
        # Fewer, down to a quarter, where an ascent is expensive.
        maximum = self.options.rivals
        count = int(min(maximum, max(maximum / 4, maximum / 2 / self.ascents.effort)))
        rivals = next_starts(
            self.candidates, open_, self.found_assignments(), self.index.n_target, minimum=order, count=count
        )
        if rivals.size:
            self.climb(self.empty, self.alone(rivals), "rivals")

    def start_from_packed_cores(self) -> None:
        """The first half of step 4: the cores that contradict none that scores better."""
        start = pack_cores(self.cores, self.index.n, self.index.n_target)
        # No move leads on from an optimum.
        if start.tobytes() not in self.found:
            self.climb(self.empty, start[None], "packed cores")

    def start_from_best(self) -> None:
        """The second half of step 4."""
        first = 0
        while first < len(self.cores) and not self.ascents.left_out:
            root = self.best_state()
            bases, first = force_cores(
                root, self.cores, self.core_values, first, forced_gain=FORCED_GAIN, count=LARGEST_ROUND
            )
            if len(bases):
                self.climb(root, bases, "forced")

    def polish(self) -> None:
        """Step 5, until the best assignment itself has been through it."""
        while self.best.tobytes() not in self.polished:
            minimum = POLISHED_SCORE * self.value
            near = [image for image, value in _sort_by_value(self.found) if value >= minimum]
            waiting = [image for image in near if image.tobytes() not in self.polished][:POLISHED]
            if not waiting:  # a deadline came before any ascent
                return
            self.polished.update(image.tobytes() for image in waiting)
            # That of the best one, which stands first, is not left out: one of exchanges is all that may lead on.
            self.climb(self.best_state(), np.array(waiting), "polish", exchanges=True, due=1)

    def best_state(self) -> State:
        """The state of the best assignment, kept while it is the best."""
        return self.ascents.state_at(self.best)

    def solution(self) -> Solution:
        """The best assignment found, its alternatives and statistics."""
        index, best, ascents = self.index, self.best, self.ascents
        gains = np.maximum(self.best_state().gains + index.unary, 0.0).reshape(index.n, index.n_target)
        total = gains.sum(axis=1, keepdims=True)
        total[total <= 0.0] = 1.0
        soft = gains / total
        (matched,), own = np.nonzero(best >= 0), np.zeros(index.n)
        own[matched] = gains[matched, best[matched]]
        statistics = {
            "starts": float(ascents.made),
            "optima": float(len(self.found)),
            "moves": float(ascents.moves),
            "reads": float(ascents.reads),
            "matched": float(matched.size),
        }
        wanted = matched.size > 0 and self.options.keep > 0
        alternatives = self._alternatives(own >= CLAIMED * median(own[matched])) if wanted else []
        return Solution(
            soft,
            best,
            self.value,
            alternatives,
            converged=ascents.cut == 0 and not ascents.left_out and not self.deadline.stopped_early,
            iterations=ascents.moves,
            statistics=statistics,
        )

    def _alternatives(self, claimed: Bools) -> Alternatives:
        """The best other assignments; most places go to those that move a claimed point, not only a doubtful one."""
        index, keep = self.index, self.options.keep
        shape, order = (index.n, index.n_target), index.indices.shape[1]
        tensor = AffinityTensor.unchecked(index.indices, index.weights, shape, index.unary.reshape(shape))
        due = self.options.penalty * math.comb(int((self.best >= 0).sum()), order)
        for image, score in best_neighbours(tensor, self.best, NEIGHBOURS_PER_KEPT * keep):
            self.found.setdefault(image.tobytes(), (image, score - due))
        # Cores are assignments too, which stopped short of being drawn into the best one.
        for core, value in zip(self.cores, self.core_values.tolist(), strict=True):
            self.found.setdefault(core.tobytes(), (core, value))
        ranked = _sort_by_value(self.found)
        images = np.concatenate([image for image, _ in ranked]).reshape(len(ranked), -1)
        moved = (images >= 0) & (images != self.best)
        matters = (moved & (self.best >= 0) & claimed).any(axis=1)
        (similar,) = np.nonzero(moved.any(axis=1) & ~matters)
        doubtful = int(DOUBTFUL_PART * keep)
        chosen = np.nonzero(matters)[0][: keep - min(doubtful, len(similar))].tolist()
        chosen += similar[: keep - len(chosen)].tolist()
        return [ranked[number] for number in sorted(chosen)]


def _sort_by_value(kept: dict[bytes, tuple[Integers, float]]) -> Alternatives:
    """Assignments and values, best first; equal ones in an order of their own."""
    return [pair for _, pair in sorted(kept.items(), key=lambda item: (-item[1][1], item[0]))]


def _choose(m: Floats, r: int) -> Floats:
    """Binomial coefficient of real m ≥ r."""
    return np.asarray(np.prod([(m - q) / (q + 1) for q in range(r)], axis=0))
