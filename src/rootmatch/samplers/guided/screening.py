"""Screening of all solutions of a minimal set at once: which of them predict a detection where there is one.

Nearly all solutions are false, and the sequential test drops each when the first points that it looks up meet no
detection. That is done here for every last image and root side by side, in a loop that vectorises; the rest, about one
in ten, is tested one by one. Among few detections a test looks up many points before it drops a solution: then these
are looked up side by side, for one solution after the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.decorators import scalar
from rootmatch.samplers.guided.detection_grid import NOBODY, field_of, position_of
from rootmatch.samplers.guided.dispatch import set_frame

ROOTS = 4
"""Most solutions of a minimal set; where a problem has fewer, the others are not there."""


ALONG = 8
"""Points that are looked up from which they fill vectors: those of AVX-512."""


class Work(NamedTuple):
    """Scratch of the screening."""

    cells: NDArray[np.int32]
    """(2, C) for C columns or points that are looked up, whichever are more."""
    places: NDArray[np.uint32]
    """(2, C), the memory of `cells` read as places."""
    met: Bools
    """(columns,)."""
    passed: Integers
    """(columns + 1,)."""


class Screened(NamedTuple):
    """Hypotheses that are tested one by one."""

    frames: Floats
    """(B, 12) frames of sets."""
    picked: Integers
    """(B, 2 + m) number of the set, root, and image of each of its points."""


@scalar
def cell_of(whole, field, x, y, z):  # type: ignore[no-untyped-def]
    """Number of the cell that a point (x, y, z) in the grid's basis projects to; outside, 0, which is empty."""
    left, top, scale, height, width = field
    u, v, there = position_of(whole, x, y, z)
    column = (u - left) * scale
    row = (v - top) * scale
    # written so that NaN is outside
    inside = there & (column >= 0.0) & (column < width) & (row >= 0.0) & (row < height)
    # 32 bits: conversions to 64 fill vectors on few processors
    return np.int32(row if inside else 0.0) * np.int32(width) + np.int32(column if inside else 0.0)


@scalar
def rotate_by_frame(frame, a, b, c):  # type: ignore[no-untyped-def]
    """A direction of the set's frame in the camera's frame."""
    _, _, _, ex, ey, ez, fx, fy, fz, gx, gy, gz = frame
    return a * ex + b * fx + c * gx, a * ey + b * fy + c * gy, a * ez + b * fz + c * gz


@scalar
def facing_excess(frame, normal, x, y, z):  # type: ignore[no-untyped-def]
    """Above 0 where a normal is beyond its view angle, for a point with the unit bearing (x, y, z)."""
    u, v, w = rotate_by_frame(frame, normal[0], normal[1], normal[2])
    return u * x + v * y + w * z + normal[3]


@scalar
def predict_cell(whole, field, frame, point):  # type: ignore[no-untyped-def]
    """Cell that a point with these coordinates in the set's frame projects to."""
    x, y, z = rotate_by_frame(frame, point[0], point[1], point[2])
    return cell_of(whole, field, x + frame[0], y + frame[1], z + frame[2])


@scalar
def position(coordinates, r):  # type: ignore[no-untyped-def]
    """Position of a point in the set's frame as a tuple, for a loop that vectorises."""
    return coordinates[0, r], coordinates[1, r], coordinates[2, r]


@scalar
def find_two_cells(tables, grid, field, before, one, two, scratch, root, cells):  # type: ignore[no-untyped-def]
    """Cells of two points at one root for every last image, and how many solutions there are; 0 where there is none."""
    whole, found = grid.whole, 0
    for k in range(scratch.shape[1]):
        real, frame = set_frame(tables, grid, before, k, scratch, root)
        first, second = predict_cell(whole, field, frame, one), predict_cell(whole, field, frame, two)
        cells[0, k] = first if real else np.int32(0)
        cells[1, k] = second if real else np.int32(0)
        found += real
    return found


@scalar
def list_met(flat_cells, places, met, earlier, passed):  # type: ignore[no-untyped-def]
    """List the last images one of whose two cells is not empty, or that were met ``earlier``; how many there are.

    ``places`` (2, columns) are the cells as unsigned numbers. Without a branch: one in ten is met, in no order.
    """
    count = np.uint64(0)
    for k in range(met.size):
        # negative where both are empty
        hit = (flat_cells[places[0, k]] & flat_cells[places[1, k]]) >= 0
        hit = hit | (earlier & met[k])
        met[k] = hit
        passed[count] = k
        count += np.uint64(hit)
    return count


