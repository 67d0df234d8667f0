"""The fit of whole assignments by one pose each, as `Problem.fitted` returns it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEPS = 10
"""Most steps of a descent. Not tuned."""
SETTLED = 1e-3
"""Fall of χ², over 1 + χ², below which a descent ends. Not tuned: the log odds are then known to about that."""


@dataclass(frozen=True, eq=False)
class Fit:
    """K assignments, each with the pose that fits it best.

    Attributes
    ----------
    chi2 : (K,) float64
        Squared deviations of the matched points over their variances; infinite where no pose puts all of them in front
        of the camera.
    dof : (K,) int64
        Degrees of freedom of the law that ``chi2`` of a right assignment follows.
    evidence : (K,) float64
        Logarithm of the density of the matched detections (per pixel², each), the pose integrated out by Laplace's
        method up to a constant that all assignments share.
    """

    chi2: Floats
    dof: NDArray[np.int64]
    evidence: Floats

    def inflated(self, inflation: float) -> Floats:
        """The evidence (K,) with all variances larger by a factor."""
        if inflation == 1.0:
            return np.where(np.isfinite(self.chi2), self.evidence, -np.inf)
        with np.errstate(invalid="ignore"):
            change = self.chi2 * (1.0 - 1.0 / inflation) - self.dof * np.log(inflation)
            return np.where(np.isfinite(self.chi2), self.evidence + 0.5 * change, -np.inf)


def invertible(normal: Floats) -> Floats:
    """Normal equations (K, p, p), made solvable where a pose is not determined."""
    p = normal.shape[-1]
    whole = np.isfinite(normal.sum(axis=(1, 2), keepdims=True))
    normal = np.where(whole, normal, np.eye(p))
    diagonal = np.arange(p)
    normal[:, diagonal, diagonal] *= 1.0 + 1e-12
    normal[:, diagonal, diagonal] += 1e-300
    return normal
