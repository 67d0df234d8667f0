"""The flipped pose of a few points that are nearly in a plane: the same image, tilted the other way.

Seen from afar, a plane and its mirror image about the line of sight look nearly the same (Oberkampf, DeMenthon and
Davis 1996; Schweighofer and Pinz 2006). A fit ends in the minimum nearer to its start, and its covariance ignores the
other one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import one_rotation_matrix
from rootmatch.explain.predicted_likelihood import unbiased_frame
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.pose_fit.pose import Pose

LEAST, MOST = 3, 8
"""Fewest and most matches for which a flipped pose is tried: with more, it hardly explains the image as well. Round
values."""
FLAT = 0.5
"""Extent of points across a plane, relative to their smaller extent within it, up to which they count as planar. A
round value."""
NEAR = 1.0
"""Angle between the two, in radians, up to which the flipped pose counts: a body moves from one to the other only where
both coincide. Without a bound, one flight lost its body when four points were flipped by 120 degrees; with 0.7, another
lost its pose (benchmarks/tracking.py, seeds from 1000 and 1100)."""
NEGLIGIBLE = 0.02
"""Probability below which it does not count. A round value."""


def flipped_pose(task: MatchingTask, assignment: NDArray[np.int64], pose: Pose) -> tuple[Pose, float] | None:
    """The flipped pose of an assignment, and its probability relative to the given pose by the detections alone.

    Parameters
    ----------
    task : MatchingTask
        Of a problem with one camera.
    assignment : (n,) array
        Detections of the source points, −1 for none.
    pose : Pose
        That was fitted to it.

    Returns
    -------
    (Pose, float) or None
        None if there is no such pose: the points are many or not planar, are seen from the front, or fit only one of
        the two.
    """
    used = np.flatnonzero(assignment >= 0)
    if not LEAST <= len(used) <= MOST:
        return None
    points = task.points.source[used]
    centre = points.mean(axis=0)
    _, extent, axes = np.linalg.svd(points - centre)
    if extent[2] > FLAT * extent[1]:
        return None
    seen = pose.R @ centre + pose.t
    distance = float(np.linalg.norm(seen))
    line, normal = seen / distance, pose.R @ axes[2]
    axis = np.cross(normal, line)
    sine, cosine = float(np.linalg.norm(axis)), float(normal @ line)
    if sine == 0.0:
        return None
    # the normal, to the line of sight and as far beyond
    turned = one_rotation_matrix(2.0 * math.atan2(sine * math.copysign(1.0, cosine), abs(cosine)) / sine * axis)
    R = turned @ pose.R
    frame = unbiased_frame(task, pose.R, pose.t, distance)
    here, there = frame.fitted(assignment, pose.R, pose.t), frame.fitted(assignment, R, seen - R @ centre)
    if float(np.trace(there.R.T @ pose.R)) < 1.0 + 2.0 * math.cos(NEAR):
        return None
    probability = 1.0 / (1.0 + math.exp(min(max(0.5 * (there.chi2 - here.chi2), 0.0), 700.0)))
    if probability < NEGLIGIBLE:
        return None
    return Pose.unchecked(there.R, there.t, there.covariance), probability
