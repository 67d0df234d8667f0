"""What a match of two point sets leaves of the hypotheses of a body's pose."""

from __future__ import annotations

from rootmatch.arrays import Floats
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.explain.point_set_decision import matches_pose
from rootmatch.frozen import copy_with
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.mistaken_identity import FLOOR, GIVEN_UP, log_other_presence, update_identity
from rootmatch.tracking.motion_filter import MotionFilter, MotionOptions

SURE = 2.0 * FLOOR
"""Log-odds of something else from which what is followed is the body, as long as each frame shows it. Nothing else
comes to be where points of space are predicted, to the noise, and a marker may be bent meanwhile. A round value."""


def update_motion(
    followed: list[FollowedPose],
    found: Finding,
    time: float,
    of_body: tuple[Floats, MotionOptions],
    given_up: MotionFilter | None,
    *,
    weight: float,
) -> list[FollowedPose]:
    """Hypotheses after a match of two point sets: only one that is trusted tells a pose.

    Whether what is followed is something else, each frame tells that shows it where it was expected.
    ``of_body``: points of the body, and how fast it may move, of a new hypothesis. ``given_up``: what was followed and
    did not fit. ``weight``: of a frame's evidence that it is something else.
    """
    matched, holds = found.status is Status.MATCHED, bool(found.prior_holds and found.pose is not None and followed)
    if holds and found.pose is not None:
        (best,) = [*(one for one in followed if one.filter.is_near(found.pose, time)), *followed][:1]
        if matched:
            best.filter.update(found.pose, time)
        return [copy_with(best, log_other=_log_other(best.log_other, found, weight))]
    is_another = not matched and found.another >= GIVEN_UP and (found.log_odds or 0.0) > 0.0
    pose = matches_pose(found) if matched or is_another else None
    new = None if pose is None else MotionFilter(of_body[0], pose, time, of_body[1])
    if not matched or pose is None or new is None:
        # what comes into view next may be something else
        still = [copy_with(one, log_other=max(one.log_other, FLOOR)) for one in followed[:1]]
        return still if new is None else [*still, FollowedPose(new, log_other=found.another)]
    log_other = FLOOR if given_up is None else log_other_presence(given_up, pose, time, None)
    return [FollowedPose(new, log_other=_log_other(log_other, found, weight))]


def _log_other(log_odds: float, found: Finding, weight: float) -> float:
    """Log-odds after a frame that it shows something else, of the body as it most probably is: with points off."""
    misfit = Misfit.told_by(found)
    if log_odds <= SURE or misfit is None or not (found.log_odds or 0.0) > 0.0:
        return log_odds
    return update_identity(
        log_odds, misfit, weight, as_off=misfit.largest_error_gain(found.task.log_inexact), least=SURE
    )
