"""What a match of two point sets leaves of the hypotheses of a body's pose."""

from __future__ import annotations

from rootmatch.arrays import Floats
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.point_set_decision import pose_alone
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.motion_filter import MotionFilter, MotionOptions


def after_motion(
    followed: list[FollowedPose], found: Finding, time: float, of_body: tuple[Floats, MotionOptions]
) -> list[FollowedPose]:
    """Hypotheses after a match of two point sets: only one that is trusted tells a pose; ``of_body``: of a new one."""
    if found.status is not Status.MATCHED:
        return followed[:1]
    if found.prior_holds and found.pose is not None and followed:
        (best,) = [*(one for one in followed if one.filter.is_near(found.pose, time)), *followed][:1]
        best.filter.update(found.pose, time)
        return [best]
    pose, (source, motion) = pose_alone(found), of_body
    return followed[:1] if pose is None else [FollowedPose(MotionFilter(source, pose, time, motion))]
