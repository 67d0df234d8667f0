"""Sequential tests of triples of which only some images are tried: those are listed, and solved side by side.

As `rootmatch.samplers.guided.sequential_test`. Where normals tell which points face the camera, a table of shapes lets
few images through, and the other points are looked up in the order in which they are likely to be visible beside the
triple. On a large object that hides part of itself, wide triples are hardly ever visible as a whole, and neighbours
mostly are: local triples have images that lie close together, of n' detections n' k² in the place of n'³, and predict
only what is near them.
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
from rootmatch.samplers.guided.detection_grid import DetectionGrid, field_of
from rootmatch.samplers.guided.dispatch import gather_listed, listed_frame, solve_listed
from rootmatch.samplers.guided.likelihood_ratio import find_weakest, keep_survivor, likelihood_ratio
from rootmatch.samplers.guided.screening import ROOTS, cell_of, facing_excess
from rootmatch.samplers.guided.sequential_test import QUICK, PreparedSets, SequentialTest, lookups_before_dropped

BLOCK = 64
"""Image triples that are solved together."""
BLOCK_ROWS = 12
"""Numbers of an image triple: its bearings and the versines between them."""
FRAME = 12
"""Numbers of the frame of a triple in the camera."""
ANY_SHAPE, NO_CELLS = np.ones((1, 1), np.bool_), np.empty((0, 0, 0), np.int16)
"""Of images that may have any shape."""


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
        maximum, minimum = self.near.shape[1], self.inner
        return int(len(self.images) * (maximum * (maximum - 1) - minimum * (minimum - 1)))


def make_rings(images: Integers, positions: Floats, sizes: Sequence[int]) -> list[Ring]:
    """Rings of so many detections about each of some ``images`` (L,), ascending; ``positions`` (2, n') of all."""
    place = positions[:, images]
    distance2 = ((place[:, :, None] - place[:, None]) ** 2).sum(axis=0)
    np.fill_diagonal(distance2, -1.0)
    near = images[distance2.argsort(axis=1, kind="stable")[:, 1:]]
    return [Ring(images, near[:, :maximum].copy(), minimum) for minimum, maximum in pairwise([0, *sizes])]


def run_listed_tests(
    tables: Any,
    grid: DetectionGrid,
    test: SequentialTest,
    sets: PreparedSets,
    ring: Ring,
    *,
    allowed: Bools,
    keep: int,
    chunks: int,
    threads: int = 1,
    first: int = 0,
    last: int | None = None,
    shapes: Bools = ANY_SHAPE,
    cells: NDArray[np.int16] = NO_CELLS,
) -> tuple[Integers, Floats, Integers]:
    """Surviving hypotheses of the sets ``first … last − 1``, those of the highest ratio.

    As `rootmatch.samplers.guided.sequential_test.run_sequential_tests`. ``ring``: the detections that the triple's
    images are taken from; ``shapes`` (S, CELLS): those that the image of each set may have, by ``cells`` (n', n', n')
    of `image_cells`; any by default.
    """
    survivors = np.full((chunks, keep, 5), -1, np.int64)
    ratios = np.full((chunks, keep), -np.inf)
    counts = np.zeros((chunks, 3), np.int64)
    flat_cells, several = grid.cells.reshape(-1), ring.near.shape[1]
    # where normals tell, few solutions show their own three points; those are tested one by one
    lookups = 0 if test.normals else lookups_before_dropped(test, sets.others.shape[1], sets.points.shape[1])

    # a task is a set with one image of its first point
    each = len(ring.images)
    bounds = [each * bound for bound in chunk_bounds(first, len(sets.points) if last is None else last, chunks)]

    def test_some(first_task: int, last_task: int) -> None:
        roots, block = np.zeros((2 * ROOTS, BLOCK)), np.zeros((BLOCK_ROWS, BLOCK))
        frames, hit, picked = np.zeros((FRAME, BLOCK)), np.zeros((2, BLOCK), np.int64), np.zeros((3, BLOCK), np.int64)
        row, stamp = np.zeros(several + 1, np.int64), np.zeros(grid.positions.shape[1], np.int64)
        _test_some(
            tables, grid, flat_cells, test, sets, shapes, cells, ring, allowed, lookups, first_task, last_task,
            np.array(bounds), (roots, block, frames, hit, picked, stamp), row, survivors, ratios, counts,
        )  # fmt: skip

    run_in_chunks(test_some, bounds, threads, max(1, QUICK // max(several, 1) ** 2))
    return survivors, ratios, counts


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _test_some(  # type: ignore[no-untyped-def]
    tables, grid, flat_cells, test, sets, shapes, cells, ring, allowed, lookups, first, last, bounds, scratch, row,
    survivors, ratios, counts,
):  # fmt: skip
    """Tasks ``first … last − 1`` of chunks between ``bounds``: a set with one image of its first point.

    ``scratch`` and ``row`` are scratch.
    """
    tables, grid, flat_cells, sets, shapes = borrow((tables, grid, flat_cells, sets, shapes))
    cells, ring, allowed, scratch, row = borrow((cells, ring, allowed, scratch, row))
    survivors, ratios, counts = borrow((survivors, ratios, counts))
    points_of, others_of, coordinates_of, own_of, _ = sets
    masked, shaped = allowed.shape[0] > 0, cells.shape[0] > 0
    images, near, inner = ring
    count, several = near.shape
    block, picked = scratch[1], scratch[4]
    tick = 0
    for chunk in range(bounds.size - 1):
        start, end = max(bounds[chunk], first), min(bounds[chunk + 1], last)
        filled = 0
        for task in range(start, end):
            s, one = task // count, task % count
            i, a = points_of[s], images[one]
            known = i, others_of[s], coordinates_of[s], own_of[s], lookups, s
            for two in range(several):
                b = near[one, two]
                if masked and not (allowed[i[0], a] and allowed[i[1], b]):
                    continue
                possible = 0
                for three in range(inner if two < inner else 0, several):
                    row[possible] = near[one, three]
                    possible += shapes[s, cells[a, b, near[one, three]]] if shaped else 1
                for place in range(possible):
                    c = row[place]
                    if c == b or (masked and not allowed[i[2], c]):
                        continue
                    picked[0, filled], picked[1, filled], picked[2, filled] = a, b, c
                    gather_listed(tables, grid, a, b, c, block, filled)
                    filled += 1
                    if filled == BLOCK:
                        tick = _test_block(
                            tables, grid, flat_cells, test, known, filled, masked, allowed, scratch, tick,
                            survivors[chunk], ratios[chunk], counts[chunk],
                        )  # fmt: skip
                        filled = 0
            if filled > 0 and (one == count - 1 or task == end - 1):  # a block is of one set
                tick = _test_block(
                    tables, grid, flat_cells, test, known, filled, masked, allowed, scratch, tick,
                    survivors[chunk], ratios[chunk], counts[chunk],
                )  # fmt: skip
                filled = 0


@part
def _test_block(  # type: ignore[no-untyped-def]
    tables, grid, flat_cells, test, known, filled, masked, allowed, scratch, tick, survivors, ratios, counts
):
    """Solve the listed image triples of one set, and test what the screening leaves, one by one; the last stamp used.

    ``counts`` (3,) grow by the triples solved, the solutions tested, and the points looked up.
    """
    i, others, coordinates, own, lookups, s = known
    roots, block, frames, hit, picked, stamp = scratch
    solve_listed(tables, i, block, filled, roots)
    weakest = find_weakest(ratios)
    counts[0] += filled
    for root in range(ROOTS):
        found = _screen(
            tables, grid, flat_cells, test.normals, i, coordinates, own, lookups, filled, root, block, roots, frames,
            hit,
        )  # fmt: skip
        counts[1] += found
        counts[2] += found * lookups
        for k in range(filled):
            if hit[1, k] == 0:
                continue
            tick += 1
            stamp[picked[0, k]] = stamp[picked[1, k]] = stamp[picked[2, k]] = tick
            frame = (
                frames[0, k], frames[1, k], frames[2, k], frames[3, k], frames[4, k], frames[5, k],
                frames[6, k], frames[7, k], frames[8, k], frames[9, k], frames[10, k], frames[11, k],
            )  # fmt: skip
            ratio, hits, own_lookups = likelihood_ratio(
                grid, test, others, coordinates, masked, allowed, frame, stamp, tick
            )
            counts[2] += own_lookups if lookups == 0 else 0
            if ratio > ratios[weakest] and hits + 3 >= test.minimum:
                place = s, root, picked[0, k], picked[1, k], picked[2, k]
                weakest = keep_survivor(survivors, ratios, weakest, ratio, place)
    return tick


@part
def _screen(  # type: ignore[no-untyped-def]
    tables, grid, flat_cells, normals, i, coordinates, own, lookups, filled, root, block, roots, frames, hit
):
    """Frames of a block at one root, and in ``hit[1]`` which of them may be right; how many solutions there are.

    In those the triple's own points face the camera, and one of the first others is predicted where a detection is.
    Loops that vectorise.
    """
    found, field, whole = 0, field_of(grid), grid.whole
    front = (
        own[0, 0], own[0, 1], own[0, 2], own[0, 3], own[1, 0], own[1, 1], own[1, 2], own[1, 3],
        own[2, 0], own[2, 1], own[2, 2], own[2, 3],
    )  # fmt: skip
    for k in range(filled):
        real, frame = listed_frame(tables, i, block, k, roots, root)
        if normals:
            real = real & (facing_excess(frame, front[:4], block[0, k], block[1, k], block[2, k]) <= 0.0)
            real = real & (facing_excess(frame, front[4:8], block[3, k], block[4, k], block[5, k]) <= 0.0)
            real = real & (facing_excess(frame, front[8:], block[6, k], block[7, k], block[8, k]) <= 0.0)
        ox, oy, oz, ex, ey, ez, fx, fy, fz, gx, gy, gz = frame
        # a point behind the camera is in no cell
        frames[0, k], frames[1, k], frames[2, k] = ox, oy, oz if real else -np.inf
        frames[3, k], frames[4, k], frames[5, k] = ex, ey, ez
        frames[6, k], frames[7, k], frames[8, k] = fx, fy, fz
        frames[9, k], frames[10, k], frames[11, k] = gx, gy, gz
        hit[1, k] = lookups == 0 and real
        found += real
    for r in range(lookups):
        a, b, c = coordinates[0, r], coordinates[1, r], coordinates[2, r]
        for k in range(filled):
            x = frames[0, k] + a * frames[3, k] + b * frames[6, k] + c * frames[9, k]
            y = frames[1, k] + a * frames[4, k] + b * frames[7, k] + c * frames[10, k]
            z = frames[2, k] + a * frames[5, k] + b * frames[8, k] + c * frames[11, k]
            hit[0, k] = cell_of(whole, field, x, y, z)
        for k in range(filled):
            hit[1, k] |= flat_cells[hit[0, k]] >= 0
    return found
