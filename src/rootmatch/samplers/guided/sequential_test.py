"""The sequential probability ratio test that drops false hypotheses after one or two points.

A minimal set of correspondences is solved. Each solution is a hypothesis: it carries the other source points into the
camera's frame, where each is looked up in a grid of detections. A detection near the prediction raises the
log-likelihood ratio by the density of its distance over the density of detections; an empty position lowers it by the
probability that the point is not visible. A hypothesis whose ratio falls below a floor is dropped (Wald 1945). The
survivors are verified with the covariance of each prediction in `rootmatch.samplers.guided.verification`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.jit.threads import chunk_bounds, run_in_chunks
from rootmatch.problems.padding import pad_rows, padded_places, select_targets, target_columns
from rootmatch.samplers.guided.detection_grid import DetectionGrid
from rootmatch.samplers.guided.dispatch import hypothesis_kernels, set_known, solve_set
from rootmatch.samplers.guided.likelihood_ratio import keep_likeliest
from rootmatch.samplers.guided.screening import Screened, Work, screen

VISIBLE, VISIBLE_OF_MANY = 0.85, 0.3
"""Fraction of the source points assumed visible at first, for one motion and for several, each of which sees its own
points alone."""
DECAY = 0.75
"""Factor on that fraction from one wave of minimal sets to the next: ever more patience with hidden points."""
MIN_VISIBLE = 0.2
"""Fraction below which the assumption never falls, unless it is far lower at first."""
MIN_OF_SPARSE = 2.0
"""The same over the first one, where detections are so few that no pose shows so many points: a test that assumes more
than there can be drops what is right. Of 120 lamps of which 7 and 8 are detected, the right pose is met after a fifth
to a half of the evaluations that a fraction of 0.2 takes, and with a factor of 1 after twice as many."""
MIN_VISIBLE_ODDS = 1.5
"""Least fraction over the chance of a hit by clutter; below 1 a hit would be no evidence."""
MAX_CLUTTER = 0.6
"""Chance of a hit by clutter beyond which it is not believed; times `MIN_VISIBLE_ODDS` it is a probability."""
SHARPNESS = 2.5
"""The gate over the deviation of a true detection from its prediction, which also has the errors of the minimal set."""
DROP_RATIO = 0.03
"""Likelihood ratio below which a hypothesis is dropped."""


class SequentialTest(NamedTuple):
    """The sequential test as kernels take it, in log-likelihood ratios."""

    hit: float
    """Gain of a detection exactly at the prediction."""
    fall: float
    """Loss at the rim of the gate, quadratic in the distance."""
    miss: float
    """Gain of an empty position; negative."""
    floor: float
    """A hypothesis below it is dropped."""
    minimum: int
    """Correspondences, the minimal set included, that a reported survivor must have."""
    normals: bool
    """Whether any source point has a normal."""
    facing: float = 0.0
    """Cosine between normal and direction to the camera below which a point is not looked up."""


def sequential_test(
    clutter: float, visible: float, wave: int, *, minimum: int, normals: bool, facing: float = 0.0
) -> SequentialTest:
    """The sequential test for one wave of minimal sets.

    Parameters
    ----------
    clutter : float
        Mean number of clutter detections within a gate.
    visible : float
        Fraction of the source points assumed visible in the first wave.
    wave : int
        Number of the wave, from 0.
    least, normals, facing
        See `SequentialTest`.
    """
    met = min(1.0 - math.exp(-clutter), MAX_CLUTTER)
    least_seen = min(MIN_VISIBLE, MIN_OF_SPARSE * visible)
    seen = max(visible * DECAY**wave, least_seen, MIN_VISIBLE_ODDS * met)
    fall = 0.5 * SHARPNESS**2
    return SequentialTest(
        hit=math.log(seen / met) + math.log(fall),
        fall=fall,
        miss=math.log((1.0 - seen) / (1.0 - met)),
        floor=math.log(DROP_RATIO),
        minimum=minimum,
        normals=normals,
        facing=facing,
    )


class PreparedSets(NamedTuple):
    """Minimal sets of source points and what all their images share."""

    points: Integers
    """(S, m) source points."""
    others: Integers
    """(S, n − m) the other points, in the order in which they are looked up."""
    coordinates: Floats
    """(S, 7, n − m) position and normal of the others in the frame of the set, and the cosine of its view angle."""
    own: Floats
    """(S, m, 4) normals of the set's points in its frame, and the cosines of their view angles."""
    offset: Integers
    """(S,) index into the arrangements where each set begins."""


def prepare_sets(tables: Any, points: Integers, others: Integers, offset: Integers) -> PreparedSets:
    """`PreparedSets` of minimal sets (S, m), the other points (S, n − m) of each and their offsets (S,)."""
    coordinates, own = hypothesis_kernels(tables).coordinates(tables, points, others)
    return PreparedSets(points, others, coordinates, own, offset)


