"""A first look at all solutions of a minimal set at once: which of them meet a detection where one must be.

Nearly all solutions are false, and the sequential test drops each after the first points that it looks up have met
nothing. That is done here for every last image and root side by side, in a loop that vectorises; what is left, about
one in ten, is looked at one by one.
"""

from __future__ import annotations

from rootmatch.jit.decorators import part, scalar
from rootmatch.samplers.guided.dispatch import set_frame

ROOTS = 4
"""Most solutions of a minimal set; where a problem has fewer, the others are not there."""
HIDDEN = -1
"""In the place of a cell: the point shows its back and is not looked up."""
NOTHING = -2
"""In the place of a cell: there is no such solution."""


@scalar
def cell_of(raster, x, y, z):  # type: ignore[no-untyped-def]
    """Number of the cell in which a point (x, y, z) in the raster's basis is seen; outside, 0, which is empty."""
    inverse = 1.0 / z
    column = (x * inverse - raster.corner[0]) * raster.scale
    row = (y * inverse - raster.corner[1]) * raster.scale
    height, width = raster.cells.shape
    # written so that NaN and a point behind the camera are outside
    inside = (z > 0.0) & (column >= 0.0) & (column < width) & (row >= 0.0) & (row < height)
    return int(row if inside else 0.0) * width + int(column if inside else 0.0)


@scalar
def turned(frame, a, b, c):  # type: ignore[no-untyped-def]
    """A direction of the set's frame as the camera has it."""
    _, _, _, ex, ey, ez, fx, fy, fz, gx, gy, gz = frame
    return a * ex + b * fx + c * gx, a * ey + b * fy + c * gy, a * ez + b * fz + c * gz


@scalar
def away(frame, normal, x, y, z):  # type: ignore[no-untyped-def]
    """Above 0 where a normal points away from the camera, for a point seen along (x, y, z)."""
    u, v, w = turned(frame, *normal)
    return u * x + v * y + w * z


@scalar
def looked_up(raster, frame, normals, place):  # type: ignore[no-untyped-def]
    """Cell of a point with these coordinates, or HIDDEN."""
    x, y, z = turned(frame, place[0], place[1], place[2])
    x, y, z = x + frame[0], y + frame[1], z + frame[2]
    cell = cell_of(raster, x, y, z)
    hidden = normals and away(frame, place[3:], x, y, z) > 0.0
    return HIDDEN if hidden else cell


@scalar
def numbers(coordinates, row):  # type: ignore[no-untyped-def]
    """A row of coordinates and normals as a tuple, for a loop that vectorises."""
    return (
        coordinates[row, 0], coordinates[row, 1], coordinates[row, 2],
        coordinates[row, 3], coordinates[row, 4], coordinates[row, 5],
    )  # fmt: skip


@scalar
def cells_of_two(tables, raster, normals, before, one, two, own, seen, scratch, root, cells):  # type: ignore[no-untyped-def]
    """Cells of two points at one root for every last image, or NOTHING."""
    for k in range(scratch.shape[1]):
        real, frame = set_frame(tables, raster, before, k, scratch, root)
        if normals:
            x, y, z = raster.rays[0, k], raster.rays[1, k], raster.rays[2, k]
            real = real & (away(frame, own[:3], seen[0], seen[1], seen[2]) <= 0.0)
            real = real & (away(frame, own[3:6], seen[3], seen[4], seen[5]) <= 0.0)
            real = real & (away(frame, own[6:], x, y, z) <= 0.0)
        cells[0, k] = looked_up(raster, frame, normals, one) if real else NOTHING
        cells[1, k] = looked_up(raster, frame, normals, two) if real else NOTHING


@part
def screen(tables, raster, grid, normals, before, coordinates, own, j, looks, scratch, cells, passed):  # type: ignore[no-untyped-def]
    """Mark the solutions that cannot be dropped yet in ``passed`` (4, columns); how many solutions there are.

    Parameters
    ----------
    grid : (h w,) int16 array
        Cells of the raster.
    before : tuple
        Of `set_known`.
    coordinates : (n − m, 6) array
        Of the other points, in the order in which they are looked up.
    own : (m, 3) array
        Normals of the set's points.
    j : (m,) int64 array
        Images of its points but the last.
    looks : int
        Points that are looked up.
    scratch : (8, columns) array
        Of `solve_set`; NaN where the last image is not free.
    cells : (2, columns) int64 array
        Scratch.
    """
    if normals:
        last = own.shape[0] - 1
        u = raster.rays
        fronts = (
            own[0, 0], own[0, 1], own[0, 2], own[last - 1, 0], own[last - 1, 1], own[last - 1, 2],
            own[last, 0], own[last, 1], own[last, 2],
        )  # fmt: skip
        seen = u[0, j[0]], u[1, j[0]], u[2, j[0]], u[0, j[last - 1]], u[1, j[last - 1]], u[2, j[last - 1]]
    else:
        fronts = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        seen = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    found = 0
    for root in range(ROOTS):
        for turn in range((looks + 1) // 2 if looks > 0 else 1):
            one = numbers(coordinates, 2 * turn)
            two = numbers(coordinates, min(2 * turn + 1, looks - 1) if looks > 0 else 0)
            cells_of_two(tables, raster, normals, before, one, two, fronts, seen, scratch, root, cells)
            for k in range(scratch.shape[1]):
                first, second = cells[0, k], cells[1, k]
                there = first != NOTHING
                hit = first == HIDDEN or second == HIDDEN or looks == 0
                first, second = max(first, 0), max(second, 0)
                hit = hit or grid[first] >= 0
                hit = there and (hit or grid[second] >= 0)
                passed[root, k] = hit or (turn > 0 and passed[root, k])
                found += there and turn == 0
    return found
