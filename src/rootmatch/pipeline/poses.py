"""Poses of a match, one per motion; matching itself does not use them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.problems.base import Problem
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.pose_fit.pose import Pose as Pose


def poses_of(
    problem: Problem,
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    assignment: NDArray[np.int64],
    motions: NDArray[np.int64],
) -> list[Pose | None]:
    """One pose per motion, None where a motion has fewer matches than the problem's pose needs.

    Raises
    ------
    InputError
        If the problem fits no poses.
    """
    Capability.POSE.require(problem.least_for_pose, problem.name)
    groups = [
        np.flatnonzero((motions == label) & (assignment >= 0)) for label in range(int(motions.max(initial=-1)) + 1)
    ]
    return [
        problem.pose(source[points], target[assignment[points]]) if len(points) >= problem.least_for_pose else None
        for points in groups
    ]
