"""A raster of nearest detections: where a predicted point would be seen, in a few nanoseconds.

The bearings are projected onto a plane across their mean direction, which is cut into cells; each names the detection
nearest to its centre, if one is near enough. Looking up a prediction then costs the same for ten detections or a
thousand, and the distance to the one named is exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rootmatch.kernels.dispatch import scalar

CELLS_A_GATE = 4.0
"""Cells from the centre of a gate to its rim."""
MOST_CELLS = 512
"""Cells along the longer side of the raster; a gate far smaller than the image gets fewer cells then."""
NOBODY = -1
LEAST_COSINE = 0.05
"""A bearing further from the mean than 87° is not on the plane."""


class Raster(NamedTuple):
    """Detections on a plane across their mean bearing."""

    cells: NDArray[np.int16]
    """(h, w) nearest detection of each cell, −1 where none is within the gate."""
    places: NDArray[np.float64]
    """(2, n') coordinates of the detections; NaN for one that the plane does not meet."""
    rays: NDArray[np.float64]
    """(3, n') bearings in the basis of the plane."""
    basis: NDArray[np.float64]
    """(3, 3) rows: the two axes of the plane and the mean bearing."""
    corner: NDArray[np.float64]
    """(2,) coordinates of the raster's first corner."""
    scale: float
    """Cells a unit of length."""
    gate2: float
    """Square of the gate, the distance within which a detection is found."""
    density: float
    """Detections a unit of area, as a prediction placed like the detections themselves meets them."""


@njit(cache=True, error_model="numpy")
def mean_basis(rays):  # type: ignore[no-untyped-def]
    """Rows: two axes across the mean of the unit bearings (3, n'), and that mean; right-handed."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(rays.shape[1]):
        x, y, z = x + rays[0, k], y + rays[1, k], z + rays[2, k]
    length = 1.0 / np.sqrt(x * x + y * y + z * z)
    x, y, z = x * length, y * length, z * length
    # an axis across without a branch (Duff et al. 2017)
    sign = 1.0 if z >= 0.0 else -1.0
    w = -1.0 / (sign + z)
    v = x * y * w
    basis = np.empty((3, 3))
    basis[0, 0], basis[0, 1], basis[0, 2] = 1.0 + sign * x * x * w, sign * v, -sign * x
    basis[1, 0], basis[1, 1], basis[1, 2] = v, sign + y * y * w, -y
    basis[2, 0], basis[2, 1], basis[2, 2] = x, y, z
    return basis


@njit(cache=True, error_model="numpy")
def build_raster(rays, gate):  # type: ignore[no-untyped-def]
    """Raster of bearings (3, n') with a gate in radians (at the mean bearing).

    The density is that of a normal distribution with the detections' covariance, averaged over itself:
    n' / (4π √det Σ), which is also right for a filled rectangle but for a factor of 1.05.
    """
    count = rays.shape[1]
    basis = mean_basis(rays)
    places = np.empty((2, count))
    turned = np.empty((3, count))
    low_u, low_v, high_u, high_v = np.inf, np.inf, -np.inf, -np.inf
    for k in range(count):
        for axis in range(3):
            turned[axis, k] = basis[axis, 0] * rays[0, k] + basis[axis, 1] * rays[1, k] + basis[axis, 2] * rays[2, k]
        ahead = turned[2, k] > LEAST_COSINE
        places[0, k] = turned[0, k] / turned[2, k] if ahead else np.nan
        places[1, k] = turned[1, k] / turned[2, k] if ahead else np.nan
        if ahead:
            low_u, high_u = min(low_u, places[0, k]), max(high_u, places[0, k])
            low_v, high_v = min(low_v, places[1, k]), max(high_v, places[1, k])
    extent = max(high_u - low_u, high_v - low_v, 1e-9)
    # a gate below a ten-thousandth of the extent is rounding, not noise
    gate = max(gate, 1e-4 * extent)
    size = max(gate / CELLS_A_GATE, (extent + 2.0 * gate) / MOST_CELLS)
    corner = np.empty(2)
    corner[0], corner[1] = low_u - gate - size, low_v - gate - size
    width = int((high_u - corner[0] + gate) / size) + 2
    height = int((high_v - corner[1] + gate) / size) + 2
    cells = np.empty((height, width), np.int16)
    nearest = np.empty((height, width))
    for row in range(height):
        for column in range(width):
            cells[row, column] = NOBODY
            nearest[row, column] = np.inf
    # a cell's centre is within the gate and half a diagonal of whatever lies within the gate of any of its points
    reach = gate + 0.71 * size
    for k in range(count):
        if np.isnan(places[0, k]):
            continue
        u = (places[0, k] - corner[0]) / size
        v = (places[1, k] - corner[1]) / size
        cells_reach = int(reach / size) + 1
        for row in range(max(0, int(v) - cells_reach), min(height, int(v) + cells_reach + 1)):
            for column in range(max(0, int(u) - cells_reach), min(width, int(u) + cells_reach + 1)):
                du = (column + 0.5 - u) * size
                dv = (row + 0.5 - v) * size
                distance2 = du * du + dv * dv
                if distance2 <= reach * reach and distance2 < nearest[row, column]:
                    nearest[row, column] = distance2
                    cells[row, column] = k
    return Raster(cells, places, turned, basis, corner, 1.0 / size, gate * gate, _density(places, gate))


@njit(cache=True, error_model="numpy")
def _density(places, gate):  # type: ignore[no-untyped-def]
    """Density n' / (4π √det Σ) of the places, each blurred by the gate so that a line of points has an area too."""
    inside = 0
    mu, mv = 0.0, 0.0
    for k in range(places.shape[1]):
        if not np.isnan(places[0, k]):
            inside += 1
            mu += places[0, k]
            mv += places[1, k]
    mu /= inside
    mv /= inside
    suu, suv, svv = 0.0, 0.0, 0.0
    for k in range(places.shape[1]):
        if not np.isnan(places[0, k]):
            du, dv = places[0, k] - mu, places[1, k] - mv
            suu += du * du
            suv += du * dv
            svv += dv * dv
    suu = suu / inside + gate * gate
    svv = svv / inside + gate * gate
    suv /= inside
    return inside / (4.0 * np.pi * np.sqrt(suu * svv - suv * suv))


@scalar
def look_up(raster, x, y, z):  # type: ignore[no-untyped-def]
    """Detection within the gate of a point (x, y, z) in the raster's basis, or −1, and their squared distance."""
    inverse = 1.0 / z
    u = x * inverse
    v = y * inverse
    column = (u - raster.corner[0]) * raster.scale
    row = (v - raster.corner[1]) * raster.scale
    found, distance2 = NOBODY, np.inf
    height, width = raster.cells.shape
    # written so that NaN and a point behind the camera are outside
    if z > 0.0 and 0.0 <= column < width and 0.0 <= row < height:
        k = int(raster.cells[int(row), int(column)])
        if k >= 0:
            du = u - raster.places[0, k]
            dv = v - raster.places[1, k]
            distance2 = du * du + dv * dv
            if distance2 <= raster.gate2:
                found = k
    return found, distance2
