"""What a search is told of a calibration that is not exact: its errors, as noise of the detections."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.cameras.vertical import unit_direction
from rootmatch.errors import InputError
from rootmatch.problems.base import Problem
from rootmatch.problems.noise import add_calibration_noise
from rootmatch.problems.points import PointSets
from rootmatch.problems.up2p import UP2P


def allow_for_calibration(problem: Problem, points: PointSets) -> tuple[PointSets, Floats | None]:
    """Points with the errors of a calibration in their noise, and that part (n',) of it; None if it is exact.

    Raises
    ------
    InputError
        If the problem takes no account of such errors.
    """
    if not any(getattr(getattr(problem, name, None), "is_uncertain", False) for name in ("camera", "camera2")):
        return points, None
    if not problem.takes_prior:
        told = "leave out focal_noise and centre_noise, which the poses of P3P and UP2P alone allow for"
        raise InputError(f"camera: not exact, and {problem.name} takes no account of that; {told}")
    camera, axes = problem.camera, np.eye(3)  # type: ignore[attr-defined]
    if isinstance(problem, UP2P) and problem.vertical_noise == 0.0:
        axes = unit_direction(problem.vertical_camera, problem.name)[None]
    return add_calibration_noise(points, camera, axes)
