"""Sequential tests of local triples: points that lie close together, with images that lie close together.

On an object that hides part of itself wide triples are hardly ever visible as a whole, and neighbours mostly are. Of n'
detections n' k² image triples are then tried instead of n'³. A small triple predicts only what is near it, so only the
nearest points are looked up.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.jit.threads import chunk_bounds, run_in_chunks
from rootmatch.samplers.guided.detection_grid import DetectionGrid, field_of
from rootmatch.samplers.guided.dispatch import gather_listed, listed_frame, solve_listed
from rootmatch.samplers.guided.likelihood_ratio import find_weakest, keep_survivor, likelihood_ratio
from rootmatch.samplers.guided.screening import ROOTS, cell_of
from rootmatch.samplers.guided.sequential_test import QUICK, PreparedSets, SequentialTest, lookups_before_dropped
from rootmatch.samplers.guided.visible_triples import BLOCK, BLOCK_ROWS

FRAME = 12
"""Numbers of the frame of a triple in the camera."""


def run_local_tests(
    tables: Any,
    grid: DetectionGrid,
    test: SequentialTest,
    sets: PreparedSets,
    near: Integers,
    allowed: Bools,
    keep: int,
    chunks: int,
    threads: int = 1,
) -> tuple[Integers, Floats, Integers]:
    """Surviving hypotheses of triples of source points, those of the highest ratio.

    As `rootmatch.samplers.guided.sequential_test.run_sequential_tests`, of all ``sets``, whose other points are only
    those near them. ``near`` (n', k) are the detections near each: images of a triple's second and third point if that
    one is the image of its first.
    """
    survivors = np.full((chunks, keep, 5), -1, np.int64)
    ratios = np.full((chunks, keep), -np.inf)
    counts = np.zeros((chunks, 3), np.int64)
    flat_cells = grid.cells.reshape(-1)
    lookups = lookups_before_dropped(test, sets.others.shape[1], sets.points.shape[1])

    # a task is a set with one image of its first point
    bounds = [len(near) * bound for bound in chunk_bounds(0, len(sets.points), chunks)]

    def test_some(first: int, last: int) -> None:
        scratch, block = np.zeros((2 * ROOTS, BLOCK)), np.zeros((BLOCK_ROWS, BLOCK))
        frames, hit, picked = np.zeros((FRAME, BLOCK)), np.zeros((2, BLOCK), np.int64), np.zeros((3, BLOCK), np.int64)
        stamp = np.zeros(grid.positions.shape[1], np.int64)
        _test_some(
            tables, grid, flat_cells, test, sets, near, allowed, lookups, first, last, np.array(bounds), scratch, block,
            frames, hit, picked, stamp, survivors, ratios, counts,
        )  # fmt: skip

    run_in_chunks(test_some, bounds, threads, max(1, QUICK // near.shape[1] ** 2))
    return survivors, ratios, counts


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _test_some(  # type: ignore[no-untyped-def]
    tables, grid, flat_cells, test, sets, near, allowed, lookups, first, last, bounds,
    scratch, block, frames, hit, picked, stamp, survivors, ratios, counts,
):  # fmt: skip
    """Tasks ``first … last − 1`` of chunks between ``bounds``; the arrays from ``scratch`` to ``stamp`` are scratch."""
    tables, grid, flat_cells, sets, near = borrow((tables, grid, flat_cells, sets, near))
    allowed, scratch, block, frames, hit = borrow((allowed, scratch, block, frames, hit))
    picked, stamp, survivors, ratios, counts = borrow((picked, stamp, survivors, ratios, counts))
    points_of, others_of, coordinates_of, _, _ = sets
    masked = allowed.shape[0] > 0
    n_target, several = near.shape
    pairs = several * several
    tick = 0
    for chunk in range(bounds.size - 1):
        start, end = max(bounds[chunk], first), min(bounds[chunk + 1], last)
        if start >= end:
            continue
        solved, tested, filled = 0, 0, 0
        for task in range(start, end):
            s, a = task // n_target, task % n_target
            i = points_of[s]
            whole = a == n_target - 1 or task == end - 1  # a block is of one set
            for pair in range(pairs):
                b, c = near[a, pair // several], near[a, pair % several]
                free = b != c
                if masked:
                    free = free and allowed[i[0], a] and allowed[i[1], b] and allowed[i[2], c]
                if free:
                    picked[0, filled], picked[1, filled], picked[2, filled] = a, b, c
                    gather_listed(tables, grid, a, b, c, block, filled)
                    filled += 1
                if filled == BLOCK or (whole and pair == pairs - 1 and filled > 0):
                    solve_listed(tables, i, block, filled, scratch)
                    for root in range(ROOTS):
                        tested += _screen(
                            tables, grid, flat_cells, i, coordinates_of[s], lookups, filled, root, block, scratch,
                            frames, hit,
                        )  # fmt: skip
                        tick = _test_block(
                            grid, test, others_of[s], coordinates_of[s], s, filled, root, masked, allowed,
                            frames, hit, picked, stamp, tick, survivors[chunk], ratios[chunk],
                        )  # fmt: skip
                    solved += filled
                    filled = 0
        counts[chunk, 0] += solved
        counts[chunk, 1] += tested
        counts[chunk, 2] += tested * lookups


@part
def _screen(tables, grid, flat_cells, i, coordinates, lookups, filled, root, block, scratch, frames, hit):  # type: ignore[no-untyped-def]
    """Frames of a block at one root, and in ``hit[1]`` which of them predict a detection where there is one.

    Loops that vectorise; how many solutions there are.
    """
    found = 0
    field, whole = field_of(grid), grid.whole
    for k in range(filled):
        real, frame = listed_frame(tables, i, block, k, scratch, root)
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


@part
def _test_block(  # type: ignore[no-untyped-def]
    grid, test, others, coordinates, s, filled, root, masked, allowed, frames, hit, picked, stamp, tick,
    survivors, ratios,
):  # fmt: skip
    """Test what the screening leaves of a block, one by one; the last stamp used."""
    weakest = find_weakest(ratios)
    for k in range(filled):
        if hit[1, k] == 0:
            continue
        tick += 1
        stamp[picked[0, k]] = stamp[picked[1, k]] = stamp[picked[2, k]] = tick
        frame = (
            frames[0, k], frames[1, k], frames[2, k], frames[3, k], frames[4, k], frames[5, k],
            frames[6, k], frames[7, k], frames[8, k], frames[9, k], frames[10, k], frames[11, k],
        )  # fmt: skip
        ratio, hits, _ = likelihood_ratio(grid, test, others, coordinates, masked, allowed, frame, stamp, tick)
        if ratio > ratios[weakest] and hits + 3 >= test.least:
            found = s, root, picked[0, k], picked[1, k], picked[2, k]
            weakest = keep_survivor(survivors, ratios, weakest, ratio, found)
    return tick
