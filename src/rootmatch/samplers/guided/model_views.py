"""Data of an object with normals that a search needs for any image: computed once, kept for the last few objects."""

from __future__ import annotations

from functools import cached_property
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.deadline import Deadline
from rootmatch.samplers.guided.listed_triples import VisibleSets
from rootmatch.samplers.guided.minimal_sets import FIRST_WAVE, nearest_neighbours, nearest_other_points, width
from rootmatch.samplers.guided.sequential_test import PreparedSets, prepare_sets
from rootmatch.samplers.guided.triangle_shapes import NARROW, add_near_shapes, shape_tables
from rootmatch.samplers.guided.visibility import (
    LOST,
    covering_order,
    detected_views,
    facing_points,
    sets_within_views,
    sphere,
)

PREPARED, EVALUATIONS = 4096, 4000
"""Triples that are prepared for images to come, and evaluations that take as long as one of them: .1 ms, .9 of a room
that is seen from inside. Round values."""
PREPARING = 0.5
"""Share of the time left, where it is limited, in which they are prepared. A round value."""
NEIGHBOURS, LOOKED_UP = 6, 24
"""Neighbours of a point that its local triples are taken from, and that these predict. Round values."""
LARGEST_WAVE = 32
"""Most triples after which it is asked again whether enough were tried."""
DIRECTIONS = 1_024
"""Directions from which the shapes of a triple's image are taken."""
DISTANCES = (20.0, 5.0, 2.9, 2.0)
"""Distances of those cameras, over the object's radius: inverse distances are even."""


