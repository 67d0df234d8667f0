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

from rootmatch.jit.decorators import FASTMATH, driver, scalar

SIDE = 24
"""Cells along the diameter of a disc: 4° to 7° of the sphere each. A round value, not tuned."""
ANY = 2 * SIDE * SIDE
"""Instead of a cell: a triple seen from so near that its shape was not foreseen; every table allows it."""
CELLS = ANY + 1
RIM = 0.15
"""Height over the equator up to which a shape is taken for its mirror image too: noise turns flat triangles over."""
WIDEST = 0.8
"""Sum of the versines of an image triple from which its shape is not foreseen: some 50° on each side."""


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
                cell = ANY
                if a != b and hab + hbc + hca < WIDEST:
                    sheet, u, v, _ = _place(hab, hbc, hca, nx * x + ny * y + nz * z)
                    cell = (sheet * SIDE + _number(u)) * SIDE + _number(v)
                cells[a, b, c] = cell


def image_cells(rays: NDArray[np.float64]) -> NDArray[np.int16]:
    """Cell (n', n', n') of every ordered triple of bearings (3, n'); of those that repeat one it means nothing."""
    count = rays.shape[1]
    cells = np.empty((count, count, count), np.int16)
    _image_cells(rays, cells)
    return cells


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _shape_tables(points, cameras, visible, sets, tables):  # type: ignore[no-untyped-def]
    for s in range(sets.shape[0]):
        i, j, k = sets[s, 0], sets[s, 1], sets[s, 2]
        for q in range(cameras.shape[0]):
            if not (visible[q, i] and visible[q, j] and visible[q, k]):
                continue
            ax, ay, az = points[i, 0] - cameras[q, 0], points[i, 1] - cameras[q, 1], points[i, 2] - cameras[q, 2]
            bx, by, bz = points[j, 0] - cameras[q, 0], points[j, 1] - cameras[q, 1], points[j, 2] - cameras[q, 2]
            cx, cy, cz = points[k, 0] - cameras[q, 0], points[k, 1] - cameras[q, 1], points[k, 2] - cameras[q, 2]
            la = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
            lb = 1.0 / math.sqrt(bx * bx + by * by + bz * bz)
            lc = 1.0 / math.sqrt(cx * cx + cy * cy + cz * cz)
            ax, ay, az, bx, by, bz = ax * la, ay * la, az * la, bx * lb, by * lb, bz * lb
            cx, cy, cz = cx * lc, cy * lc, cz * lc
            orientation = (
                (ay * bz - az * by) * cx + (az * bx - ax * bz) * cy + (ax * by - ay * bx) * cz
            )  # fmt: skip
            sheet, u, v, height = _place(
                0.5 * ((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2),
                0.5 * ((bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2),
                0.5 * ((cx - ax) ** 2 + (cy - ay) ** 2 + (cz - az) ** 2),
                orientation,
            )
            row, column = _number(u), _number(v)
            for side in range(2):
                if side != sheet and height > RIM:
                    continue
                for r in range(max(row - 1, 0), min(row + 2, SIDE)):
                    for c in range(max(column - 1, 0), min(column + 2, SIDE)):
                        tables[s, (side * SIDE + r) * SIDE + c] = True
        tables[s, ANY] = True


def shape_tables(
    points: NDArray[np.float64],
    cameras: NDArray[np.float64],
    visible: NDArray[np.bool_],
    sets: NDArray[np.int64],
) -> NDArray[np.bool_]:
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
