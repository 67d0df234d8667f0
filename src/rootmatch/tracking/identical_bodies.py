"""Identical bodies keep the names that they got when they were first seen together.

Which of two identical tools is the first one is a convention that no image tells: a frame is ambiguous, with as much
for either. From frame to frame they differ, as each has a motion. So once both are in view, each gives up the pose
that the other one was given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.body_labels import BodyLabels, Label, twin_points
from rootmatch.explain.body_options import OPTIONS
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.tracking.belief import ALIKE
from rootmatch.tracking.followed_body import FollowedBody
from rootmatch.tracking.motion_filter import MotionFilter

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Pairs = Sequence[tuple[Label, Label]]

NEARER = 0.2
"""Distance from the other body's place, over that between the bodies, up to which a pose is there. A round value."""


def identical_pairs(labels: BodyLabels, points: Floats, normals: Floats | None) -> Pairs:
    """Pairs of bodies with the same points, of (n, 3) of all, in any order, and the same normals if those are given."""
    every = {name: labels.points_of(k) for k, name in enumerate(labels.names)}
    return [
        (first, second)
        for first, second in combinations(every, 2)
        if _is_same(points, normals, every[first], every[second])
    ]


def keep_apart(
    pairs: Pairs, bodies: Mapping[Label | None, FollowedBody], parts: Mapping[Label | None, Finding]
) -> None:
    """Let each of two identical bodies that a frame shows give up the pose of the other one."""
    for pair in pairs:
        found = [parts[label] for label in pair]
        poses = [one.pose for one in found if one.pose is not None and one.status is not Status.UNTRUSTED]
        if len(poses) < 2:
            continue
        for label, own, other in zip(pair, poses, poses[::-1], strict=True):
            belief = bodies[label].belief
            kept = [one for one in belief.poses if not _is_there(one.filter, own, other)]
            if kept:
                belief.poses = kept


def _is_same(points: Floats, normals: Floats | None, first: Integers, second: Integers) -> bool:
    """Whether two bodies have the same points, and the same normals, in one frame: not turned, and no mirror images."""
    order = twin_points(points[first], points[second], OPTIONS.alike)
    if order is None:
        return False
    second = second[order]
    radius = float(np.linalg.norm(points[first] - points[first].mean(axis=0), axis=1).max())
    same = bool(np.abs(points[first] - points[second]).max() <= OPTIONS.alike * radius)
    if normals is not None:
        unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        same &= bool(np.abs(unit[first] - unit[second]).max() <= OPTIONS.alike)
    return same


def _is_there(followed: MotionFilter, own: Pose, other: Pose) -> bool:
    """Whether a followed pose is that of the other body."""
    pose = followed.predicted(followed.time)
    alike = float((pose.R * other.R).sum()) > ALIKE
    return alike and float(np.linalg.norm(pose.t - other.t)) <= NEARER * float(np.linalg.norm(own.t - other.t))
