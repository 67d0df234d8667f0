"""The two validated point sets of a task, with the noise of every point: parsed here and nowhere else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.problems.capabilities import Capability
from rootmatch.problems.checks import check_noise

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


def parse_noise(noise: ArrayLike, shape: tuple[int, int], noisy_source: bool, name: str) -> tuple[Floats, Floats]:
    """Standard deviations (n,) and (n',) of source and target coordinates.

    Parameters
    ----------
    noise : float, (n',) array, or a pair
        One number holds for both sets; n' numbers are those of the target, and their root mean square that of the
        source; a tuple or list of two gives source and target apart, each a number or one for each point.
    shape : (n, n')
    noisy_source : bool
        Whether the problem has a noisy source. If not, the noise is that of the target alone.
    name : str
        The problem, for the message.

    Raises
    ------
    InputError
        If it is neither, or a number is negative, not finite or absurdly large.
    """
    n, n_target = shape
    if isinstance(noise, tuple | list) and len(noise) == 2:
        Capability.SOURCE_NOISE.require(noisy_source, name)
        first, second = noise
        return check_noise(first, n, "noise of the source"), check_noise(second, n_target, "noise of the target")
    sigma = check_noise(noise, n_target)
    return np.full(n, np.sqrt(np.mean(sigma**2))), sigma


def known_normals(points: PointSets, rotation: Floats | None = None) -> Floats:
    """Normals (3, n) for the kernels, rotated if asked; zero where none are known."""
    normals = np.zeros((len(points.source), 3)) if points.normals is None else points.normals
    return np.ascontiguousarray((normals if rotation is None else normals @ rotation.T).T)
