"""Motions in a plane as those of space that a filter follows: all stays at z = 0 and turns about z alone."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.shared_errors import SharedPose

TURN, SHIFT = 1e-12, 1e-6
"""Standard deviations of what a plane fixes: of turns out of it, in radians, and of the height over it, in radii of the
body. Far below any noise, and such turns move points by less than the height is uncertain."""


def points_in_space(points: Floats) -> Floats:
    """Points (n, 3) of a plane (n, 2), or of space, which stay as they are."""
    return np.column_stack([points, np.zeros(len(points))]) if points.shape[1] == 2 else points


def motion_in_space(R: Floats, t: Floats) -> tuple[Floats, Floats]:
    """A motion x' = R x + t of a plane, with R (2, 2) and t (2,), as one of space; one of space stays as it is."""
    if len(t) == 3:
        return R, t
    turn = np.eye(3)
    turn[:2, :2] = R
    return turn, np.append(t, 0.0)


def pose_in_space(pose: Pose, radius: float) -> Pose:
    """A pose in a plane as one in space, of a body of this radius."""
    assert pose.covariance is not None
    into = _into_space(len(pose.covariance) > 3)
    fixed = np.zeros(len(into))
    fixed[:2], fixed[5] = TURN**2, (SHIFT * radius) ** 2
    covariance = into @ pose.covariance @ into.T + np.diag(fixed)
    lifted = Pose.unchecked(*motion_in_space(pose.R, pose.t), covariance, pose.scale)
    return SharedPose.of(lifted, pose.shared.moved(into)) if isinstance(pose, SharedPose) else lifted


def pose_in_plane(pose: Pose) -> Pose:
    """What a pose in space is in the plane in which it stays."""
    assert pose.covariance is not None
    out = _into_space(len(pose.covariance) > 6).T
    flat = Pose.unchecked(pose.R[:2, :2], pose.t[:2], out @ pose.covariance @ out.T, pose.scale)
    return SharedPose.of(flat, pose.shared.moved(out)) if isinstance(pose, SharedPose) else flat


def _into_space(with_scale: bool) -> Floats:
    """From the parameters of a pose in a plane, its angle, place and maybe scale, to those of one in space."""
    into = np.zeros((6 + with_scale, 3 + with_scale))
    into[[2, 3, 4, *([6] if with_scale else [])], np.arange(3 + with_scale)] = 1.0
    return into
