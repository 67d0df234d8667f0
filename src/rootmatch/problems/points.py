"""The two validated point sets of a task, with the noise of every point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.integer]


@dataclass(frozen=True, eq=False)
class PointSets:
    """Validated points, made by `rootmatch.problems.base.Problem.validated`.

    Attributes
    ----------
    source : (n, 3) or (n, 2) float64
        Points in space, or pixels of the first image.
    target : (n', 2) or (n', 3) float64
        Pixels, or points in space where the problem matches two sets of those.
    source_noise, target_noise : (n,), (n',) float64
        Standard deviation of each coordinate, in the unit of its set. That of an exact source is not used.
    normals : (n, 3) float64, optional
        Outward normals of the source points, zero where unknown.
    """

    source: Floats
    target: Floats
    source_noise: Floats
    target_noise: Floats
    normals: Floats | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Number of source and target points, (n, n')."""
        return len(self.source), len(self.target)

    def subset(self, source: Indices | None = None, target: Indices | None = None) -> PointSets:
        """Some of the points, in the order of the indices; None for all."""
        first = slice(None) if source is None else source
        second = slice(None) if target is None else target
        return PointSets(
            source=self.source[first],
            target=self.target[second],
            source_noise=self.source_noise[first],
            target_noise=self.target_noise[second],
            normals=None if self.normals is None else self.normals[first],
        )

    def with_noise(self, source: Floats, target: Floats) -> PointSets:
        """The same points with another noise."""
        return replace(self, source_noise=source, target_noise=target)


def known_normals(points: PointSets, rotation: Floats | None = None) -> Floats:
    """Normals (3, n) for the kernels, rotated if asked; zero where none are known."""
    normals = np.zeros((len(points.source), 3)) if points.normals is None else points.normals
    return np.ascontiguousarray((normals if rotation is None else normals @ rotation.T).T)
