"""Poses of a match, one per motion, fitted after the assignment was found; matching itself does not use them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.pose_fit.pose import Pose

LEAST = 1
"""Degrees of freedom beyond two that a pose is taken to have at the least, where its noise is estimated."""


def fit_match_poses(task: MatchingTask, assignments: list[Integers], motions: Integers) -> list[list[Pose | None]]:
    """Poses of each assignment (n,), one per motion (n,); raises `InputError` if the problem fits none.

    Matched points without a motion are left out, unless there is only one. None for a motion with fewer matches than
    the problem's pose needs, or if no pose puts them in front of the camera. All are fitted at once.
    """
    problem = task.problem
    Capability.POSE.require(problem.least_for_pose, problem.name)
    count = int(motions.max(initial=-1)) + 1
    labels = np.zeros_like(motions) if count == 1 else motions
    groups = [np.where(labels == label, assignment, -1) for assignment in assignments for label in range(count)]
    enough = [k for k, group in enumerate(groups) if (group >= 0).sum() >= problem.least_for_pose]
    fitted = problem.poses(task.points, np.array([groups[k] for k in enough])) if enough else []
    # a pose predicts no image of a point that is beside the camera
    poses = {
        k: inflate_estimated_noise(task, pose)
        for k, pose in zip(enough, fitted, strict=True)
        if pose is not None and (pose.predicted is None or np.isfinite(pose.predicted).all())
    }
    return [[poses.get(row * count + label) for label in range(count)] for row in range(len(assignments))]


def inflate_estimated_noise(task: MatchingTask, pose: Pose) -> Pose:
    """A pose with the covariance of its t-distribution, if the noise was estimated from its own residuals."""
    if not task.noise_is_estimated or pose.covariance is None or pose.dof is None:
        return pose
    return replace(pose, covariance=pose.covariance * (pose.dof / max(pose.dof - 2, LEAST)))