@scalar
def list_meeting(  # type: ignore[no-untyped-def]
    tables, grid, flat_cells, field, before, coordinates, lookups, scratch, root, work
):  # fmt: skip
    """List the last images of solutions at one root that meet a detection; how many there are, and of solutions."""
    cells, places, _, passed = work
    whole, real, count = grid.whole, 0, 0
    for k in range(scratch.shape[1]):
        there, frame = set_frame(tables, grid, before, k, scratch, root)
        if not there:
            continue
        real += 1
        for r in range(lookups):
            cells[0, r] = predict_cell(whole, field, frame, position(coordinates, r))
        every = np.int16(NOBODY)
        for r in range(lookups):
            every &= flat_cells[places[0, r]]
        passed[count] = k
        count += 1 if every >= 0 else 0
    return count, real


@scalar
def list_facing(tables, grid, normals, before, own, bearings, scratch, root, passed):  # type: ignore[no-untyped-def]
    """List the last images of solutions in which the set's own points face the camera; how many there are."""
    count = 0
    for k in range(scratch.shape[1]):
        real, frame = set_frame(tables, grid, before, k, scratch, root)
        if normals:
            x, y, z = grid.rays[0, k], grid.rays[1, k], grid.rays[2, k]
            real = real & (facing_excess(frame, own[:4], bearings[0], bearings[1], bearings[2]) <= 0.0)
            real = real & (facing_excess(frame, own[4:8], bearings[3], bearings[4], bearings[5]) <= 0.0)
            real = real & (facing_excess(frame, own[8:], x, y, z) <= 0.0)
        passed[count] = k
        count += real
    return count


@scalar
def screen(  # type: ignore[no-untyped-def]
    tables, grid, flat_cells, normals, before, coordinates, own, j, lookups, scratch, work, s, hypotheses, filled
):  # fmt: skip
    """Add the solutions that cannot be dropped yet to ``hypotheses``; how many solutions there are, and then of these.

    Parameters
    ----------
    flat_cells : (h w,) int16 array
        Cells of the grid.
    before : tuple
        Of `set_known`.
    coordinates : (7, n − m) array
        Of the other points, in the order in which they are looked up.
    own : (m, 4) array
        Normals of the set's points, and the cosines of their view angles.
    j : (m,) int64 array
        Images of its points but the last.
    lookups : int
        Points that are looked up; none where there are normals.
    scratch : (2 solutions, columns) array
        Of `solve_set`; NaN where the last image is not free.
    work : Work
        Scratch.
    s : int
        Number of the set.
    hypotheses : Screened
        What was added before.
    filled : int
        How many these are.
    """
    cells, places, met, passed = work
    frames, picked = hypotheses
    if normals:
        third = own.shape[0] - 1
        u = grid.rays
        fronts = (
            own[0, 0], own[0, 1], own[0, 2], own[0, 3],
            own[third - 1, 0], own[third - 1, 1], own[third - 1, 2], own[third - 1, 3],
            own[third, 0], own[third, 1], own[third, 2], own[third, 3],
        )  # fmt: skip
        bearings = u[0, j[0]], u[1, j[0]], u[2, j[0]], u[0, j[third - 1]], u[1, j[third - 1]], u[2, j[third - 1]]
    else:
        fronts = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        bearings = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    field, found, m = field_of(grid), 0, j.size
    for root in range(scratch.shape[0] // 2):
        count, real = 0, 0
        if lookups == 0:
            count = real = list_facing(tables, grid, normals, before, fronts, bearings, scratch, root, passed)
        if lookups >= ALONG:
            count, real = list_meeting(
                tables, grid, flat_cells, field, before, coordinates, lookups, scratch, root, work
            )  # fmt: skip
        for pair in range((lookups + 1) // 2 if lookups < ALONG else 0):
            one = position(coordinates, 2 * pair)
            two = position(coordinates, min(2 * pair + 1, lookups - 1))
            real = find_two_cells(tables, grid, field, before, one, two, scratch, root, cells)
            count = int(list_met(flat_cells, places, met, pair > 0, passed))
        found += real
        for q in range(count):
            k = passed[q]
            _, frame = set_frame(tables, grid, before, k, scratch, root)
            (
                frames[filled, 0], frames[filled, 1], frames[filled, 2], frames[filled, 3],
                frames[filled, 4], frames[filled, 5], frames[filled, 6], frames[filled, 7],
                frames[filled, 8], frames[filled, 9], frames[filled, 10], frames[filled, 11],
            ) = frame  # fmt: skip
            picked[filled, 0], picked[filled, 1] = s, root
            for p in range(m - 1):
                picked[filled, 2 + p] = j[p]
            picked[filled, 1 + m] = k
            filled += 1
    return found, filled
