"""The problem of a rig's copies: what the posterior asks of assignments that several cameras share one pose for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.problems.base import Problem
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.base import Fit
from rootmatch.problems.pose_fit.rig_fit import Copies, rig_fit


@dataclass(frozen=True, eq=False)
class RigCopies(Problem):
    """Copies of points, one for each camera, against the detections of all; no kernels, but a fit."""

    copies: Copies
    name: ClassVar[str] = "rig"
    order: ClassVar[int] = 4
    minimal: ClassVar[int] = 3
    degree: ClassVar[int] = 4
    constraints: ClassVar[int] = 2
    pair_count: ClassVar[int] = 6
    source_dimension: ClassVar[int] = 3
    takes_normals: ClassVar[bool] = True
    fits_answers: ClassVar[bool] = True

    def fitted(self, points: PointSets, assignments: NDArray[np.int64]) -> Fit:
        """Assignments of copies fitted by a pose of the rig each; see `Problem.fitted`."""
        return rig_fit(self.copies, points.target, points.target_noise, assignments)

    def tables(self, points: PointSets) -> Any:
        """None: hyper-edges are within a camera.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError("rig: hyper-edges of several cameras are not evaluated; take one camera")

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """As `tables`."""
        raise InputError("rig: minimal sets of several cameras are not solved; take one camera")
