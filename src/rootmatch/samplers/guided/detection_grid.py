"""A raster of nearest detections: where a predicted point would be seen, in a few nanoseconds.

The bearings are projected onto a plane across their mean direction, which is cut into cells; each names the detection
nearest to its centre, if one is near enough. Looking up a prediction then costs the same for ten detections or a
thousand, and the distance to the one named is exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.jit.decorators import scalar

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


def mean_basis(rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows: two axes across the mean of the unit bearings (3, n'), and that mean; right-handed."""
    mean = rays.sum(axis=1)
    x, y, z = (mean / np.sqrt(mean @ mean)).tolist()
    # an axis across without a branch (Duff et al. 2017)
    sign = 1.0 if z >= 0.0 else -1.0
    w = -1.0 / (sign + z)
    v = x * y * w
    return np.array([[1.0 + sign * x * x * w, sign * v, -sign * x], [v, sign + y * y * w, -y], [x, y, z]])


def build_raster(rays: NDArray[np.float64], gate: float) -> Raster:
    """Raster of bearings (3, n') with a gate in radians (at the mean bearing).

    The density is that of a normal distribution with the detections' covariance, averaged over itself:
    n' / (4π √det Σ), which is also right for a filled rectangle but for a factor of 1.05.
    """
    basis = mean_basis(rays)
    turned = basis @ rays
    ahead = turned[2] > LEAST_COSINE
    places = np.where(ahead, turned[:2] / np.where(ahead, turned[2], 1.0), np.nan)
    inside = places[:, ahead]
    low, high = inside.min(axis=1, initial=np.inf), inside.max(axis=1, initial=-np.inf)
    extent = max(float((high - low).max()), 1e-9)
    # a gate below a ten-thousandth of the extent is rounding, not noise
    gate = max(gate, 1e-4 * extent)
    size = max(gate / CELLS_A_GATE, (extent + 2.0 * gate) / MOST_CELLS)
    corner = low - gate - size
    width, height = ((high - corner + gate) / size).astype(np.int64) + 2
    cells = np.full((height, width), NOBODY, np.int16)
    nearest = np.full((height, width), np.inf)
    # a cell's centre is within the gate and half a diagonal of whatever lies within the gate of any of its points
    reach = gate + 0.71 * size
    about = int(reach / size) + 1
    for k in np.flatnonzero(ahead).tolist():
        u, v = ((places[:, k] - corner) / size).tolist()
        rows = slice(max(0, int(v) - about), int(v) + about + 1)
        columns = slice(max(0, int(u) - about), int(u) + about + 1)
        window = nearest[rows, columns]
        du = (np.arange(columns.start, columns.start + window.shape[1]) + 0.5 - u) * size
        dv = (np.arange(rows.start, rows.start + window.shape[0]) + 0.5 - v) * size
        distance2 = du * du + (dv * dv)[:, None]
        nearer = (distance2 <= reach * reach) & (distance2 < window)
        window[nearer] = distance2[nearer]
        cells[rows, columns][nearer] = k
    return Raster(cells, places, turned, basis, corner, 1.0 / size, gate * gate, _density(inside, gate))


def _density(places: NDArray[np.float64], gate: float) -> float:
    """Density n' / (4π √det Σ) of the places, each blurred by the gate so that a line of points has an area too."""
    count = places.shape[1]
    centred = places - places.mean(axis=1, keepdims=True)
    (suu, suv), (_, svv) = centred @ centred.T / count
    return float(count / (4.0 * np.pi * np.sqrt((suu + gate * gate) * (svv + gate * gate) - suv * suv)))


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
    if z > 0.0 and column >= 0.0 and column < width and row >= 0.0 and row < height:
        k = int(raster.cells[int(row), int(column)])
        if k >= 0:
            du = u - raster.places[0, k]
            dv = v - raster.places[1, k]
            distance2 = du * du + dv * dv
            if distance2 <= raster.gate2:
                found = k
    return found, distance2
