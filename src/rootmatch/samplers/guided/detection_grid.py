"""A grid of nearest detections: which detection lies at a predicted point, in a few nanoseconds.

The bearings are projected onto a plane across their mean direction, which is cut into cells; each names the detection
nearest to its centre, if one is near enough. Looking up a prediction then costs the same for ten detections or a
thousand, and the distance to the one named is exact. A wider field, beside or behind the camera too, is mapped to a
plane by Lambert's equal-area projection of the whole sphere; compiled code for it is made when it is first needed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, median
from rootmatch.cameras.stereographic import Stereographic
from rootmatch.jit.decorators import driver, scalar

NOBODY = -1
"""Entry of an empty cell."""
HALF_DIAGONAL = 0.71
"""Half the diagonal of a cell of side 1, rounded up."""
MIN_EXTENT = 1e-9
"""Extent of the detections, in radians, that is taken for a single one."""


GATE = 8.0
"""Distance from a prediction, in σ, within which a detection counts while minimal sets are tried; wide, as it also
covers the errors of the minimal set. What is found: benchmarks/guided.py."""
NOISE_RATIO = 2.0
"""The gate of all detections has the usual σ, or the largest over this if that is more."""
CELLS_PER_GATE = 4.0
"""Cells from the centre of a gate to its rim; the distance to the detection found is exact anyway."""
MAX_CELLS = 512
"""Cells along the longer side; a gate far smaller than the image gets fewer cells. Bounds the memory."""
MIN_COSINE = 0.5
"""Cosine to the mean bearing down to which all detections lie on one plane: 60°, where a gate on it is four times as
wide as at its centre. Below, the grid is one of the whole sphere."""
NEIGHBOURS = 3
"""Nearest detections that tell the density about one, at least; else the root of their number."""
CROWD = 0.03
"""Mean number of detections within a gate from which it is narrowed, without normals: a false solution that meets one
goes on. On seeds 300 to 311 of benchmarks/matches.py five and a half σ instead of eight take P3P 50 + 50 from 206 to
139 ms and up2p 100 + 100 from 54 to 40, with as many evaluations and the same accuracy."""
NARROWEST = 0.6
"""Fraction of the gate down to which it is narrowed."""
MIN_GATE = 1e-4
"""Gate over the extent of the detections below which it is rounding, not noise."""


class DetectionGrid(NamedTuple):
    """Detections on a plane across their mean bearing, or on a map of the whole sphere."""

    cells: NDArray[np.int16]
    """(h, w) nearest detection of each cell, −1 where none is within the gate."""
    positions: Floats
    """(2, n') coordinates of the detections."""
    rays: Floats
    """(3, n') bearings in the basis of the plane."""
    basis: Floats
    """(3, 3) rows: the two axes of the plane and the mean bearing."""
    corner: Floats
    """(2,) coordinates of the grid's first corner."""
    scale: float
    """Cells a unit of length."""
    gate2: float
    """Square of the gate, the distance within which a detection is found."""
    density: Floats
    """(n',) detections per unit of area about each, as a false prediction near the detections meets them."""
    whole: tuple[()] | tuple[float]
    """Empty for a plane; its length is part of the type, so that neither map is compiled into code for the other."""


def gate_factor(rays: Floats, gate: float) -> float:
    """Factor on a gate in radians where many of the bearings (3, n') lie within one, 1 where few do."""
    _, *longer = sorted((rays.max(axis=1) - rays.min(axis=1)).tolist())
    area = float(math.prod(longer))
    met = rays.shape[1] * math.pi * gate * gate / max(area, gate * gate)
    return 1.0 if met <= CROWD else max(math.sqrt(CROWD / met), NARROWEST)


def grid_of(rays: Floats, sigma: Floats, *, narrow: bool) -> DetectionGrid:
    """Grid of bearings (3, n') with standard deviations (n',) in radians; its gate may be narrower where they crowd."""
    gate = GATE * max(median(sigma), float(sigma.max()) / NOISE_RATIO)
    return build_grid(rays, gate * gate_factor(rays, gate) if narrow else gate)


def build_grid(rays: Floats, gate: float) -> DetectionGrid:
    """Grid of bearings (3, n') with a gate in radians (at the mean bearing).

    Its density is `local_density`.
    """
    basis = Stereographic.about(rays.T).basis
    rotated = basis @ rays
    whole = not float(rotated[2].min()) > MIN_COSINE
    positions = _equal_area(rotated) if whole else rotated[:2] / rotated[2]
    low, high = positions.min(axis=1), positions.max(axis=1)
    extent = max(float((high - low).max()), MIN_EXTENT)
    gate = max(gate, MIN_GATE * extent)
    size = max(gate / CELLS_PER_GATE, (extent + 2.0 * gate) / MAX_CELLS)
    # an angle is this much longer on the map than in space, and a length on the map in space, at the most
    stretch = np.sqrt(2.0 / np.maximum(1.0 + rotated[2], STRAIGHT)) if whole else np.ones(rays.shape[1])
    # a cell's centre is within the gate and half a diagonal of whatever lies within the gate of any of its points
    reaches = gate + HALF_DIAGONAL * size * stretch
    margin = float((reaches * stretch).max()) if whole else gate
    corner = low - margin - size
    width, height = ((high - corner + margin) / size).astype(np.int64) + 2
    cells = np.full((height, width), NOBODY, np.int16)
    nearest = np.empty((height, width))
    _fill(cells, nearest, positions, rotated, reaches, stretch, corner, float(size), whole)
    return DetectionGrid(
        cells, positions, rotated, basis, corner,
        scale=1.0 / size, gate2=gate * gate, density=local_density(positions, gate),
        whole=(1.0,) if whole else (),
    )  # fmt: skip


STRAIGHT = 1e-3
"""1 + cosine to the axis down to which the map's stretch is followed: 177°."""


def _equal_area(rays: Floats) -> Floats:
    """Lambert's azimuthal equal-area projection (2, m) of unit vectors (3, m) about the z axis."""
    return np.asarray(rays[:2] * np.sqrt(2.0 / np.maximum(1.0 + rays[2], 1e-300)))


@driver(nogil=True, error_model="numpy")
def _fill(cells, nearest, positions, rays, reaches, stretch, corner, size, whole):  # type: ignore[no-untyped-def]
    """Name the nearest detection in each cell; ``nearest``, its squared distance, is written where there is one."""
    height, width = cells.shape
    for k in range(reaches.size):
        reach2 = reaches[k] * reaches[k]
        about = int(reaches[k] * stretch[k] / size) + 1
        u, v = (positions[0, k] - corner[0]) / size, (positions[1, k] - corner[1]) / size
        for row in range(max(0, int(v) - about), min(height, int(v) + about + 1)):
            for column in range(max(0, int(u) - about), min(width, int(u) + about + 1)):
                du, dv = (column + 0.5 - u) * size, (row + 0.5 - v) * size
                if whole:
                    # squared distance on the unit sphere, NaN for nothing
                    x, y = positions[0, k] + du, positions[1, k] + dv
                    quarter = 0.25 * (x * x + y * y)
                    across = np.sqrt(1.0 - quarter) if quarter <= 1.0 else np.nan
                    along = across * (x * rays[0, k] + y * rays[1, k]) + (1.0 - 2.0 * quarter) * rays[2, k]
                    distance2 = 2.0 - 2.0 * along
                else:
                    distance2 = du * du + dv * dv
                if distance2 <= reach2 and (cells[row, column] == NOBODY or distance2 < nearest[row, column]):
                    nearest[row, column] = distance2
                    cells[row, column] = k


TREE_FROM = 300
"""Detections from which a tree finds neighbours faster than all distances do, and in less memory."""


def local_density(positions: Floats, blur: float) -> Floats:
    """Density (n',) of the positions (2, n') about each, blurred so that a line of points has an area too.

    The greater of two: k / (π r²) with the k-th neighbour at a distance of r, and n' / (4π √det Σ), that of a normal
    distribution averaged over itself, which is also right for a filled rectangle but for a factor of 1.05. So a few
    detections far away do not make a cluster look sparse, and what meets a cluster by chance is not taken for evidence.
    """
    ahead = np.isfinite(positions[0])
    inside = positions[:, ahead]
    count = inside.shape[1]
    k = max(NEIGHBOURS, math.ceil(math.sqrt(count)))
    centred = inside - inside.sum(axis=1, keepdims=True) / count
    (suu, suv), (_, svv) = centred @ centred.T / count
    overall = count / (4.0 * np.pi * np.sqrt((suu + blur * blur) * (svv + blur * blur) - suv * suv))
    density = np.full(positions.shape[1], overall)
    if k < count:
        density[ahead] = np.maximum(overall, k / (np.pi * (_reach2(inside, k) + blur * blur)))
    return density


def _reach2(positions: Floats, k: int) -> Floats:
    """Squared distance (m,) of each position (2, m) to its k-th neighbour."""
    if positions.shape[1] < TREE_FROM:
        between = ((positions[:, :, None] - positions[:, None]) ** 2).sum(axis=0)
        return np.asarray(np.partition(between, k, axis=1)[:, k])
    from scipy.spatial import cKDTree  # slow to import, and few detections have no need of it

    distance, _ = cKDTree(positions.T).query(positions.T, k=[k + 1])
    return np.asarray(distance[:, 0] ** 2)


@scalar
def position_of(whole, x, y, z):  # type: ignore[no-untyped-def]
    """Where a point (x, y, z) in the grid's basis lies on its map, and whether it does: on a plane, what is ahead."""
    if len(whole) > 0:
        size = np.sqrt(x * x + y * y + z * z)
        scale = np.sqrt(2.0 / (size * (size + z)))
        return x * scale, y * scale, size + z > 0.0
    inverse = 1.0 / z
    return x * inverse, y * inverse, z > 0.0


@scalar
def field_of(grid):  # type: ignore[no-untyped-def]
    """Corner, scale, height and width of a grid: read before a loop, which would not vectorise if it read them."""
    height, width = grid.cells.shape
    return grid.corner[0], grid.corner[1], grid.scale, height, width


@scalar
def detection_at(cells, positions, rays, field, gate2, whole, x, y, z):  # type: ignore[no-untyped-def]
    """Detection within the gate of a point (x, y, z) in the grid's basis, or −1, and their squared distance.

    It takes the fields of the grid that it reads: in a loop, each array of a tuple that is handed on is counted.
    """
    left, top, scale, height, width = field
    u, v, there = position_of(whole, x, y, z)
    column = (u - left) * scale
    row = (v - top) * scale
    found, distance2 = NOBODY, np.inf
    # written so that NaN is outside
    if there and column >= 0.0 and column < width and row >= 0.0 and row < height:
        k = int(cells[np.uint32(row), np.uint32(column)])
        if k >= 0:
            if len(whole) > 0:
                inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
                du, dv, dw = x * inverse - rays[0, k], y * inverse - rays[1, k], z * inverse - rays[2, k]
                distance2 = du * du + dv * dv + dw * dw
            else:
                du = u - positions[0, k]
                dv = v - positions[1, k]
                distance2 = du * du + dv * dv
            if distance2 <= gate2:
                found = k
    return found, distance2
