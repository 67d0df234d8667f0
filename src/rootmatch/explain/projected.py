"""Images of a body's points in a predicted pose, with their covariances."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Projected:
    """Images of the source points in a pose.

    Attributes
    ----------
    pixels : (n, 2) float64
    jacobian : (n, 2, 6) float64
        By rotations about the camera's axes and by translations.
    visible : (n,) float64
        Visibility of each point, 0 behind the camera.
    of_points : (n, 2, 2) float64, optional
        Covariances of the pixels by those of the points.
    """

    pixels: Floats
    jacobian: Floats
    visible: Floats
    of_points: Floats | None = None

    def of_pose(self, covariance: Floats) -> Floats:
        """Covariances (n, 2, 2) of the pixels by that of the pose."""
        return np.asarray(self.jacobian @ covariance @ self.jacobian.swapaxes(-1, -2))

    def spread(self, covariance: Floats) -> Floats:
        """Covariances (n, 2, 2) of the pixels by that of the pose and those of the points."""
        of_pose = self.of_pose(covariance)
        return of_pose if self.of_points is None else of_pose + self.of_points

    @cached_property
    def mean_of_points(self) -> Floats:
        """Variances (n,) by the points, the mean of two axes."""
        if self.of_points is None:
            return np.zeros(len(self.pixels))
        return np.asarray(0.5 * np.trace(self.of_points, axis1=1, axis2=2))
