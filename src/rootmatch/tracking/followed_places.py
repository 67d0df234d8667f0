"""Which of several places that a tracker follows is the body's.

Two hypotheses about the same detections are poses of one thing, and each frame tells more of which it is. Two that
share none are things in two places. Each of them is found where it was expected, whatever it is: the body, a copy of
it, or clutter that stays. So frames tell nothing of which one was asked for, but by what each shows for itself alone.
With O, the odds of what is seen in a place, without a prediction, against clutter, and κ, the odds of a copy,

    P(the body is in X) ∝ O_X Π_Y≠X (1 + κ O_Y) ∝ 1 / (κ + 1 / O_X)

Frames repeat this evidence rather than add to it, so a place has the mean of what they say since it came in sight, as
one frame would: the best of many is what chance shows as well. Beyond 1 / κ all are alike, but for how well each fits.
A place that is no longer seen keeps its share: the body may have left the view, as well as a copy.

A place that is met while another one is followed has the body if that was not in view when the other one was found and
has not come back before. A body leaves the view and comes back at a rate: for how long something is followed alone
tells that it is the body, and a body that was hidden a moment ago may be so still.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.explain.finding import Finding
from rootmatch.model.competition import joint_posterior
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_poses
from rootmatch.model.image_alike import cache_answer
from rootmatch.model.modes import Modes, is_same_place
from rootmatch.model.pose_density import Doubted
from rootmatch.model.posterior import Posterior
from rootmatch.model.priors import COPY, IN_VIEW, PRESENT_ODDS, log_chance, probability
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.mistaken_identity import FLOOR

Chance = TypeVar("Chance", float, Floats)
RETURN = 1.0
"""Seconds within which a body that was not in view may be so as probably as any. A round value: of ten tools of five
markers, three of them in view among four strays, 7 of 186 trusted matches of one flight were of absent ones without it,
in six flights with it none of 1,080."""
EVERY = slice(None)
LOOKED_AT = 8
"""Largest number of modes of a frame that are considered. A round value."""


class GonePlaces:
    """What is known of places that are not followed any more."""

    def __init__(self) -> None:
        self.share = self._maximum = 0.0
        """Probability that the body was in one of them, rather than in those that are followed; of the likeliest."""

    def add(self, before: Mapping[int, float], after: Mapping[int, float], things: Mapping[int, float]) -> None:
        """Give up some of the places with their shares, those that are not among the places after.

        If none is left, what is found next may be of any of them, and is so best with the share of the largest. It
        comes back as probably as any of the other things, so its share counts for less the more of them there are.

        ``things``: probability that each place has something that lasts, whether or not it is the body.
        """
        every = [(1.0 - self.share) * share for place, share in before.items() if place not in after]
        self._maximum = max([self._maximum, *every])
        self.share += sum(every)
        if not after:
            others = sum(things.values())
            comes_back = sum(share / (1.0 + others - things[place]) for place, share in before.items())
            self.share, self._maximum = 1.0 - min(self._maximum, comes_back), 0.0

    def fade(self, seconds: float) -> None:
        """Count that the body has not come back there for some seconds in which what is followed was seen."""
        if self.share < 1.0:
            stays = math.exp(-IN_VIEW / RETURN * seconds)
            left = 1.0 - self.share * (1.0 - stays)
            self.share, self._maximum = self.share * stays / left, self._maximum * stays / left


def sort_into_places(
    model: DetectionModel, modes: Modes, origin: Integers, followed: Sequence[FollowedPose], shown: Floats
) -> tuple[Integers, Floats, Floats, Floats]:
    """The place (M,) of each mode, its log-odds alone, and what is added to its log-weight for what it shows alone.

    Last, `log_weight` of each place; −∞ if there is one place only.

    Of what is expected in several places, which points are shown tells nothing: either may be that of something else,
    which shows the same. So ``shown`` (M,), the log-probability of the points that each shows, changes.

    ``modes``: the most probable first; ``origin``: (M,) the followed hypothesis that each goes on from, −1 for a new
    one.
    """
    known = [one.place for one in followed]
    alone, more = np.full(len(origin), max((one.alone for one in followed), default=-math.inf)), np.zeros(len(origin))
    weight = np.full(len(origin), -math.inf)
    if len(origin) == 1 and len({*known}) <= 1 and (origin[0] >= 0 or not known):
        return np.array(known[:1] or [0]), alone, more, weight
    place = assign_places(modes.uses(model.shape[1]), origin, known)
    every = set(place.tolist())
    if len(every.union(known)) == 1:
        return place, alone, more, weight
    told, reference = sole_odds(model, modes), int((origin >= 0).argmax())
    for number in every:
        own = place == number
        first = int(own.argmax())
        last = next((one for one in followed if one.place == number), None)
        alone[own] = now = float(told[first]) if last is None else last.alone_with(float(told[first]))
        shown[own] += shown[reference] - shown[first]
        weight[own] = log_weight(now, FLOOR if last is None else last.log_other)
        if last is not None and math.isfinite(last.weighed):
            more[own] = weight[first] - last.weighed
    return place, alone, more, weight


def share_unseen(found: Finding, poses: Sequence[FollowedPose], places: Mapping[int, float]) -> float:
    """Share of the places of which a frame shows nothing, if it shows another that is followed."""
    origins = None if found.posterior is None else found.posterior.origins
    if len(poses) < 2 or origins is None:
        return 0.0
    seen = {poses[k].place for k in origins[:LOOKED_AT].tolist() if k >= 0}
    return sum(share for place, share in places.items() if place not in seen) if seen else 0.0


def assign_places(uses: Bools, origin: Integers, followed: Sequence[int]) -> Integers:
    """The place (M,) of each mode: that of the others that share detections with it.

    ``uses``: (M, n') the detections of each mode, the most probable first. ``origin``: (M,) the followed hypothesis
    that each goes on from, −1 for a new one. ``followed``: the place of each hypothesis, which its first mode keeps;
    new places have numbers that are not among these.
    """
    count = len(uses)
    out, new = np.full(count, -1), max(followed, default=-1) + 1
    overlap = is_same_place(uses)
    for k in range(count):
        if out[k] >= 0:
            continue
        mine = overlap[k] & (out < 0)
        known = [followed[o] for o in origin[mine].tolist() if o >= 0 and followed[o] not in out]
        if known:
            out[mine] = known[0]
        else:
            out[mine], new = new, new + 1
    return out


def sole_odds(model: DetectionModel, modes: Modes, which: slice = EVERY) -> Floats:
    """Log-odds (M,) of modes against clutter, without a prediction; ``which``: of them."""
    if not isinstance(model.prior, Doubted):
        return modes.log_mass[which]
    # a frame asks as it is weighed, and as it is learned from
    anywhere = cache_answer(_weigh_anywhere, model, tuple([one[which] for one in modes[:3]]))
    return np.asarray(modes.log_mass[which] - modes.log_odds[which] + anywhere)


def _weigh_anywhere(model: DetectionModel, mode: tuple[Any, ...]) -> Floats:
    """Log-odds (M,) of assignments with poses, without a prediction."""
    assert isinstance(model.prior, Doubted)
    assignments, rotation, position = mode
    return weigh_poses(model, assignments, rotation, position, model.prior.without)[0].log_odds


def sole_odds_of(model: DetectionModel, modes: Modes, k: int) -> float:
    """`sole_odds` of one of the modes."""
    return float(sole_odds(model, modes, slice(k, k + 1))[0])


def log_weight(alone: float, log_other: float = -math.inf) -> float:
    """Logarithm of 1 / (κ + 1 / O) / (1 + q): how probably a place is the body's, relative to others.

    ``log_other``: logarithm of the odds q that something else than the body is there, by how it fits.
    """
    return -float(np.logaddexp(math.log(COPY), -alone) + np.logaddexp(0.0, log_other))


def copy_chance(alone: float) -> float:
    """Probability that what is in a place is a copy rather than clutter, if it is not the body."""
    return COPY * math.exp(log_weight(alone))


def later_chance(chance: Chance, usual: float, seconds: float, lasts: float) -> Chance:
    """Probability of what may change, some seconds later: back to the ``usual`` one, by e within ``lasts`` seconds."""
    return usual + (chance - usual) * math.exp(-seconds / lasts)


def absence_chance(before: float, seconds: float) -> float:
    """Probability that a body is not in view, some seconds after it was not with another probability."""
    return later_chance(before, 1.0 - IN_VIEW, seconds, RETURN)


def log_returned(seconds: float) -> float:
    """Log-odds that a body is in view that was not so some seconds ago, relative to those in an image by itself.

    A frame that shows three lights where the body is awaited tells little, and sixty frames a second do so soon.
    """
    chance = later_chance(0.0, IN_VIEW, seconds, RETURN)
    return math.log(chance) - math.log1p(-chance) - PRESENT_ODDS


def return_factor(clutter: float, log_odds: float) -> float:
    """Factor on the probabilities of poses, of which clutter alone is the rest, by `log_returned`."""
    odds = math.exp(log_odds)
    return odds / (odds * (1.0 - clutter) + clutter)


def clutter_after(told: Posterior, log_odds: float) -> float:
    """Probability of clutter for `return_factor`, where a copy that it has must have come into view as well."""
    if not told.copy:
        return told.clutter
    came = probability(log_odds + PRESENT_ODDS) / IN_VIEW
    return told.clutter - (1.0 - came) * told.copy


def overlooked_chance(model: DetectionModel, modes: Modes, mode: int, left: int) -> float:
    """Probability that what is in view with a mode has no more than so many detections in another frame.

    ``left``: detections there that nothing else explains. Points are detected at a rate, of which the mode tells.
    """
    matched = int(np.count_nonzero(modes.assignments[mode] >= 0))
    visible = max(round(float(modes.visible[mode].sum())), matched)
    if left >= visible:
        return 1.0
    rate, weight = model.rate_quadrature
    weight = weight + matched * np.log(rate) + (visible - matched) * np.log1p(-rate)
    weight = np.exp(weight - weight.max())
    seen = sum(math.comb(visible, k) * rate**k * (1.0 - rate) ** (visible - k) for k in range(left + 1))
    return float(weight @ seen / weight.sum())


def log_absence(
    before: float, seconds: float, unsearched: float, *, ago: float = 0.0, overlooked: float = 1.0
) -> float:
    """Log-odds that a body is not in view where it seems to be found: that a copy came, to that the body came back.

    A copy is there at any time with the same probability, and comes as seldom as the body does: since a search that met
    none, or a frame that had no room for one, there was less time for it. In that frame the body was not there either.

    ``before``: probability that the body was not in view some ``seconds`` ago; ``unsearched``: seconds since the last
    search that would have met a copy; ``ago``: since the last frame that tells of a copy, and with which probability
    that was ``overlooked`` in it, see `overlooked_chance`.
    """
    ago = min(ago, seconds)
    absent = absence_chance(before, seconds - ago)
    absent = absence_chance(absent / (absent + (1.0 - absent) * overlooked), ago)
    new, came = (-math.expm1(-min(time, unsearched) / RETURN) for time in (ago, unsearched))
    return math.log(absent) - math.log1p(-absent) + math.log(new + (came - new) * overlooked)


def log_return(followed: FollowedPose, now: float) -> float:
    """Log-odds that the body was not in view when a place was found that is followed, and comes back only now."""
    return followed.log_absent - IN_VIEW / RETURN * (now - followed.since)


def relative_log_weights(model: DetectionModel, modes: Modes, each: Floats, own: Floats, first: int) -> Floats:
    """Log-weights (M,) of modes in other places relative to the followed one, whose first mode is given.

    By what each shows for itself, and by how much less probable it is because other bodies explain it as well.
    ``each`` (M,): logarithms of the probabilities of the modes in the frame; ``own`` (M,): `log_weight` of each place.
    """
    (told,) = joint_posterior([model], [modes], [()])  # as if there was no other body
    same = (told.modes.assignments == modes.assignments[:, None]).all(axis=2)
    same &= (told.modes.position == modes.position[:, None]).all(axis=2)
    without = log_chance((same * told.probabilities).max(axis=1))
    shared = each - each[first] - (without - without[first])
    return np.asarray(own - own[first] + np.minimum(shared, 0.0))
