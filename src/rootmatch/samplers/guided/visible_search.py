"""The guided search for one motion of an object with normals: triples that are visible together, and their rivals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import Deadline, Pace, checkpoint
from rootmatch.jit.threads import worthwhile_threads
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided import batches
from rootmatch.samplers.guided.crowding import crowding
from rootmatch.samplers.guided.dispatch import has_listed
from rootmatch.samplers.guided.listed_triples import Ring, VisibleSets, make_rings, run_listed_tests
from rootmatch.samplers.guided.local_search import CROWDED, IMAGES, LOCAL, MINIMUM, LocalSearch
from rootmatch.samplers.guided.model_views import LARGEST_WAVE, model_views
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.rivals import RIVAL_MISSED, allowed_pairs
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.sequential_test import SequentialTest, sequential_test
from rootmatch.samplers.guided.survivors import Survivors
from rootmatch.samplers.guided.triangle_shapes import CELLS, NARROW, image_cells
from rootmatch.samplers.guided.visibility import DETECTED, FACING, FAILURE, MISSED, covisible_share

MAX_DETECTIONS = 256
"""Detections beyond which the cells of their triples take too much memory: 34 MB."""

SHAPES_PER_SOLVED = 16
"""Image triples whose shape is looked up in the time of one that is solved."""
MIN_RING = 32_000
"""Image triples that a smaller ring has at least: some milliseconds for each triple of points. A round value."""
CHUNKS = 32
"""Chunks of the triples that are ranked alone: each looks for its weakest at every one that it keeps. A round value."""
SECONDS_PER_TRIPLE = 5e-8
"""Most sets, each tried whole, take at least so long for each triple of images (benchmarks/deadlines.py, task 970)."""
TOGETHER = 1.0 / 3.0
"""Share of all triples that a view shows from which normals do not tell the search what is visible. Of caps of a ball
with a share of .4 a search without normals takes a third of the time, with .25 as much, with .1 twice as much to ten
times (16 and 30 points, five scenes each from 1000). A round value."""
MIN_MATCHED = 6
"""Points of a pose that must not have been missed, at least: two minimal sets. Fewer hardly tell a pose from chance,
and to look for them would take most of the time."""


@dataclass
class Turn:
    """How many of the triples were tried with images of one ring."""

    ring: Ring
    share: float
    """Of the work, beside those of other rings. By the root of their costs the mean time is least over all sizes of an
    object in the image, if each is as probable as twice that."""
    spent: int = 0
    """Image triples tried."""
    wave: int = 0
    """The wave that is tried, and how many of its triples were."""
    done: int = 0


class LocalSets(NamedTuple):
    """Local triples that meet all rivals of a pose."""

    ring: Ring
    """Their images."""
    missed: Floats
    """Probability (W,) of having missed one after each wave."""


def ring_sizes(images: Integers) -> list[int]:
    """Detections near each of some that rings are made of: all, and halves of them down to some that cost little."""
    sizes = [len(images) - 1]
    while len(images) * (sizes[0] // 2) ** 2 >= MIN_RING:
        sizes.insert(0, sizes[0] // 2)
    return sizes


def ranks_triples(task: SamplingTask) -> bool:
    """Whether `VisibleSearch` can search a task."""
    normals = bool(task.tables.normals[:3].any())
    return task.motions == 1 and normals and has_listed(task.tables) and task.shape[1] <= MAX_DETECTIONS


def choose_search(task: SamplingTask, options: GuidedOptions, deadline: Deadline) -> Search:
    """The search that suits a task.

    Where nearly all points are seen together their normals tell a search nothing; the judge of what it finds has them.
    Nor is there time to list the shapes of all triples of images if that takes longer than the search may.
    """
    tables = task.tables
    normals = bool(tables.normals[:3].any())
    if normals and task.motions == 1:
        if covisible_share(np.ascontiguousarray(tables.normals[:3].T), task.view_cosine) < TOGETHER:
            listed = task.shape[1] ** 3 <= SHAPES_PER_SOLVED * options.budget
            return (VisibleSearch if listed and ranks_triples(task) else Search)(task, options, deadline)
        task, normals = replace(task, tables=tables._replace(normals=np.zeros_like(tables.normals))), False
    if task.motions == 1 and not normals and has_listed(tables) and task.shape[0] >= MINIMUM:
        rays, sigma = np.ascontiguousarray(tables.rays.T), np.sqrt(tables.variance)
        if crowding(rays, sigma) < CROWDED:
            return LocalSearch(task, options, deadline)
    return Search(task, options, deadline)


class VisibleSearch(Search):
    """One search for one motion where normals tell which triples are visible together; see `Search`."""

    def __init__(self, task: SamplingTask, options: GuidedOptions, deadline: Deadline | None = None) -> None:
        super().__init__(task, options, deadline)
        self.views = model_views(self.positions, self.facing, self.view_cosine)
        self.min_cosine = FACING if self.view_cosine is None else 0.0
        self.cells = image_cells(np.ascontiguousarray(self.grid.rays))
        same, met = np.eye(self.n_target, dtype=np.bool_), np.zeros(CELLS, np.bool_)
        met[self.cells[~(same | same[:, None] | same[:, :, None])]] = True
        self.every = make_rings(np.arange(self.n_target), self.grid.positions, [self.n_target - 1])[0]
        self.met = np.flatnonzero(met)
        """The shapes that any image triple has."""
        self.is_wide = bool(met[NARROW:].any())
        if task.more_images:
            self.views.prepare(self.tables, options.budget, self.deadline, wide=self.is_wide)

    def _steps(self) -> Iterator[None]:
        """See `Search`: triples of points that are visible together, with all images of a shape that they can have."""
        yield from self._search_rings(np.arange(self.n_target), self.allowed)
        self.conclusive = 0.0 < self.missed <= MISSED  # not where all listed triples were tried before that

    def _search_rings(self, images: Integers, allowed: Bools, shown: Sequence[int] = ()) -> Iterator[None]:
        """Try triples with some images until a pose that explains so many points can hardly have been missed.

        ``shown``: see `rival_miss_probability`; those that the strongest hypothesis explains, by default. Images that
        lie close together are few, so their triples come first, as many as their cost allows: those of an object that
        fills the image are not much later, and those of a small one far sooner.
        """
        turns = [
            Turn(ring, math.sqrt(ring.cost)) for ring in make_rings(images, self.grid.positions, ring_sizes(images))
        ]
        batch, pace, waves = batches.FIRST, Pace(self.deadline), len(self.views.edges)
        while True:
            matched = shown[0] if shown else max(self._best_match_count(), MIN_MATCHED)
            limits = ((matched, MISSED), *((minimum, RIVAL_MISSED) for minimum in shown[1:]))
            done = min(turn.wave for turn in turns)
            self.missed = self.views.missed(matched, done) if done < waves else 0.0
            open_turns = [
                one
                for one in turns
                if one.wave < waves
                and any(self.views.missed(minimum, one.wave) > maximum for minimum, maximum in limits)
            ]
            if not open_turns:
                return
            turn = min(open_turns, key=lambda one: (one.spent + one.ring.cost) / one.share)
            sets = self.views.wave(turn.wave, self.tables, wide=self.is_wide)
            last = min(len(sets.shapes), turn.done + pace.block(max(1, batch // turn.ring.cost)))
            if last == turn.done:
                return
            self._try_visible(sets, turn.done, last, turn.ring, allowed, seen=shown[-1] if shown else math.inf)
            turn.spent += (last - turn.done) * turn.ring.cost
            turn.done, batch = last, batches.next_batch(batch)
            if last == len(sets.shapes):
                turn.done, turn.wave = 0, turn.wave + 1
            yield

    def _missed_among(self, images: Integers, shown: Sequence[int], known: Integers | None = None) -> float:
        """See `Search`: sets that are visible together, until no pose that explains so many can well be missed.

        Rivals that have the detections of a pose which is ``known`` are met by local triples as it is, or by wide ones
        if those cost less.
        """
        mask, minimum = allowed_pairs(self, images), shown[0]
        local = None if known is None else self._find_local_sets(images, minimum, known)
        before = self.missed
        for _ in (
            self._search_rings(images, mask, shown) if local is None else self._search_locally(local, mask, minimum)
        ):
            if self._is_spent():
                break
        missed, self.missed = self.missed, before
        return missed

    def _find_local_sets(self, images: Integers, minimum: int, known: Integers) -> LocalSets | None:
        """How local triples may meet all rivals of a known pose with its images; None where wide ones cost less."""
        number, maximum = 0, math.perm(len(images), self.minimal)
        while number < len(self.views.edges) and self.views.missed(minimum, number) > MISSED:
            number += 1
        cost, found = self.views.edges[number - 1][1] * maximum if number else 0, None
        sizes = [size for size in IMAGES if size <= LOCAL * (len(images) - 1)]
        if not sizes:
            return None
        own = self.views.local[(known[self.views.local] >= 0).all(axis=1)]
        for ring in (make_rings(images, self.grid.positions, [size])[0] for size in sizes):
            near = ring.near[np.searchsorted(images, known[own[:, 0]])]
            met = (near[:, None] == known[own[:, 1:], None]).any(axis=2).all(axis=1)
            lost = 1.0 - (1.0 - FAILURE) * float(met.mean()) if len(own) else 1.0
            missed = (lost ** self.views.local_met(minimum)).mean(axis=1)
            enough = int((missed > MISSED).sum()) + 1
            if enough <= len(missed) and enough * LARGEST_WAVE * ring.cost < cost:
                cost, found = enough * LARGEST_WAVE * ring.cost, LocalSets(ring, missed[:enough])
        return found

    def _search_locally(self, local: LocalSets, allowed: Bools, minimum: int) -> Iterator[None]:
        """Try local triples until a pose that explains so many points can hardly have been missed."""
        pace, self.missed = Pace(self.deadline), 1.0
        for number, missed in enumerate(local.missed.tolist()):
            sets, done = self.views.local_wave(number, self.tables), 0
            while done < len(sets.shapes):
                last = done + pace.block(len(sets.shapes) - done)
                if last == done:
                    return
                self._try_visible(sets, done, last, local.ring, allowed, seen=minimum)
                done = last
            self.missed = missed
            yield

    def triples(self, maximum: int) -> tuple[Integers, Integers, bool]:
        """Triples of points (T, 3) that may be visible together, with images (T, 3) of a shape that they can have.

        Those first whose poses explain most of the other detections; and whether these are all.
        """
        test = self._test(0)._replace(floor=-math.inf, minimum=self.minimal)
        sets, every = self.views.every(self.tables, self.budget, self.deadline, wide=self.is_wide)
        survivors, ratios, counts = run_listed_tests(
            self.tables, self.grid, test, sets.prepared, self.every, shapes=sets.shapes, cells=self.cells,
            allowed=self.allowed, keep=max(maximum // 8, 1), chunks=CHUNKS,
        )  # fmt: skip
        self.evaluated += int(counts[:, ::2].sum())
        found = Survivors.of(sets.prepared.points, survivors, ratios, ratios.size)
        images = found.images[:, 1:]
        same = found.sets * self.n_target**3 + images @ self.n_target ** np.arange(3)  # but for the root
        first = np.sort(np.unique(same, return_index=True)[1])
        whole = every and len(first) <= maximum and bool((ratios.min(axis=1) == -np.inf).all())
        return found.points[first[:maximum]], images[first[:maximum]], whole

    def _test(self, wave: int, seen: float = math.inf) -> SequentialTest:
        """The sequential test, the same for all waves, with a detection rate for points that face the camera."""
        seen = min(DETECTED, seen / self.views.most_facing)
        return sequential_test(
            self.clutter, seen, 0, minimum=self.minimal + 1, normals=True, facing=self.min_cosine
        )  # fmt: skip

    def _try_visible(
        self, sets: VisibleSets, first: int, last: int, ring: Ring, allowed: Bools, seen: float = math.inf
    ) -> None:
        """Test the sets ``first … last − 1``, and verify the survivors of the highest ratio.

        Raises `OutOfTime` if the deadline in force passes before a set can end.
        """
        checkpoint(SECONDS_PER_TRIPLE * ring.cost)
        tasks = (last - first) * ring.cost
        if not sets.shapes[first:last, self.met].any():
            self.evaluated += tasks // SHAPES_PER_SOLVED
            return
        maximum = batches.listed_verification_count(tasks)
        survivors, ratios, counts = run_listed_tests(
            self.tables, self.grid, self._test(0, seen), sets.prepared, ring,
            first=first, last=last, shapes=sets.shapes, cells=self.cells, allowed=allowed,
            keep=batches.survivors_per_chunk(maximum), chunks=batches.CHUNKS,
            threads=worthwhile_threads(tasks // (SHAPES_PER_SOLVED * batches.WORTH_A_THREAD)),
        )  # fmt: skip
        self.evaluated += tasks // SHAPES_PER_SOLVED
        self._keep(sets.prepared.points, survivors, ratios, counts, maximum)