class ModelViews:
    """Triples of points in the order in which they are tried, prepared wave by wave, and what they miss.

    ``positions``, ``normals`` (n, 3). ``view_cosine`` (n,): cosines of the view angles, where they are given.
    """

    def __init__(self, positions: Floats, normals: Floats, view_cosine: Floats | None = None) -> None:
        self.positions = positions
        self.ordered = covering_order(positions, normals, 3, view_cosine)
        sizes, wave = [0], FIRST_WAVE
        while sizes[-1] < len(self.ordered):
            sizes.append(min(sizes[-1] + wave, len(self.ordered)))
            wave = min(2 * wave, LARGEST_WAVE)
        self.edges = list(pairwise(sizes))
        self.visible = facing_points(normals, view_cosine)
        self.most_facing = max(int(self.visible.sum(axis=1).max()), 1)
        self.cameras, self.seen = _cameras(positions, normals, view_cosine)
        self.normals, self.view_cosine, self.directions = normals, view_cosine, sphere(DIRECTIONS)
        minimum = np.zeros(len(normals)) if view_cosine is None else view_cosine
        self.min_cosine = np.where(normals.any(axis=1), minimum, -1.0)
        self._waves: dict[int, VisibleSets] = {}
        self._wide = set[int]()
        self._ready, self._joined = [0, 0], dict[tuple[bool, int], VisibleSets]()
        self._views: dict[int, Bools] = {}
        self._met: dict[int, list[Integers]] = {}
        self._local_waves: dict[int, VisibleSets] = {}
        self._local_met: dict[int, Integers] = {}

    def prepare(self, tables: Any, budget: int, deadline: Deadline, *, wide: bool, maximum: int = PREPARED) -> int:
        """Prepare the next waves of up to so many triples, and return how many waves are: late ones take long together.

        At least one more, and as many as a ``budget`` of evaluations and the deadline allow. ``wide``: see `wave`.
        """
        stage, done = deadline.part(PREPARING), 0
        for number in range(self._ready[wide], len(self.edges)):
            first, last = self.edges[number]
            if last > maximum or (done and (done * EVALUATIONS > budget or stage.passed())):
                break
            self.wave(number, tables, wide=wide)
            self._ready[wide], done = number + 1, done + last - first
        return self._ready[wide]

    def wave(self, number: int, tables: Any, *, wide: bool = True) -> VisibleSets:
        """The triples of a wave; ``tables`` hold the same points and normals.

        ``wide``: whether any image is wider than one from afar; only then it is asked how a triple looks from near it.
        """
        if number not in self._waves:
            first, last = self.edges[number]
            points = self.ordered[first:last].copy()  # what is read-only is another type to a kernel
            together = sets_within_views(points, self.visible).astype(np.float32).T @ self.visible.astype(np.float32)
            np.put_along_axis(together, points, -1.0, axis=1)
            others = np.argsort(-together, axis=1, kind="stable")[:, : together.shape[1] - 3]
            self._waves[number] = self._prepared(tables, points, np.ascontiguousarray(others), len(self.cameras))
        sets = self._waves[number]
        if wide and number not in self._wide:
            add_near_shapes(
                sets.shapes, sets.prepared.points, self.positions, self.normals, minimum=self.min_cosine,
                directions=self.directions,
            )  # fmt: skip
            self._wide.add(number)
        return sets

    def local_wave(self, number: int, tables: Any) -> VisibleSets:
        """So many of the `local` triples, whose others are near them; ``tables`` as in `wave`."""
        if number not in self._local_waves:
            points = self.local[number * LARGEST_WAVE : (number + 1) * LARGEST_WAVE].copy()
            # their images are narrow, and those have shapes as from afar
            sets = self._prepared(tables, points, nearest_other_points(points, self.neighbours), DIRECTIONS)
            sets.shapes[:, NARROW:] = True
            self._local_waves[number] = sets
        return self._local_waves[number]

    def _prepared(self, tables: Any, points: Integers, others: Integers, maximum: int) -> VisibleSets:
        """Triples (S, 3) with the other points that each predicts, and their shapes in ``maximum`` cameras."""
        prepared = prepare_sets(tables, points, others, np.zeros(len(points), np.int64))
        return VisibleSets(prepared, shape_tables(self.positions, self.cameras[:maximum], self.seen[:maximum], points))

    @cached_property
    def neighbours(self) -> Integers:
        """The points near each, nearest first."""
        return nearest_neighbours(self.positions, LOOKED_UP)

    @cached_property
    def local(self) -> Integers:
        """Triples (T, 3) of a point and two of its neighbours that views show: the best about each, then the next."""
        pairs = np.array(list(combinations(range(min(NEIGHBOURS, len(self.positions) - 1)), 2)), np.int64)
        n, rng = len(self.positions), np.random.default_rng(len(self.positions))
        triples = np.empty((n, len(pairs), 3), np.int64)
        triples[:, :, 0], triples[:, :, 1:] = np.arange(n)[:, None], self.neighbours[:, pairs]
        every = triples.reshape(-1, 3)
        shown = sets_within_views(every, self.visible).mean(axis=0)
        worth = (shown * width(self.positions, every)).reshape(n, -1)
        order = np.argsort(-worth, axis=1, kind="stable")
        turns = np.take_along_axis(triples, order[..., None], axis=1).transpose(1, 0, 2)
        ordered = np.concatenate([rng.permutation(turn) for turn in turns])
        return ordered[sets_within_views(ordered, self.visible).any(axis=0)]

    def local_met(self, matched: int) -> Integers:
        """How many of the `local` triples of the first waves are within each view with ``matched`` points, (W, V)."""
        if matched not in self._local_met:
            views = detected_views(matched, self.normals, self.view_cosine)
            inside = sets_within_views(self.local, views)
            starts = np.arange(0, len(self.local), LARGEST_WAVE)
            self._local_met[matched] = np.add.reduceat(inside, starts, axis=1, dtype=np.int64).cumsum(axis=1).T
        return self._local_met[matched]

    def every(self, tables: Any, budget: int, deadline: Deadline, *, wide: bool) -> tuple[VisibleSets, bool]:
        """The triples of all waves, as far as they can be prepared, and whether these are all; see `prepare`."""
        ready = self.prepare(tables, budget, deadline, wide=wide, maximum=len(self.ordered))
        if (wide, ready) not in self._joined:
            waves = [self.wave(number, tables, wide=wide) for number in range(ready)]
            prepared = (np.concatenate(part) for part in zip(*(sets.prepared for sets in waves), strict=True))
            joined = VisibleSets(PreparedSets(*prepared), np.concatenate([sets.shapes for sets in waves]))
            self._joined = {(wide, ready): joined}
        return self._joined[wide, ready], ready == len(self.edges)

    def missed(self, matched: int, waves: int) -> float:
        """Probability that no set of the first waves met a pose with ``matched`` detected points."""
        if matched not in self._met:
            self._views[matched] = detected_views(matched, self.normals, self.view_cosine)
            self._met[matched] = [np.zeros(len(self._views[matched]), np.int64)]
        views, met = self._views[matched], self._met[matched]
        while len(met) <= waves:
            first, last = self.edges[len(met) - 1]
            met.append(met[-1] + sets_within_views(self.ordered[first:last], views).sum(axis=1))
        return float((LOST ** met[waves]).mean())


def _cameras(positions: Floats, normals: Floats, view_cosine: Floats | None) -> tuple[Floats, Bools]:
    """Positions (V, 3) of cameras at several distances in all directions, and which points face each (V, n)."""
    centre = positions.mean(axis=0)
    radius = float(np.linalg.norm(positions - centre, axis=1).max())
    cameras = np.concatenate([centre + radius * far * sphere(DIRECTIONS) for far in DISTANCES])
    towards = cameras[:, None] - positions
    along = np.einsum("vni,ni->vn", towards, normals)
    minimum = 0.0 if view_cosine is None else view_cosine * np.linalg.norm(towards, axis=2)
    return cameras, np.asarray((along > minimum) | ~normals.any(axis=1))


@cache_by_values(8)
def model_views(positions: Floats, normals: Floats, view_cosine: Floats | None = None) -> ModelViews:
    """`ModelViews` of points and normals (n, 3), kept for the last few objects."""
    return ModelViews(positions, normals, view_cosine)
