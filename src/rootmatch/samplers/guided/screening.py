"""Screening of all solutions of a minimal set at once: which of them predict a detection where there is one.

Nearly all solutions are false, and the sequential test drops each when the first points that it looks up meet no
detection. That is done here for every last image and root side by side, in a loop that vectorises; the rest, about one
in ten, is tested one by one.
"""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part, scalar
from rootmatch.samplers.guided.detection_grid import position_of
from rootmatch.samplers.guided.dispatch import set_frame

ROOTS = 4
"""Most solutions of a minimal set; where a problem has fewer, the others are not there."""
HIDDEN = -1
"""Instead of a cell: the point faces away from the camera and is not looked up."""
NO_SOLUTION = -2
"""Instead of a cell: there is no such solution."""


@scalar
def cell_of(grid, x, y, z):  # type: ignore[no-untyped-def]
    """Number of the cell that a point (x, y, z) in the grid's basis projects to; outside, 0, which is empty."""
    u, v, there = position_of(grid, x, y, z)
    column = (u - grid.corner[0]) * grid.scale
    row = (v - grid.corner[1]) * grid.scale
    height, width = grid.cells.shape
    # written so that NaN is outside
    inside = there & (column >= 0.0) & (column < width) & (row >= 0.0) & (row < height)
    return int(row if inside else 0.0) * width + int(column if inside else 0.0)


@scalar
def rotated(frame, a, b, c):  # type: ignore[no-untyped-def]
    """A direction of the set's frame in the camera's frame."""
    _, _, _, ex, ey, ez, fx, fy, fz, gx, gy, gz = frame
    return a * ex + b * fx + c * gx, a * ey + b * fy + c * gy, a * ez + b * fz + c * gz


@scalar
def away(frame, normal, x, y, z):  # type: ignore[no-untyped-def]
    """Above 0 where a normal is beyond its view angle, for a point with the unit bearing (x, y, z)."""
    u, v, w = rotated(frame, normal[0], normal[1], normal[2])
    return u * x + v * y + w * z + normal[3]


@scalar
def predicted_cell(grid, frame, normals, point):  # type: ignore[no-untyped-def]
    """Cell of a point with these coordinates, or HIDDEN."""
    x, y, z = rotated(frame, point[0], point[1], point[2])
    x, y, z = x + frame[0], y + frame[1], z + frame[2]
    cell = cell_of(grid, x, y, z)
    length = math.sqrt(x * x + y * y + z * z) if normals else 1.0
    hidden = normals and away(frame, point[3:], x / length, y / length, z / length) > 0.0
    return HIDDEN if hidden else cell


@scalar
def numbers(coordinates, row):  # type: ignore[no-untyped-def]
    """A row of coordinates and normals as a tuple, for a loop that vectorises."""
    return (
        coordinates[row, 0], coordinates[row, 1], coordinates[row, 2],
        coordinates[row, 3], coordinates[row, 4], coordinates[row, 5], coordinates[row, 6],
    )  # fmt: skip


@scalar
def cells_of_two(tables, grid, normals, before, one, two, own, bearings, scratch, root, cells):  # type: ignore[no-untyped-def]
    """Cells of two points at one root for every last image, or NO_SOLUTION."""
    for k in range(scratch.shape[1]):
        real, frame = set_frame(tables, grid, before, k, scratch, root)
        if normals:
            x, y, z = grid.rays[0, k], grid.rays[1, k], grid.rays[2, k]
            real = real & (away(frame, own[:4], bearings[0], bearings[1], bearings[2]) <= 0.0)
            real = real & (away(frame, own[4:8], bearings[3], bearings[4], bearings[5]) <= 0.0)
            real = real & (away(frame, own[8:], x, y, z) <= 0.0)
        cells[0, k] = predicted_cell(grid, frame, normals, one) if real else NO_SOLUTION
        cells[1, k] = predicted_cell(grid, frame, normals, two) if real else NO_SOLUTION


@scalar
def mark_facing(tables, grid, before, own, bearings, scratch, root, passed):  # type: ignore[no-untyped-def]
    """Mark the solutions at one root in which the set's own points face the camera; how many there are."""
    found = 0
    for k in range(scratch.shape[1]):
        real, frame = set_frame(tables, grid, before, k, scratch, root)
        x, y, z = grid.rays[0, k], grid.rays[1, k], grid.rays[2, k]
        real = real & (away(frame, own[:4], bearings[0], bearings[1], bearings[2]) <= 0.0)
        real = real & (away(frame, own[4:8], bearings[3], bearings[4], bearings[5]) <= 0.0)
        real = real & (away(frame, own[8:], x, y, z) <= 0.0)
        passed[root, k] = real
        found += real
    return found


@part
def screen(tables, grid, flat_cells, normals, before, coordinates, own, j, lookups, scratch, cells, passed):  # type: ignore[no-untyped-def]
    """Mark the solutions that cannot be dropped yet in ``passed`` (solutions, columns); how many solutions there are.

    Parameters
    ----------
    flat_cells : (h w,) int16 array
        Cells of the grid.
    before : tuple
        Of `set_known`.
    coordinates : (n − m, 7) array
        Of the other points, in the order in which they are looked up.
    own : (m, 4) array
        Normals of the set's points, and the cosines of their view angles.
    j : (m,) int64 array
        Images of its points but the last.
    lookups : int
        Points that are looked up.
    scratch : (2 solutions, columns) array
        Of `solve_set`; NaN where the last image is not free.
    cells : (2, columns) int64 array
        Scratch.
    """
    if normals:
        last = own.shape[0] - 1
        u = grid.rays
        fronts = (
            own[0, 0], own[0, 1], own[0, 2], own[0, 3],
            own[last - 1, 0], own[last - 1, 1], own[last - 1, 2], own[last - 1, 3],
            own[last, 0], own[last, 1], own[last, 2], own[last, 3],
        )  # fmt: skip
        bearings = u[0, j[0]], u[1, j[0]], u[2, j[0]], u[0, j[last - 1]], u[1, j[last - 1]], u[2, j[last - 1]]
    else:
        fronts = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        bearings = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    found = 0
    if normals and lookups == 0:
        for root in range(passed.shape[0]):
            found += mark_facing(tables, grid, before, fronts, bearings, scratch, root, passed)
        return found
    for root in range(passed.shape[0]):
        for pair in range((lookups + 1) // 2 if lookups > 0 else 1):
            one = numbers(coordinates, 2 * pair)
            two = numbers(coordinates, min(2 * pair + 1, lookups - 1) if lookups > 0 else 0)
            cells_of_two(tables, grid, normals, before, one, two, fronts, bearings, scratch, root, cells)
            for k in range(scratch.shape[1]):
                first, second = cells[0, k], cells[1, k]
                there = first != NO_SOLUTION
                hit = first == HIDDEN or second == HIDDEN or lookups == 0
                first, second = max(first, 0), max(second, 0)
                hit = hit or flat_cells[first] >= 0
                hit = there and (hit or flat_cells[second] >= 0)
                passed[root, k] = hit or (pair > 0 and passed[root, k])
                found += there and pair == 0
    return found
