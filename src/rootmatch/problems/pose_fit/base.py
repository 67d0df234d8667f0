"""How well whole answers agree with one pose each: what a problem's `Problem.fitted` hands back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEPS = 10
"""Steps of a descent, at most."""
SETTLED = 1e-3
"""Fall of χ², over 1 + χ², that is no longer worth a step."""


@dataclass(frozen=True, eq=False)
class Fit(ABC):
    """K answers, each fitted by the one pose that suits it best; nothing of a pose is handed on.

    Attributes
    ----------
    chi2 : (K,) float64
        Squared deviations of the matched points over their variances; infinite where no pose puts all of them in front
        of the camera.
    freedom : (K,) int64
        Degrees of freedom that are left: the law of ``chi2`` for a right answer.
    evidence : (K,) float64
        Logarithm of the density of the matched detections (per pixel², each), the pose integrated out by Laplace's
        method up to a constant that all answers share.
    """

    doubt: ClassVar[float] = 1.0
    """Factor by which logarithms of odds are too large, where Laplace's method is rough: found on simulated scenes."""
    chi2: Floats
    freedom: NDArray[np.int64]
    evidence: Floats

    def of_pose(self) -> float:
        """What the evidence lacks to be a density: that of the pose beforehand; NaN where none is known."""
        return np.nan

    @abstractmethod
    def densities(self, k: int, inflation: float = 1.0) -> Floats:
        """Logarithm of the predictive density per pixel² of each detection as the image of each point, (n, n').

        The prediction is that of the other points of answer k: a point's own match is left out. ``inflation``: factor
        on all variances.
        """

    def inflated(self, inflation: float) -> Floats:
        """The evidence (K,) with all variances larger by a factor."""
        with np.errstate(invalid="ignore"):
            change = self.chi2 * (1.0 - 1.0 / inflation) - self.freedom * np.log(inflation)
            return np.where(np.isfinite(self.chi2), self.evidence + 0.5 * change, -np.inf)

    def unseen(self, k: int, normals: Floats) -> NDArray[np.bool_]:
        """Which points (n,) cannot be seen in the pose of answer k, their normals (n, 3) turned away."""
        return np.zeros(len(normals), np.bool_)


def invertible(normal: Floats) -> Floats:
    """Normal equations (K, p, p) with what makes them solvable where a pose is not determined."""
    p = normal.shape[-1]
    whole = np.isfinite(normal.sum(axis=(1, 2), keepdims=True))
    normal = np.where(whole, normal, np.eye(p))
    diagonal = np.arange(p)
    normal[:, diagonal, diagonal] *= 1.0 + 1e-12
    normal[:, diagonal, diagonal] += 1e-300
    return normal


def turned(vectors: Floats) -> Floats:
    """Rotations (K, 3, 3) by rotation vectors (K, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[:, None, None]
    cross = crossed(vectors)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * cross @ cross
    )


def crossed(vectors: Floats) -> Floats:
    """Matrices (…, 3, 3) of the cross products with vectors (…, 3)."""
    out = np.zeros((*vectors.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -vectors[..., 2], vectors[..., 1], -vectors[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = vectors[..., 2], -vectors[..., 1], vectors[..., 0]
    return out
