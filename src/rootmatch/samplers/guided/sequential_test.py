"""Minimal sets propose where every point is seen; a sequential test ends the false proposals after a look or two.

A minimal set of correspondences is solved, each of its roots carries the other source points into the camera, and each
is looked up in a raster of detections. The evidence is a log-likelihood ratio: a detection near the prediction speaks
for the proposal by the density of its distance against the density of detections, an empty place against it by the
chance that a point is not seen. A proposal whose ratio falls below a floor is dropped (Wald's sequential probability
ratio test). What survives is weighed with the covariance of each prediction, in
`rootmatch.samplers.guided.verification`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, part
from rootmatch.jit.threads import in_threads
from rootmatch.problems.padding import target_columns, with_room
from rootmatch.samplers.guided.detection_grid import Raster, look_up
from rootmatch.samplers.guided.dispatch import set_coordinates, set_frame, set_known, solve_set
from rootmatch.samplers.guided.screening import ROOTS, screen

__all__ = ["ROOTS", "Rules", "Sets", "prepare_sets", "propose"]


class Rules(NamedTuple):
    """The sequential test, in log-likelihood ratios."""

    hit: float
    """Of a detection at the very place."""
    fall: float
    """What is lost of it at the rim of the gate (quadratic in the distance)."""
    miss: float
    """Of an empty place, negative."""
    floor: float
    """Below it a proposal is dropped."""
    least: int
    """Correspondences, the minimal set included, below which a survivor is not reported."""
    normals: bool
    """Whether any source point has a normal."""


class Sets(NamedTuple):
    """Minimal sets of source points and what is the same for all their images."""

    points: NDArray[np.int64]
    """(S, m) source points."""
    others: NDArray[np.int64]
    """(S, n − m) the rest, in the order in which they are looked up."""
    coordinates: NDArray[np.float64]
    """(S, n − m, 6) of the rest in the frame of the set: place and normal."""
    own: NDArray[np.float64]
    """(S, m, 3) normals of the set's points in its frame."""
    offset: NDArray[np.int64]
    """(S,) where in the list of arrangements each set begins."""


def prepare_sets(tables: Any, points: NDArray[np.int64], others: NDArray[np.int64], offset: NDArray[np.int64]) -> Sets:
    """`Sets` of minimal sets (S, m), the other points (S, n − m) of each and their offsets (S,)."""
    coordinates, own = set_coordinates(tables, points, others)
    return Sets(points, others, coordinates, own, offset)


@part
def _verify(raster, rules, others, coordinates, masked, allowed, frame, stamp, tick):  # type: ignore[no-untyped-def]
    """Log-likelihood ratio of a frame in the raster's basis, points found, points looked up; −∞ when dropped."""
    ox, oy, oz, ex, ey, ez, fx, fy, fz, gx, gy, gz = frame
    ratio = 0.0
    found = 0
    looked = 0
    fall = rules.fall / raster.gate2
    for r in range(others.shape[0]):
        a, b, c = coordinates[r, 0], coordinates[r, 1], coordinates[r, 2]
        x = ox + a * ex + b * fx + c * gx
        y = oy + a * ey + b * fy + c * gy
        z = oz + a * ez + b * fz + c * gz
        if rules.normals:
            a, b, c = coordinates[r, 3], coordinates[r, 4], coordinates[r, 5]
            away = (a * ex + b * fx + c * gx) * x + (a * ey + b * fy + c * gy) * y + (a * ez + b * fz + c * gz) * z
            if away > 0.0:
                continue
        looked += 1
        k, distance2 = look_up(raster, x, y, z)
        if k >= 0 and stamp[k] != tick and (not masked or allowed[others[r], k]):
            stamp[k] = tick
            hit = rules.hit - fall * distance2
            ratio += hit if hit > rules.miss else rules.miss
            found += 1
        else:
            ratio += rules.miss
            if ratio < rules.floor:
                ratio = -np.inf
                break
    return ratio, found, looked


