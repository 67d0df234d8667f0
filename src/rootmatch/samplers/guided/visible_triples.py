"""Sequential tests of triples that are visible together: only image triples of a shape that they can have are solved.

As `rootmatch.samplers.guided.sequential_test`, where normals tell which points face the camera: what a table of shapes
lets through is listed and solved side by side, and the other points are looked up in the order in which they are likely
to be visible beside the triple.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.jit.threads import chunk_bounds, run_in_chunks
from rootmatch.samplers.guided.detection_grid import DetectionGrid
from rootmatch.samplers.guided.dispatch import gather_listed, listed_frame, solve_listed
from rootmatch.samplers.guided.likelihood_ratio import find_weakest, keep_survivor, likelihood_ratio
from rootmatch.samplers.guided.screening import ROOTS, facing_excess
from rootmatch.samplers.guided.sequential_test import QUICK, PreparedSets, SequentialTest

BLOCK = 64
"""Image triples that are solved together."""
BLOCK_ROWS = 12
"""Numbers of an image triple: its bearings and the versines between them."""


class VisibleSets(NamedTuple):
    """Triples of source points that are visible together, as kernels take them."""

    prepared: PreparedSets
    """The others of each in the order in which they are likely to be visible beside it."""
    shapes: Bools
    """(S, CELLS) shapes that the image of each may have."""


class Ring(NamedTuple):
    """Detections that images of triples are taken from, by how near they are to that of the first point."""

    images: Integers
    """(L,) those of first points."""
    near: Integers
    """(L, q) detections near each, nearest first: of the other two points."""
    inner: int = 0
    """Of so many of them at most one is tried: what has both is in a smaller ring."""

    @property
    def cost(self) -> int:
        """Image triples of each set."""
        most, least = self.near.shape[1], self.inner
        return int(len(self.images) * (most * (most - 1) - least * (least - 1)))


def make_rings(images: Integers, positions: Floats, sizes: Sequence[int]) -> list[Ring]:
    """Rings of so many detections about each of some ``images`` (L,), ascending; ``positions`` (2, n') of all."""
    place = positions[:, images]
    distance2 = ((place[:, :, None] - place[:, None]) ** 2).sum(axis=0)
    np.fill_diagonal(distance2, -1.0)
    near = images[distance2.argsort(axis=1, kind="stable")[:, 1:]]
    return [Ring(images, near[:, :most].copy(), least) for least, most in pairwise([0, *sizes])]


def run_visible_tests(
    tables: Any,
    grid: DetectionGrid,
    test: SequentialTest,
    sets: VisibleSets,
    cells: NDArray[np.int16],
    ring: Ring,
    first: int,
    last: int,
    allowed: Bools,
    keep: int,
    chunks: int,
    threads: int = 1,
) -> tuple[Integers, Floats, Integers]:
    """Surviving hypotheses of the sets ``first … last − 1``, those of the highest ratio.

    As `run_sequential_tests`; ``cells`` (n', n', n') of `image_cells`, ``ring`` the detections that the triple's images
    are taken from.
    """
    prepared = sets.prepared
    survivors = np.full((chunks, keep, 5), -1, np.int64)
    ratios = np.full((chunks, keep), -np.inf)
    counts = np.zeros((chunks, 3), np.int64)
    n_target = grid.positions.shape[1]

    # a task is a set with one image of its first point
    each = len(ring.images)
    bounds = [each * bound for bound in chunk_bounds(first, last, chunks)]

    def test_some(first_task: int, last_task: int) -> None:
        scratch, block = np.zeros((2 * ROOTS, BLOCK)), np.zeros((BLOCK_ROWS, BLOCK))
        passed, picked = np.zeros((ROOTS, BLOCK), np.bool_), np.zeros((3, BLOCK), np.int64)
        row, stamp = np.zeros(ring.near.shape[1] + 1, np.int64), np.zeros(n_target, np.int64)
        _test_some(
            tables, grid, test, prepared, sets.shapes, cells, ring, allowed, first_task, last_task,
            np.array(bounds), scratch, block, passed, picked, row, stamp, survivors, ratios, counts,
        )  # fmt: skip

    run_in_chunks(test_some, bounds, threads, max(1, QUICK // max(ring.near.shape[1], 1) ** 2))
    return survivors, ratios, counts


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _test_some(  # type: ignore[no-untyped-def]
    tables, grid, test, sets, shapes, cells, ring, allowed, first, last, bounds, scratch, block, passed, picked,
    row, stamp, survivors, ratios, counts,
):  # fmt: skip
    """Tasks ``first … last − 1`` of chunks between ``bounds``: a set with one image of its first point.

    The arrays from ``scratch`` to ``stamp`` are scratch.
    """
    tables, grid, sets, shapes, cells, ring = borrow((tables, grid, sets, shapes, cells, ring))
    allowed, scratch, block, passed = borrow((allowed, scratch, block, passed))
    picked, row, stamp, survivors, ratios, counts = borrow((picked, row, stamp, survivors, ratios, counts))
    points_of, others_of, coordinates_of, own_of, _ = sets
    masked = allowed.shape[0] > 0
    images, near, inner = ring
    count, several = near.shape
    tick = 0
    for chunk in range(bounds.size - 1):
        start, end = max(bounds[chunk], first), min(bounds[chunk + 1], last)
        solved, tested, looked, filled = 0, 0, 0, 0
        for task in range(start, end):
            s, one = task // count, task % count
            i, shape, a = points_of[s], shapes[s], images[one]
            for two in range(several):
                b = near[one, two]
                if masked and not (allowed[i[0], a] and allowed[i[1], b]):
                    continue
                possible = 0
                for three in range(inner if two < inner else 0, several):
                    row[possible] = near[one, three]
                    possible += shape[cells[a, b, near[one, three]]]
                for place in range(possible):
                    c = row[place]
                    if c == b or (masked and not allowed[i[2], c]):
                        continue
                    picked[0, filled], picked[1, filled], picked[2, filled] = a, b, c
                    gather_listed(tables, grid, a, b, c, block, filled)
                    filled += 1
                    if filled == BLOCK:
                        some_tested, some_looked = _test_block(
                            tables, grid, test, i, others_of[s], coordinates_of[s], own_of[s], s, filled,
                            masked, allowed, scratch, block, passed, picked, stamp, tick,
                            survivors[chunk], ratios[chunk],
                        )  # fmt: skip
                        solved, tested, looked = solved + filled, tested + some_tested, looked + some_looked
                        tick, filled = tick + some_tested, 0
            if filled > 0 and (one == count - 1 or task == end - 1):  # a block is of one set
                some_tested, some_looked = _test_block(
                    tables, grid, test, i, others_of[s], coordinates_of[s], own_of[s], s, filled,
                    masked, allowed, scratch, block, passed, picked, stamp, tick, survivors[chunk], ratios[chunk],
                )  # fmt: skip
                solved, tested, looked = solved + filled, tested + some_tested, looked + some_looked
                tick, filled = tick + some_tested, 0
        counts[chunk, 0] += solved
        counts[chunk, 1] += tested
        counts[chunk, 2] += looked


@part
def _test_block(  # type: ignore[no-untyped-def]
    tables, grid, test, i, others, coordinates, own, s, filled, masked, allowed, scratch, block, passed, picked, stamp,
    tick, survivors, ratios,
):  # fmt: skip
    """Solve and test the listed image triples of one set; solutions tested and points looked up."""
    solve_listed(tables, i, block, filled, scratch)
    front = (
        own[0, 0], own[0, 1], own[0, 2], own[0, 3], own[1, 0], own[1, 1], own[1, 2], own[1, 3],
        own[2, 0], own[2, 1], own[2, 2], own[2, 3],
    )  # fmt: skip
    for root in range(ROOTS):
        for k in range(filled):
            real, frame = listed_frame(tables, i, block, k, scratch, root)
            real = real & (facing_excess(frame, front[:4], block[0, k], block[1, k], block[2, k]) <= 0.0)
            real = real & (facing_excess(frame, front[4:8], block[3, k], block[4, k], block[5, k]) <= 0.0)
            real = real & (facing_excess(frame, front[8:], block[6, k], block[7, k], block[8, k]) <= 0.0)
            passed[root, k] = real
    tested, looked, weakest = 0, 0, find_weakest(ratios)
    for k in range(filled):
        for root in range(ROOTS):
            if not passed[root, k]:
                continue
            tested += 1
            stamp[picked[0, k]] = stamp[picked[1, k]] = stamp[picked[2, k]] = tick + tested
            _, frame = listed_frame(tables, i, block, k, scratch, root)
            ratio, hits, own_lookups = likelihood_ratio(
                grid, test, others, coordinates, masked, allowed, frame, stamp, tick + tested
            )
            looked += own_lookups
            if ratio > ratios[weakest] and hits + 3 >= test.least:
                found = s, root, picked[0, k], picked[1, k], picked[2, k]
                weakest = keep_survivor(survivors, ratios, weakest, ratio, found)
    return tested, looked
