"""How certain a frame's finding is by the frames before it, and why not."""

from __future__ import annotations

import math
from typing import NamedTuple

from rootmatch.explain.finding import Finding
from rootmatch.explain.point_set_decision import matches_pose
from rootmatch.model.priors import COPY, PRESENT_ODDS, probability
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.tracking.belief import Belief
from rootmatch.tracking.followed_places import clutter_after, log_return, return_factor, share_unseen, sole_odds_of
from rootmatch.tracking.followed_pose import FollowedPose

ALIKE = "it may be something else of nearly its shape, as not every frame fitted"
GAVE_UP = "what was followed in its line of sight a moment ago did not fit"


class Certainty(NamedTuple):
    """Probability that what a frame shows is the body, as far as that frame does not tell, and what speaks against."""

    chance: float
    reason: str
    """What most of the doubt is about."""


def pose_certainty(belief: Belief, found: Finding, time: float) -> Certainty:
    """How certain it is that what holds in a frame is the body, and that no pose was left out."""
    holds, told = bool(found.prior_holds) and bool(belief.poses), found.posterior
    absent = log_return(belief.poses[0], time) if holds else belief.log_absent(found, found.mode, time, seen=False)
    sure = {
        "it may be in a place in which it was followed before": 1.0 - belief.gone.share,
        "it may be another one that looks like it and came into view": probability(-math.log(COPY) - absent),
    }
    if belief.poses:  # where it was followed, or as a jump from there
        back = belief.presence_after_return(time)
        returned = return_factor(1.0 if told is None else clutter_after(told, back), back)
        sure["it was not in view a moment ago, and little shows it now"] = returned
    origins = None if told is None else told.origins
    goes_on = -1 if not holds else 0 if origins is None else max(int(origins[found.mode]), 0)
    pose = None if belief.given_up is None else found.pose or _pose_in_space(found)
    if holds:
        unseen = share_unseen(found, belief.poses, belief.places) if len(belief.poses) > 1 else 0.0
        sure |= {
            "it may have another pose, as a frame left more poses possible than are followed": 1.0 - belief.unfollowed,
            "it may be in another followed place, of which this frame shows nothing": 1.0 - unseen,
            "it is no more than what chance shows, which persists as well": _seen_chance(belief.poses[goes_on], found),
        }
    if holds or pose is not None:
        other = belief.log_other(goes_on, pose, time, found, found.assignment)
        sure[ALIKE if holds else GAVE_UP] = probability(-other)
    return Certainty(math.prod(sure.values()), min(sure, key=sure.__getitem__))


def _seen_chance(followed: FollowedPose, found: Finding) -> float:
    """Probability that what is followed is more than clutter that persists, by what frames tell for themselves."""
    model, told = found.model, found.posterior
    if model is None or told is None or found.labellings is not None:
        return 1.0
    return probability(PRESENT_ODDS + followed.told_with(lambda: sole_odds_of(model, told.modes, found.mode)))


def _pose_in_space(found: Finding) -> Pose | None:
    """The pose of a finding of two point sets, which has none of its own where no prediction holds."""
    return None if found.labellings is None else matches_pose(found)
