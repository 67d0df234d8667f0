"""The guided search for one motion of an object with normals: triples that are visible together, and their rivals."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import Deadline, Pace, checkpoint
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided.crowding import crowding
from rootmatch.samplers.guided.dispatch import has_listed
from rootmatch.samplers.guided.local_search import LocalSearch
from rootmatch.samplers.guided.model_views import model_views
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.sequential_test import SequentialTest, sequential_test
from rootmatch.samplers.guided.survivors import Survivors
from rootmatch.samplers.guided.triangle_shapes import image_cells
from rootmatch.samplers.guided.visible_triples import VisibleSets, run_visible_tests

MOST_DETECTIONS = 128
"""Detections beyond which the cells of their triples take too much memory: 4 MB."""

SHAPES_PER_SOLVED = 16
"""Image triples whose shape is looked up in the time of one that is solved."""
CHUNKS = 32
"""Chunks of the triples that are ranked alone: each looks for its weakest at every one that it keeps. A round value."""
SECONDS_PER_TRIPLE = 5e-8
"""Most sets, each tried whole, take at least so long for each triple of images (benchmarks/deadlines.py, task 970)."""


def search_of(task: SamplingTask, options: GuidedOptions, deadline: Deadline) -> Search:
    """The search that suits a task."""
    normals = bool(task.tables.normals[:3].any())
    if task.motions == 1 and normals and has_listed(type(task.tables)) and task.shape[1] <= MOST_DETECTIONS:
        return VisibleSearch(task, options, deadline)
    if task.motions == 1 and not normals and has_listed(type(task.tables)) and task.shape[0] >= options.local.least:
        rays, sigma = np.ascontiguousarray(task.tables.rays.T), np.sqrt(task.tables.variance)
        if crowding(rays, sigma) < options.local.crowded:
            return LocalSearch(task, options, deadline)
    return Search(task, options, deadline)


class VisibleSearch(Search):
    """One search for one motion where normals tell which triples are visible together; see `Search`."""

    def __init__(self, task: SamplingTask, options: GuidedOptions, deadline: Deadline | None = None) -> None:
        super().__init__(task, options, deadline)
        self.views = model_views(
            self.positions, self.facing, options.sets, options.visibility, self.view_cosine
        )  # fmt: skip
        if task.more_images:
            self.views.prepare(self.tables)
        self.least_cosine = options.visibility.facing if self.view_cosine is None else 0.0
        self.cells = image_cells(np.ascontiguousarray(self.grid.rays))

    def run(self) -> None:
        """Run wave after wave until one hypothesis is beyond chance and has no rivals, or none can have been missed."""
        images = np.arange(self.n_target)
        batch, pace = self.options.batches.first, Pace(self.deadline)
        for number in range(len(self.views.edges)):
            sets = self.views.wave(number, self.tables)
            count, done = len(sets.shapes), 0
            while done < count:
                last = min(count, done + pace.block(max(1, batch // len(images) ** 3)))
                if last == done:
                    return
                self._try_visible(sets, done, last, images, self.allowed)
                done, batch = last, min(2 * batch, self.options.batches.largest)
                if self.progress is not None:
                    self.progress(min(self.evaluated, self.options.budget), self.options.budget)
                if self._spent():
                    return
                if self._enough():
                    self.conclusive = True
                    self._try_rivals()
                    return
                if len(self.hypotheses) > self.options.batches.most_batches:
                    self._clustered()
            matched = max(self._most_matched(), self.options.visibility.least_matched)
            if self._none_missed_of(matched, number + 1):
                self.conclusive = True
                return
        self.missed = 0.0  # everything was tried

    def _try_rivals(self) -> None:
        """See `Search`: only the detections of the strongest hypothesis are tried as images."""
        _, _, hypotheses = self._clustered()
        images = np.sort(hypotheses.best[0][hypotheses.best[0] >= 0])
        mask = np.zeros((self.n, self.n_target), np.bool_)
        mask[:, images] = True
        if self.allowed.size:
            mask &= self.allowed
        least = max(self.minimal + 1, math.ceil(self.options.visibility.rival * len(images)))
        for number in range(len(self.views.edges)):
            sets, pace, done = self.views.wave(number, self.tables), Pace(self.deadline), 0
            while done < len(sets.shapes) and (block := pace.block(len(sets.shapes) - done)):
                self._try_visible(sets, done, min(len(sets.shapes), done + block), images, mask)
                done += block
            if self._none_missed_of(least, number + 1) or self._spent():
                return
        self.missed = 0.0

    def triples(self, most: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Triples of points (T, 3) that may be visible together, with images (T, 3) of a shape that they can have.

        Those first whose poses explain most of the other detections.
        """
        test = self._visible_test()._replace(floor=-math.inf, least=self.minimal)
        sets = self.views.whole(self.tables)
        survivors, ratios, counts = run_visible_tests(
            self.tables, self.grid, test, sets, self.cells,
            images=np.arange(self.n_target), facing=self.least_cosine, first=0, last=len(sets.shapes),
            allowed=self.allowed, keep=max(most // 8, 1), chunks=CHUNKS,
        )  # fmt: skip
        self.evaluated += int(counts[:, ::2].sum())
        found = Survivors.of(sets.prepared.points, survivors, ratios, ratios.size)
        images = found.images[:, 1:]
        same = found.sets * self.n_target**3 + images @ self.n_target ** np.arange(3)  # but for the root
        first = np.sort(np.unique(same, return_index=True)[1])[:most]
        return found.points[first], images[first]

    def _none_missed_of(self, matched: int, waves: int) -> bool:
        """Whether the first waves would have met a pose that explains this many points."""
        self.missed = self.views.missed(matched, waves)
        return self.missed <= self.options.visibility.missed

    def _visible_test(self) -> SequentialTest:
        """The sequential test, with the detection rate of the options for points that face the camera."""
        options = self.options.test
        clutter = float(self.density.mean()) * math.pi * self.grid.gate2
        return sequential_test(
            options, clutter, self.options.visibility.detected, 0, least=self.minimal + 1, normals=True
        )

    def _try_visible(
        self, sets: VisibleSets, first: int, last: int, images: NDArray[np.int64], allowed: NDArray[np.bool_]
    ) -> None:
        """Test the sets ``first … last − 1``, and verify the survivors of the highest ratio.

        Raises
        ------
        OutOfTime
            If the deadline in force passes before a set can end.
        """
        triples = math.perm(len(images), self.minimal)
        checkpoint(SECONDS_PER_TRIPLE * triples)
        tasks = (last - first) * triples
        options = self.options.batches
        most = max(options.least_verified, tasks // options.sets_per_verified_with_normals)
        keep = max(options.least_kept_per_chunk, int(most * options.chunk_surplus / options.chunks))
        threads = max(1, min(numba.get_num_threads(), tasks // (SHAPES_PER_SOLVED * options.sets_per_thread)))
        survivors, ratios, counts = run_visible_tests(
            self.tables, self.grid, self._visible_test(), sets, self.cells,
            images=images, facing=self.least_cosine, first=first, last=last, allowed=allowed,
            keep=keep, chunks=options.chunks, threads=threads,
        )  # fmt: skip
        self.evaluated += tasks // SHAPES_PER_SOLVED
        self._keep(sets.prepared.points, survivors, ratios, counts, most)
