"""The problem itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.problems.base import Problem
from rootmatch.problems.points import PointSets

from .tables import ZoomTables


@dataclass(frozen=True)
class Zoom(Problem):
    """Points of a plane up to translation and a scale x: a pair gives |d|² x = d · e of its differences d and e."""

    name: ClassVar[str] = "zoom"
    minimal: ClassVar[int] = 2
    degree: ClassVar[int] = 1
    constraints: ClassVar[int] = 3
    source_dimension: ClassVar[int] = 2

    def tables(self, points: PointSets) -> ZoomTables:
        return ZoomTables(
            np.ascontiguousarray(points.source.T), np.ascontiguousarray(points.target.T), points.target_noise**2
        )

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        d, e = (points[:, 1] - points[:, 0] for points in (np.asarray(source), np.asarray(target)))
        return np.stack([(d * d).sum(axis=1), -(d * e).sum(axis=1)], axis=1)
