"""The guided search for one motion of an object with normals: triples that are visible together, and their rivals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Bools, Integers
from rootmatch.deadline import Deadline, Pace, checkpoint
from rootmatch.jit.threads import threads_worth
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided import batches
from rootmatch.samplers.guided.crowding import crowding
from rootmatch.samplers.guided.dispatch import has_listed
from rootmatch.samplers.guided.local_search import CROWDED, LEAST, LocalSearch
from rootmatch.samplers.guided.model_views import model_views
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.rivals import SAME, allowed_to, fewest
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.sequential_test import SequentialTest, sequential_test
from rootmatch.samplers.guided.survivors import Survivors
from rootmatch.samplers.guided.triangle_shapes import CELLS, image_cells
from rootmatch.samplers.guided.visibility import DETECTED, FACING, MISSED, seen_together
from rootmatch.samplers.guided.visible_triples import VisibleSets, run_visible_tests

MOST_DETECTIONS = 256
"""Detections beyond which the cells of their triples take too much memory: 34 MB."""

SHAPES_PER_SOLVED = 16
"""Image triples whose shape is looked up in the time of one that is solved."""
CHUNKS = 32
"""Chunks of the triples that are ranked alone: each looks for its weakest at every one that it keeps. A round value."""
SECONDS_PER_TRIPLE = 5e-8
"""Most sets, each tried whole, take at least so long for each triple of images (benchmarks/deadlines.py, task 970)."""
TOGETHER = 1.0 / 3.0
"""Share of all triples that a view shows from which normals do not tell the search what is visible. Of caps of a ball
with a share of .4 a search without normals takes a third of the time, with .25 as much, with .1 twice as much to ten
times (16 and 30 points, five scenes each from 1000). A round value."""
LEAST_MATCHED = 6
"""Points of a pose that must not have been missed, at least: two minimal sets. Fewer hardly tell a pose from chance,
and to look for them would take most of the time."""


def ranks_triples(task: SamplingTask) -> bool:
    """Whether `VisibleSearch` can search a task."""
    normals = bool(task.tables.normals[:3].any())
    return task.motions == 1 and normals and has_listed(type(task.tables)) and task.shape[1] <= MOST_DETECTIONS


def search_of(task: SamplingTask, options: GuidedOptions, deadline: Deadline) -> Search:
    """The search that suits a task.

    Where nearly all points are seen together their normals tell a search nothing; the judge of what it finds has them.
    Nor is there time to list the shapes of all triples of images if that takes longer than the search may.
    """
    tables = task.tables
    normals = bool(tables.normals[:3].any())
    if normals and task.motions == 1:
        if seen_together(np.ascontiguousarray(tables.normals[:3].T), task.view_cosine) < TOGETHER:
            listed = task.shape[1] ** 3 <= SHAPES_PER_SOLVED * options.budget
            return (VisibleSearch if listed and ranks_triples(task) else Search)(task, options, deadline)
        task, normals = replace(task, tables=tables._replace(normals=np.zeros_like(tables.normals))), False
    if task.motions == 1 and not normals and has_listed(type(tables)) and task.shape[0] >= LEAST:
        rays, sigma = np.ascontiguousarray(tables.rays.T), np.sqrt(tables.variance)
        if crowding(rays, sigma) < CROWDED:
            return LocalSearch(task, options, deadline)
    return Search(task, options, deadline)


class VisibleSearch(Search):
    """One search for one motion where normals tell which triples are visible together; see `Search`."""

    def __init__(self, task: SamplingTask, options: GuidedOptions, deadline: Deadline | None = None) -> None:
        super().__init__(task, options, deadline)
        self.views = model_views(self.positions, self.facing, self.view_cosine)
        if task.more_images:
            self.views.prepare(self.tables)
        self.least_cosine = FACING if self.view_cosine is None else 0.0
        self.cells = image_cells(np.ascontiguousarray(self.grid.rays))
        same, met = np.eye(self.n_target, dtype=np.bool_), np.zeros(CELLS, np.bool_)
        met[self.cells[~(same | same[:, None] | same[:, :, None])]] = True
        self.met = np.flatnonzero(met)
        """The shapes that any image triple has."""

    def _steps(self) -> Iterator[None]:
        """See `Search`: triples of points that are visible together, with all images of a shape that they can have."""
        images = np.arange(self.n_target)
        batch, pace = batches.FIRST, Pace(self.deadline)
        for number in range(len(self.views.edges)):
            sets = self.views.wave(number, self.tables)
            count, done = len(sets.shapes), 0
            while done < count:
                last = min(count, done + pace.block(max(1, batch // len(images) ** 3)))
                if last == done:
                    return
                self._try_visible(sets, done, last, images, self.allowed)
                done, batch = last, batches.next_batch(batch)
                yield
            matched = max(self._most_matched(), LEAST_MATCHED)
            if self._none_missed_of(matched, number + 1):
                self.conclusive = True
                return
        self.missed = 0.0  # everything was tried

    def _missed_among(self, images: Integers, matched: int, known: Integers | None = None) -> float:
        """See `Search`: sets that are visible together, until no pose that explains so many can well be missed."""
        explained = SAME * matched if known is not None else fewest(matched, SAME)
        least, mask = max(self.minimal + 1, math.ceil(explained)), allowed_to(self, images)
        for number in range(len(self.views.edges)):
            sets, pace, done = self.views.wave(number, self.tables), Pace(self.deadline), 0
            while done < len(sets.shapes) and (block := pace.block(len(sets.shapes) - done)):
                self._try_visible(sets, done, min(len(sets.shapes), done + block), images, mask, seen=least)
                done += block
            missed = self.views.missed(least, number + 1)
            if missed <= MISSED or self._spent():
                return missed
        return 0.0

    def triples(self, most: int) -> tuple[Integers, Integers, bool]:
        """Triples of points (T, 3) that may be visible together, with images (T, 3) of a shape that they can have.

        Those first whose poses explain most of the other detections; and whether these are all.
        """
        test = self._test(0)._replace(floor=-math.inf, least=self.minimal)
        sets = self.views.whole(self.tables)
        survivors, ratios, counts = run_visible_tests(
            self.tables, self.grid, test, sets, self.cells,
            images=np.arange(self.n_target), first=0, last=len(sets.shapes),
            allowed=self.allowed, keep=max(most // 8, 1), chunks=CHUNKS,
        )  # fmt: skip
        self.evaluated += int(counts[:, ::2].sum())
        found = Survivors.of(sets.prepared.points, survivors, ratios, ratios.size)
        images = found.images[:, 1:]
        same = found.sets * self.n_target**3 + images @ self.n_target ** np.arange(3)  # but for the root
        first = np.sort(np.unique(same, return_index=True)[1])
        whole = len(first) <= most and bool((ratios.min(axis=1) == -np.inf).all())
        return found.points[first[:most]], images[first[:most]], whole

    def _none_missed_of(self, matched: int, waves: int) -> bool:
        """Whether the first waves would have met a pose that explains this many points."""
        self.missed = self.views.missed(matched, waves)
        return self.missed <= MISSED

    def _test(self, wave: int, seen: float = math.inf) -> SequentialTest:
        """The sequential test, the same for all waves, with a detection rate for points that face the camera."""
        least = self.minimal + 1
        return sequential_test(
            self.clutter,
            min(DETECTED, seen / self.views.most_facing),
            0,
            least=least,
            normals=True,
            facing=self.least_cosine,
        )

    def _try_visible(
        self, sets: VisibleSets, first: int, last: int, images: Integers, allowed: Bools, seen: float = math.inf
    ) -> None:
        """Test the sets ``first … last − 1``, and verify the survivors of the highest ratio.

        Raises `OutOfTime` if the deadline in force passes before a set can end.
        """
        triples = math.perm(len(images), self.minimal)
        checkpoint(SECONDS_PER_TRIPLE * triples)
        tasks = (last - first) * triples
        if not sets.shapes[first:last, self.met].any():
            self.evaluated += tasks // SHAPES_PER_SOLVED
            return
        most = batches.verified_of_listed(tasks)
        survivors, ratios, counts = run_visible_tests(
            self.tables, self.grid, self._test(0, seen), sets, self.cells,
            images=images, first=first, last=last, allowed=allowed,
            keep=batches.kept_per_chunk(most), chunks=batches.CHUNKS,
            threads=threads_worth(tasks // (SHAPES_PER_SOLVED * batches.WORTH_A_THREAD)),
        )  # fmt: skip
        self.evaluated += tasks // SHAPES_PER_SOLVED
        self._keep(sets.prepared.points, survivors, ratios, counts, most)
