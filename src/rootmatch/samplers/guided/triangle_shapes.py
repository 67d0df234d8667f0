"""Shapes of triangles in an image, and which of them a triple of source points can have from where it is visible.

A triple whose points face the camera is seen from a part of all directions only, and its image has one of the shapes
that it has from there. The shape of an image triple is looked up in a table of the source triple, a nanosecond, and
nine in ten of them need not be solved. The tables depend on the source points alone.

A shape is a place on the sphere of triangles (Kendall 1984): the squared sides over their sum are a point in a disc,
and the orientation says on which of its two sides. Both hemispheres are mapped to discs of equal area and cut into
cells.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.decorators import FASTMATH, driver, part, scalar

SIDE = 24
"""Cells along the diameter of a disc: 4° to 7° of the sphere each. A round value, not tuned."""
WIDTHS = (0.8, 1.2, 1.8, 2.7)
"""Sums of the versines of an image triple that part its shapes: below the first it is seen from afar, where its shape
depends on the direction alone, and from there on from ever nearer. The first is some 50° on each side."""
ANY = 2 * SIDE * SIDE * len(WIDTHS)
"""Instead of a cell: a triple seen from so near that its shape was not foreseen, in tables of triples that can be."""
CELLS = ANY + 1
NARROW = 2 * SIDE * SIDE
"""Cells of images that are as narrow as those from afar; they are the first."""
RIM = 0.15
"""Height over the equator up to which a shape is taken for its mirror image too: noise turns flat triangles over."""
NEAR = (0.01, 0.03, 0.06, 0.09, 0.12, *(0.15 * 1.12**step for step in range(22)))
"""Distances, in longest sides, of near cameras from a triple's centroid. From farther away it is not as wide as the
first of `WIDTHS`; from nearer than 0.15 it is wider than the last, and most triples do not face a camera there."""
SLACK = 1.1
"""Factor on the sum of the versines by which a width is taken for the next one too. Not tuned: half a step of `NEAR`
changes it by 1.1 at the most."""


@scalar
def _place(hab, hbc, hca, orientation):  # type: ignore[no-untyped-def]
    """Sheet, two coordinates in the unit disc, and height of a triangle with squared sides 2 h and an orientation."""
    inverse = 1.0 / (hab + hbc + hca)
    x = math.sqrt(3.0) * (hca - hab) * inverse
    y = (2.0 * hbc - hca - hab) * inverse
    z = math.sqrt(max(0.0, 1.0 - x * x - y * y))
    shrunk = 1.0 / math.sqrt(1.0 + z)
    return (1 if orientation > 0.0 else 0), x * shrunk, y * shrunk, z


@scalar
def _layer(total):  # type: ignore[no-untyped-def]
    """How many of the widths a sum of versines reaches."""
    return (
        (1 if total >= WIDTHS[0] else 0) + (1 if total >= WIDTHS[1] else 0)
        + (1 if total >= WIDTHS[2] else 0) + (1 if total >= WIDTHS[3] else 0)
    )  # fmt: skip


@scalar
def _number(coordinate):  # type: ignore[no-untyped-def]
    """Row or column of a coordinate in −1 … 1."""
    return min(max(int((coordinate + 1.0) * (0.5 * SIDE)), 0), SIDE - 1)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _image_cells(rays, cells):  # type: ignore[no-untyped-def]
    count = rays.shape[1]
    for a in range(count):
        for b in range(count):
            hab = 0.5 * (
                (rays[0, a] - rays[0, b]) ** 2 + (rays[1, a] - rays[1, b]) ** 2 + (rays[2, a] - rays[2, b]) ** 2
            )
            nx = rays[1, a] * rays[2, b] - rays[2, a] * rays[1, b]
            ny = rays[2, a] * rays[0, b] - rays[0, a] * rays[2, b]
            nz = rays[0, a] * rays[1, b] - rays[1, a] * rays[0, b]
            for c in range(count):
                x, y, z = rays[0, c], rays[1, c], rays[2, c]
                hbc = 0.5 * ((rays[0, b] - x) ** 2 + (rays[1, b] - y) ** 2 + (rays[2, b] - z) ** 2)
                hca = 0.5 * ((rays[0, a] - x) ** 2 + (rays[1, a] - y) ** 2 + (rays[2, a] - z) ** 2)
                cell, layer = ANY, _layer(hab + hbc + hca)
                if a != b and layer < len(WIDTHS):
                    sheet, u, v, _ = _place(hab, hbc, hca, nx * x + ny * y + nz * z)
                    cell = ((2 * layer + sheet) * SIDE + _number(u)) * SIDE + _number(v)
                cells[a, b, c] = cell


def image_cells(rays: Floats) -> NDArray[np.int16]:
    """Cell (n', n', n') of every ordered triple of bearings (3, n'); of those that repeat one it means nothing."""
    count = rays.shape[1]
    cells = np.empty((count, count, count), np.int16)
    _image_cells(rays, cells)
    return cells


@part
def _mark(points, i, j, k, x, y, z, minimum, table):  # type: ignore[no-untyped-def]
    """Mark the shape of a triple in the image of a camera at (x, y, z), if its width is in layer ``minimum`` or up."""
    ax, ay, az = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
    bx, by, bz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
    cx, cy, cz = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
    la = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
    lb = 1.0 / math.sqrt(bx * bx + by * by + bz * bz)
    lc = 1.0 / math.sqrt(cx * cx + cy * cy + cz * cz)
    ax, ay, az, bx, by, bz = ax * la, ay * la, az * la, bx * lb, by * lb, bz * lb
    cx, cy, cz = cx * lc, cy * lc, cz * lc
    hab = 0.5 * ((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2)
    hbc = 0.5 * ((bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2)
    hca = 0.5 * ((cx - ax) ** 2 + (cy - ay) ** 2 + (cz - az) ** 2)
    total = hab + hbc + hca
    if _layer(total * SLACK) < minimum:
        return
    orientation = (ay * bz - az * by) * cx + (az * bx - ax * bz) * cy + (ax * by - ay * bx) * cz
    sheet, u, v, height = _place(hab, hbc, hca, orientation)
    row, column = _number(u), _number(v)
    if _layer(total * SLACK) == len(WIDTHS):
        table[ANY] = True
    for layer in range(max(_layer(total / SLACK), minimum), min(_layer(total * SLACK) + 1, len(WIDTHS))):
        for side in range(2):
            if side != sheet and height > RIM:
                continue
            for r in range(max(row - 1, 0), min(row + 2, SIDE)):
                for c in range(max(column - 1, 0), min(column + 2, SIDE)):
                    table[((2 * layer + side) * SIDE + r) * SIDE + c] = True


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _shape_tables(points, cameras, visible, sets, tables):  # type: ignore[no-untyped-def]
    for s in range(sets.shape[0]):
        i, j, k = sets[s, 0], sets[s, 1], sets[s, 2]
        for q in range(cameras.shape[0]):
            if visible[q, i] and visible[q, j] and visible[q, k]:
                _mark(points, i, j, k, cameras[q, 0], cameras[q, 1], cameras[q, 2], 0, tables[s])


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _near_tables(points, normals, minimum, directions, distances, sets, tables):  # type: ignore[no-untyped-def]
    for s in range(sets.shape[0]):
        x, y, z, longest = 0.0, 0.0, 0.0, 0.0
        for p in range(3):
            one, other = sets[s, p], sets[s, (p + 1) % 3]
            x, y, z = x + points[one, 0] / 3.0, y + points[one, 1] / 3.0, z + points[one, 2] / 3.0
            side = math.sqrt(
                (points[one, 0] - points[other, 0]) ** 2 + (points[one, 1] - points[other, 1]) ** 2
                + (points[one, 2] - points[other, 2]) ** 2
            )  # fmt: skip
            longest = max(longest, side)
        for q in range(directions.shape[0]):
            # a point's front is a half-space, and a line of cameras enters or leaves it once
            nearest, farthest = 0.0, math.inf
            for p in range(3):
                d = sets[s, p]
                if minimum[d] >= 0.0:
                    slope = directions[q, 0] * normals[d, 0] + directions[q, 1] * normals[d, 1]
                    slope += directions[q, 2] * normals[d, 2]
                    height = (x - points[d, 0]) * normals[d, 0] + (y - points[d, 1]) * normals[d, 1]
                    height += (z - points[d, 2]) * normals[d, 2] + 1e-9 * longest
                    if slope > 0.0:
                        nearest = max(nearest, -height / slope)
                    elif height < 0.0:
                        farthest = -1.0
                    elif slope < 0.0:
                        farthest = min(farthest, -height / slope)
            for far in range(distances.size):
                away = longest * distances[far]
                if away < nearest or away > farthest:
                    continue
                u, v, w = x + away * directions[q, 0], y + away * directions[q, 1], z + away * directions[q, 2]
                facing = True
                for p in range(3):
                    d = sets[s, p]
                    ox, oy, oz = u - points[d, 0], v - points[d, 1], w - points[d, 2]
                    along = ox * normals[d, 0] + oy * normals[d, 1] + oz * normals[d, 2]
                    facing = facing and along >= minimum[d] * math.sqrt(ox * ox + oy * oy + oz * oz)
                if facing:
                    _mark(points, sets[s, 0], sets[s, 1], sets[s, 2], u, v, w, 1, tables[s])


def shape_tables(points: Floats, cameras: Floats, visible: Bools, sets: Integers) -> Bools:
    """Which shapes (S, CELLS) the triples have in the images of some cameras, and the shapes beside those.

    Parameters
    ----------
    points : (n, 3) array
    cameras : (V, 3) array
        Positions.
    visible : (V, n) bool array
        Which points each camera may see.
    sets : (S, 3) int64 array
    """
    tables = np.zeros((len(sets), CELLS), np.bool_)
    _shape_tables(points, cameras, visible, sets, tables)
    return tables


def add_near_shapes(
    tables: Bools, sets: Integers, points: Floats, normals: Floats, minimum: Floats, directions: Floats
) -> None:
    """Add the shapes of wide images to tables (S, CELLS): what cameras see that are as near as a triple is long.

    Parameters
    ----------
    tables : (S, CELLS) bool array
    sets : (S, 3) int64 array
    points, normals : (n, 3) arrays
        A normal of length 1, or 0 where it is unknown.
    minimum : (n,) array
        Least cosine between normal and direction to the camera at which a point is visible.
    directions : (D, 3) array
        Unit vectors in which cameras lie about a triple.
    """
    _near_tables(points, normals, minimum, directions, np.array(NEAR), sets, tables)
