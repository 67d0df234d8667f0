"""How certain a frame's finding is by the frames before it, why not, and what is left of it.

That one point may show something else makes no pose doubtful which many others determine. Otherwise a body whose
points are hidden now and then, each of them for a frame, is hardly trusted at all: doubtful matches are left out, as
those are that are doubtful by an image alone.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.image_decision import KEPT
from rootmatch.explain.point_set_decision import matches_pose
from rootmatch.frozen import copy_with
from rootmatch.model.pose_density import MINIMUM
from rootmatch.model.posterior import Others, drop_doubtful_matches
from rootmatch.model.priors import COPY, PRESENT_ODDS, probability
from rootmatch.tracking.belief import Belief
from rootmatch.tracking.followed_places import clutter_after, log_return, return_factor, share_unseen, sole_odds_of
from rootmatch.tracking.followed_pose import FollowedPose

ALIKE = "it may be another object of nearly the same shape, as not every frame fitted"
GAVE_UP = "what was followed along its line of sight a moment ago did not fit"


def pose_certainty(belief: Belief, found: Finding, time: float) -> tuple[float, str]:
    """Probability that what holds in a frame is the body and no pose was left out, as far as that frame does not tell.

    With what most of the doubt is about.
    """
    holds, told = bool(found.prior_holds) and bool(belief.poses), found.posterior
    absent = log_return(belief.poses[0], time) if holds else belief.log_absent(found, found.mode, time, seen=False)
    sure = {
        "it may be in a place where it was followed before": 1.0 - belief.gone.share,
        "it may be a look-alike that came into view": probability(-math.log(COPY) - absent),
    }
    if back := belief.presence_after_return(time):  # where it was followed, or as a jump from there
        returned = return_factor(1.0 if told is None else clutter_after(told, back), back)
        sure["it was not in view a moment ago, and little shows it now"] = returned
    origins = None if told is None else told.origins
    goes_on = -1 if not holds else 0 if origins is None else max(int(origins[found.mode]), 0)
    pose = None
    if belief.given_up is not None:  # between two point sets a finding has no pose where no prediction holds
        pose = matches_pose(found) if found.pose is None and found.labellings is not None else found.pose
    if holds:
        unseen = share_unseen(found, belief.poses, belief.places) if len(belief.poses) > 1 else 0.0
        sure |= {
            "it may have another pose, as an earlier frame left more poses possible than are followed": 1.0
            - belief.unfollowed,
            "it may be in another place that is followed and of which this frame shows nothing": 1.0 - unseen,
            "it may be clutter that looks like it by chance and persists": _seen_chance(belief.poses[goes_on], found),
        }
    if holds or pose is not None:
        other = belief.log_other(goes_on, pose, time, found, found.assignment)
        sure[ALIKE if holds else GAVE_UP] = probability(-other)
    return math.prod(sure.values()), min(sure, key=sure.__getitem__)


def _seen_chance(followed: FollowedPose, found: Finding) -> float:
    """Probability that what is followed is more than clutter that persists, by what frames tell for themselves."""
    model, told = found.model, found.posterior
    if model is None or told is None or found.labellings is not None:
        return 1.0
    return probability(PRESENT_ODDS + followed.log_odds_with(lambda: sole_odds_of(model, told.modes, found.mode)))


def drop_doubtful(found: Finding, weighed: Finding) -> Finding:
    """What was found without the matches that are doubtful, if it is trusted then; else as it was weighed.

    ``found``: by a frame, about a predicted pose; ``weighed``: with the confidence that the frames before leave.
    """
    minimum, told, confidence = found.facts.min_probability, found.posterior, weighed.confidence
    if found.status is not Status.MATCHED or weighed.status is Status.MATCHED or told is None or confidence is None:
        return weighed
    matched = found.assignment >= 0
    pose = float(confidence[matched].max(initial=0.0))
    if pose < minimum:
        return weighed
    believed = drop_doubtful_matches(found.assignment, confidence, pose, minimum, pose=pose)
    kept, every = believed.assignment >= 0, np.count_nonzero(told.modes.assignments[found.mode] >= 0)
    if np.count_nonzero(kept) < MINIMUM or believed.known < KEPT * every:
        return weighed
    return copy_with(
        found.with_facts(probability=believed.probability),
        assignment=believed.assignment,
        confidence=np.where(matched & ~kept, 1.0 - confidence, confidence),
        others=Others(told, TRUST.alternatives, than=believed.assignment),
    )
