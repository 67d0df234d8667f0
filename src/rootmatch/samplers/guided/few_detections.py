"""Some of the detections as the sequential test reads them, for a search among those of one hypothesis."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.problems.padding import padded_places, with_targets
from rootmatch.samplers.guided.detection_grid import DetectionGrid, cells_of_some


class FewDetections(NamedTuple):
    """The detections of an assignment: no others are solved for, and what others are nearest to meets nothing."""

    assignment: NDArray[np.int64]
    """(n,)."""
    images: NDArray[np.int64]
    """(m,) numbers of the detections."""
    tables: Any
    """Tables of these detections, padded."""
    grid: DetectionGrid
    allowed: NDArray[np.bool_]
    """(n, m), or (0, 0) for all."""

    @classmethod
    def of(
        cls, tables: Any, grid: DetectionGrid, allowed: NDArray[np.bool_], assignment: NDArray[np.int64]
    ) -> FewDetections:
        """The detections of an assignment, from tables without padding, a grid and a mask of all detections."""
        images = np.sort(assignment[assignment >= 0])
        count = grid.positions.shape[1]
        few = grid._replace(
            cells=cells_of_some(grid, images),
            positions=np.ascontiguousarray(grid.positions[:, images]),
            rays=np.ascontiguousarray(grid.rays[:, images]),
            density=grid.density[images],
        )
        fewer = with_targets(tables, images[padded_places(len(images))], count)
        return cls(
            assignment, images, fewer, few, np.ascontiguousarray(allowed[:, images]) if allowed.size else allowed
        )
