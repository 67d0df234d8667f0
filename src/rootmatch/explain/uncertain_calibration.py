"""What a search is told of a calibration that is not exact: its errors, as noise of the detections."""

from __future__ import annotations

from rootmatch.arrays import Floats
from rootmatch.cameras.calibration_errors import is_uncertain
from rootmatch.errors import InputError
from rootmatch.problems.base import Problem
from rootmatch.problems.noise import add_calibration_noise
from rootmatch.problems.p3p import P3P
from rootmatch.problems.points import PointSets


def allow_for_calibration(problem: Problem, points: PointSets) -> tuple[PointSets, Floats | None]:
    """Points with the errors of a calibration in their noise, and that part (n',) of it; None if it is exact.

    A pose takes up the errors of a single camera, as long as it may turn about all axes: then they do not show.

    Raises
    ------
    InputError
        If the problem takes no account of such errors.
    """
    cameras = [getattr(problem, name, None) for name in ("camera", "camera2")]
    if not any(map(is_uncertain, cameras)):
        return points, None
    if not problem.takes_prior:
        told = "leave out focal_noise and centre_noise, which the poses of P3P and UP2P alone allow for"
        raise InputError(f"camera: not exact, and {problem.name} takes no account of that; {told}")
    if problem.rig is None and isinstance(problem, P3P):
        return points, 0.0 * points.target_noise
    return add_calibration_noise(points, cameras[0])  # type: ignore[arg-type]