QUICK = 5_000
"""Minimal sets that are solved before signals are looked for: a few milliseconds at the most. Changes no result."""
TESTED = 64
"""Hypotheses that are tested together, which costs one call. Changes no result."""
CLASSES = 16
"""Classes of points with the same possible detections up to which those of each are solved alone: each takes tables of
its own. A round value: marks have a few colours. Changes what is solved, not what is found."""


def run_sequential_tests(
    tables: Any,
    grid: DetectionGrid,
    test: SequentialTest,
    sets: PreparedSets,
    arrangements: NDArray[np.int32],
    first: int,
    last: int,
    allowed: Bools,
    keep: int,
    chunks: int,
    threads: int = 1,
    images: Integers | None = None,
) -> tuple[Integers, Floats, Integers]:
    """Surviving hypotheses of the tasks ``first … last − 1``, those of the highest ratio.

    Parameters
    ----------
    tables, grid, test, sets
        The tables may have padding behind the targets.
    arrangements : (P, m − 1) int32 array
        Images of all points of a minimal set but the last, which runs over all detections, as places in ``images``.
    first, last : int
        Task t is arrangement t // S + offset, modulo P, of set t % S.
    allowed : (n, n') bool array, or (0, 0) for all
    keep : int
        Most hypotheses that a chunk reports.
    chunks : int
        Parts that the tasks are divided into; the result depends on it, not on the number of threads.
    threads : int
        Python threads: compiled code does not hold the lock, and it compiles in half the time of a parallel loop.
    images : (L,) int64 array, optional
        The only detections that a minimal set may have, all by default; the other points may be at any ``allowed`` one.

    Returns
    -------
    survivors : (chunks, keep, m + 2) int64 array
        Minimal set, root, and image of each of its points; −1 first where there is none.
    ratios : (chunks, keep) array
        Log-likelihood ratio.
    counts : (chunks, 3) int64 array
        Minimal sets solved, solutions tested, points looked up.
    """
    survivors = np.full((chunks, keep, sets.points.shape[1] + 2), -1, np.int64)
    ratios = np.full((chunks, keep), -np.inf)
    counts = np.zeros((chunks, 3), np.int64)
    n_target, m = grid.positions.shape[1], sets.points.shape[1]
    flat_cells, solutions = grid.cells.reshape(-1), hypothesis_kernels(tables).solutions
    # where normals tell, few solutions of a set show their own three points; those are tested one by one
    lookups = 0 if test.normals else lookups_before_dropped(test, sets.others.shape[1], m)

    bounds = chunk_bounds(first, last, chunks)
    groups = [_group_of_sets(tables, grid, sets, allowed, images=images, own=own) for own in _classes(sets, allowed)]

    def test_some(first_task: int, last_task: int) -> None:
        for group in groups:
            if group.width == 0:
                continue
            columns = len(padded_places(group.width))
            scratch = np.empty((2 * solutions, columns))
            cells = np.empty((2, max(columns, lookups)), np.int32)
            work = Work(cells, cells.view(np.uint32), np.empty(columns, np.bool_), np.empty(columns + 1, np.int64))
            room = TESTED + solutions * columns
            hypotheses = Screened(np.empty((room, 12)), np.empty((room, 2 + m), np.int64))
            _test_some(
                group.tables, group.grid, grid, group.images, flat_cells, test, sets, group.own, arrangements, allowed,
                lookups, first_task, last_task, np.array(bounds), group.width, scratch, work, hypotheses,
                np.zeros(n_target, np.int64), np.zeros(m, np.int64), survivors, ratios, counts,
            )  # fmt: skip

    run_in_chunks(test_some, bounds, threads, max(1, QUICK // max(n_target, 1)))
    return survivors, ratios, counts


class _Group(NamedTuple):
    """Minimal sets whose last points may have the same detections, which are solved together."""

    own: Integers
    """(G,) their numbers."""
    images: Integers
    """(L,) detections, those of the last points first."""
    width: int
    """How many these are."""
    tables: Any
    """Of ``images``, with padding behind them."""
    grid: DetectionGrid
    """With their rays."""


def _classes(sets: PreparedSets, allowed: Bools) -> list[Integers]:
    """Numbers of the sets by the detections that their last points may have; all together if those differ by point."""
    every = np.arange(len(sets.points))
    if not allowed.size or ((of_last := allowed[sets.points[:, -1]]) == of_last[:1]).all():
        return [every]
    rows, label = np.unique(of_last, axis=0, return_inverse=True)
    return [np.flatnonzero(label.ravel() == k) for k in range(len(rows))] if len(rows) <= CLASSES else [every]


def _group_of_sets(
    tables: Any, grid: DetectionGrid, sets: PreparedSets, allowed: Bools, *, images: Integers | None, own: Integers
) -> _Group:
    """What the sets ``own`` are solved with; ``images``: the only detections, all by default."""
    n_target = grid.positions.shape[1]
    columns = target_columns(tables, n_target)
    if images is None and not allowed.size:
        solved_grid = grid._replace(rays=pad_rows(grid.rays, columns))
        return _Group(own, np.arange(n_target), n_target, tables, solved_grid)
    chosen = np.arange(n_target) if images is None else images
    width = len(chosen)
    if allowed.size:
        of_last = allowed[sets.points[own, -1]].any(axis=0)[chosen]
        chosen, width = chosen[np.argsort(~of_last, kind="stable")], int(of_last.sum())
    places = chosen[padded_places(len(chosen))]
    fewer = select_targets(tables, places, columns)
    return _Group(own, chosen, width, fewer, grid._replace(rays=np.take(grid.rays, places, axis=1)))


def lookups_before_dropped(test: SequentialTest, others: int, minimal: int) -> int:
    """Points that are looked up before a hypothesis that misses all of them is dropped; 0 where none is."""
    lookups = int(test.floor / test.miss) + 1
    # a hypothesis without any hit is not reported
    return min(lookups, others) if lookups <= others or test.minimum > minimal else 0


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _test_some(  # type: ignore[no-untyped-def]
    tables, solved_grid, grid, images, flat_cells, test, sets, members, arrangements, allowed, lookups, first, last,
    bounds, width, scratch, work, hypotheses, stamp, j, survivors, ratios, counts,
):  # fmt: skip
    """Tasks ``first … last − 1`` of chunks between ``bounds``, of the sets ``members``.

    Columns of ``tables`` and of the rays of ``solved_grid`` are those of the detections ``images``, of which the first
    ``width`` are solved as images of last points.
    ``scratch`` (2 s, columns) with s solutions of a set, ``work``, ``hypotheses``, ``stamp`` (n',) and j (m,) are
    scratch, made outside, as each array made in jitted code costs compile time.
    """
    tables, solved_grid, grid, images = borrow((tables, solved_grid, grid, images))
    flat_cells, sets, members, arrangements, allowed = borrow((flat_cells, sets, members, arrangements, allowed))
    scratch, work, hypotheses, stamp, j = borrow((scratch, work, hypotheses, stamp, j))
    survivors, ratios, counts = borrow((survivors, ratios, counts))
    points_of, others_of, coordinates_of, normals_of, offset = sets
    count, m = points_of.shape
    masked = allowed.shape[0] > 0
    tick = 0
    for chunk in range(bounds.size - 1):
        start, end = max(bounds[chunk], first), min(bounds[chunk + 1], last)
        if start >= end:
            continue
        solved, tested, looked, filled = 0, 0, 0, 0
        turn, place = start // count, 0
        while place < members.size and members[place] < start % count:
            place += 1
        while True:
            if place == members.size:
                turn, place = turn + 1, 0
            s = members[place]
            place += 1
            if turn * count + s >= end:
                break
            i = points_of[s]
            rank = (offset[s] + turn) % arrangements.shape[0]
            possible = True
            for p in range(m - 1):
                j[p] = arrangements[rank, p]
                possible = possible and (not masked or allowed[i[p], images[j[p]]])
            if not possible:
                continue
            solve_set(tables, i, j, scratch)
            solved += width
            for p in range(m - 1):
                solved -= 1 if j[p] < width else 0
            for row in range(scratch.shape[0]):
                for p in range(m - 1):
                    if j[p] < width:
                        scratch[row, j[p]] = np.nan
                for k in range(width, scratch.shape[1]):
                    scratch[row, k] = np.nan
                if masked:
                    for k in range(width):
                        if not allowed[i[m - 1], images[k]]:
                            scratch[row, k] = np.nan
            before = set_known(tables, solved_grid, i, j)
            found, filled = screen(
                tables, solved_grid, flat_cells, test.normals, before, coordinates_of[s], normals_of[s], j, lookups,
                scratch, work, s, hypotheses, filled,
            )  # fmt: skip
            tested += found
            looked += found * lookups
            if filled >= TESTED:
                tick, own = keep_likeliest(
                    grid, test, others_of, coordinates_of, masked, allowed, hypotheses, filled, stamp, tick,
                    images, survivors[chunk], ratios[chunk],
                )  # fmt: skip
                looked, filled = looked + own - filled * lookups, 0
        tick, own = keep_likeliest(
            grid, test, others_of, coordinates_of, masked, allowed, hypotheses, filled, stamp, tick,
            images, survivors[chunk], ratios[chunk],
        )  # fmt: skip
        looked += own - filled * lookups
        counts[chunk, 0] += solved
        counts[chunk, 1] += tested
        counts[chunk, 2] += looked