def propose(
    tables: Any,
    raster: Raster,
    rules: Rules,
    sets: Sets,
    arrangements: NDArray[np.int32],
    first: int,
    last: int,
    allowed: NDArray[np.bool_],
    keep: int,
    chunks: int,
    threads: int = 1,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Best proposals among the tasks ``first … last − 1``.

    Parameters
    ----------
    tables, raster, rules, sets
        The tables may have room behind the targets.
    arrangements : (P, m − 1) int32 array
        Images of all points of a minimal set but the last, which runs over all detections.
    first, last : int
        Task t is arrangement t // S + offset, modulo P, of set t % S.
    allowed : (n, n') bool array, or (0, 0) for all
    keep : int
        Most proposals that a chunk reports.
    chunks : int
        Pieces that the tasks are cut into; the result depends on it, not on the number of threads.
    threads : int
        Threads of Python: compiled code does not hold its lock, and it compiles in half the time of a parallel loop.

    Returns
    -------
    found : (chunks, keep, m + 2) int64 array
        Minimal set, root, and image of each of its points; −1 first where there is none.
    ratios : (chunks, keep) array
        Log-likelihood ratio.
    counts : (chunks, 3) int64 array
        Minimal sets solved, solutions tested, points looked up.
    """
    found = np.full((chunks, keep, sets.points.shape[1] + 2), -1, np.int64)
    ratios = np.full((chunks, keep), -np.inf)
    counts = np.zeros((chunks, 3), np.int64)
    n_target, m = raster.places.shape[1], sets.points.shape[1]
    columns = target_columns(tables, n_target)
    raster = raster._replace(rays=with_room(raster.rays, columns))
    grid = raster.cells.reshape(-1)
    looks = _looks(rules, sets.others.shape[1], m)

    def examine(first_chunk: int, last_chunk: int) -> None:
        scratch = np.empty((2 * ROOTS, columns))
        cells = np.empty((2, columns), np.int64)
        passed = np.empty((ROOTS, columns), np.bool_)
        stamp = np.zeros(n_target, np.int64)
        image = np.zeros(m, np.int64)
        _examine(
            tables, raster, grid, rules, sets, arrangements, allowed, looks, first, last,
            first_chunk, last_chunk, chunks, scratch, cells, passed, stamp, image, found, ratios, counts,
        )  # fmt: skip

    in_threads(examine, chunks, threads)
    return found, ratios, counts


def _looks(rules: Rules, others: int, minimal: int) -> int:
    """Points that are looked up before a solution that misses all of them is dropped; 0 where none is."""
    looks = int(rules.floor / rules.miss) + 1
    # one that has found nothing at all is not reported
    return min(looks, others) if looks <= others or rules.least > minimal else 0


@njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy")
def _examine(  # type: ignore[no-untyped-def]
    tables, raster, grid, rules, sets, arrangements, allowed, looks, first, last, first_chunk, last_chunk, chunks,
    scratch, cells, passed, stamp, j, found, ratios, counts,
):  # fmt: skip
    """Chunks ``first_chunk … last_chunk − 1`` of the tasks.

    ``scratch`` (8, columns), ``cells`` (2, columns), ``passed`` (4, columns), ``stamp`` (n',) and j (m,) are its own:
    what could be allocated or filled in here is so outside, as each array made in jitted code costs compile time.
    """
    tables, raster, grid, sets, arrangements, allowed = borrowed((tables, raster, grid, sets, arrangements, allowed))
    scratch, cells, passed, stamp, j = borrowed((scratch, cells, passed, stamp, j))
    found, ratios, counts = borrowed((found, ratios, counts))
    points_of, others_of, coordinates_of, own_of, offset = sets
    count, m = points_of.shape
    n_target = raster.places.shape[1]
    masked = allowed.shape[0] > 0
    tick = 0
    for chunk in range(first_chunk, last_chunk):
        start, end = first + (last - first) * chunk // chunks, first + (last - first) * (chunk + 1) // chunks
        weakest, solved, tested, looked = 0, 0, 0, 0
        for task in range(start, end):
            s = task % count
            i = points_of[s]
            others = others_of[s]
            coordinates = coordinates_of[s]
            rank = (offset[s] + task // count) % arrangements.shape[0]
            possible = True
            for p in range(m - 1):
                j[p] = arrangements[rank, p]
                possible = possible and (not masked or allowed[i[p], j[p]])
            if not possible:
                continue
            solve_set(tables, i, j, scratch)
            solved += n_target - m + 1
            for k in range(scratch.shape[1]):
                free = k < n_target and (not masked or allowed[i[m - 1], k])
                for p in range(m - 1):
                    free = free and j[p] != k
                if not free:
                    for row in range(scratch.shape[0]):
                        scratch[row, k] = np.nan
            before = set_known(tables, raster, i, j)
            some = screen(
                tables, raster, grid, rules.normals, before, coordinates, own_of[s], j, looks, scratch, cells, passed
            )
            tested += some
            looked += some * looks
            for k in range(n_target):
                for root in range(ROOTS):
                    if not passed[root, k]:
                        continue
                    j[m - 1] = k
                    tick += 1
                    for p in range(m):
                        stamp[j[p]] = tick
                    _, frame = set_frame(tables, raster, before, k, scratch, root)
                    ratio, hits, looks_of_one = _verify(
                        raster, rules, others, coordinates, masked, allowed, frame, stamp, tick
                    )
                    looked += looks_of_one - looks
                    if ratio > ratios[chunk, weakest] and hits + m >= rules.least:
                        ratios[chunk, weakest] = ratio
                        found[chunk, weakest, 0] = s
                        found[chunk, weakest, 1] = root
                        for p in range(m):
                            found[chunk, weakest, 2 + p] = j[p]
                        weakest = 0
                        for q in range(ratios.shape[1]):
                            if ratios[chunk, q] < ratios[chunk, weakest]:
                                weakest = q
        counts[chunk, 0], counts[chunk, 1], counts[chunk, 2] = solved, tested, looked
