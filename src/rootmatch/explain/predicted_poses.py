"""The predicted poses of a task, with the vertical where that is measured, and fits of assignments with them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross_matrix, rotation_from_vector
from rootmatch.explain.rig_copies import RigCopies
from rootmatch.explain.task import MatchingTask
from rootmatch.model.pose_prior import Gaussian
from rootmatch.problems.pose_fit.camera_pose import camera_poses
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.rig_fit import rig_pose
from rootmatch.problems.up2p import UP2P

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_TILT = 1e-5
"""Standard deviation, in radians, of a vertical that is called exact."""


def predictions_of(task: MatchingTask) -> list[tuple[Pose, float]]:
    """The predicted poses of a task and the share of each, which add up to 1: the one given, then its rivals."""
    assert task.prior_pose is not None
    every = [(task.prior_pose, 1.0 - sum(share for _, share in task.rival_poses)), *task.rival_poses]
    problem = task.problem
    if not isinstance(problem, UP2P):
        return every
    world, camera = np.asarray(problem.vertical_world, float), np.asarray(problem.vertical_camera, float)
    return [(with_vertical(pose, world, camera, problem.vertical_noise), share) for pose, share in every]


def polished_pose(task: MatchingTask, assignment: Integers, pose: Pose, prior_holds: bool) -> Pose | None:
    """The most likely pose of an assignment (n,) near a pose that is known, with its residuals.

    A prediction that holds is part of the fit, and counts less if it is far from that pose.
    """
    points, problem = task.points, task.problem
    prior = _with_tails(task, predictions_of(task)[0][0], pose) if prior_holds else None
    if isinstance(problem, RigCopies):
        return rig_pose(problem.copies, points, assignment, prior, start=pose)
    if isinstance(problem, UP2P) and prior is None:
        return problem.poses(points, assignment[None])[0]  # the vertical may be exact
    return camera_poses(points, problem.camera, assignment[None], prior=prior, start=pose)[0]  # type: ignore[attr-defined]


def _with_tails(task: MatchingTask, prior: Pose, near: Pose) -> Pose:
    """A prediction with as wide a covariance as it has for a pose, see `Gaussian.tail_weight`."""
    assert prior.covariance is not None
    gaussian = Gaussian(prior.R, prior.t, prior.covariance, freedom=task.prior_freedom)
    squared = replace(gaussian, freedom=math.inf).terms(near.R[None], near.t[None]).squared
    return Pose.unchecked(prior.R, prior.t, prior.covariance / float(gaussian.tail_weight(squared)[0]))


def about_prediction(task: MatchingTask, k: int) -> MatchingTask:
    """The same task with one of its predicted poses alone."""
    every = [task.prior_pose, *(pose for pose, _ in task.rival_poses)]
    return replace(task, prior_pose=every[k], rival_poses=())


def with_vertical(prior: Pose, world: Floats, camera: Floats, noise: float) -> Pose:
    """A prediction and a measured vertical together.

    Parameters
    ----------
    prior : Pose
    world, camera : (3,) arrays
        The vertical in the frame of the points and in that of the camera, of any length.
    noise : float
        Standard deviation of the second on each of two axes, in radians.
    """
    assert prior.covariance is not None
    down = prior.R @ (world / np.linalg.norm(world))
    measured = camera / np.linalg.norm(camera)
    jacobian = np.concatenate([-cross_matrix(down), np.zeros((3, 3))], axis=1)
    gain = prior.covariance @ jacobian.T
    total = jacobian @ gain + max(noise, LEAST_TILT) ** 2 * np.eye(3)
    kalman = gain @ np.linalg.inv(total)
    step = kalman @ (measured - down)
    covariance = prior.covariance - kalman @ gain.T
    return Pose(
        rotation_from_vector(step[None, :3])[0] @ prior.R, prior.t + step[3:], 0.5 * (covariance + covariance.T)
    )
