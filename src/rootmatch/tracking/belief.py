"""The belief about a body's pose from frame to frame: a few hypotheses with their probabilities.

If the two halves of a headset are copies of each other to within fractions of a millimetre, one side looks like the
other. The pose and its near-symmetric pose then agree in frame after frame, and each frame adds a little to the odds
(multiple hypothesis tracking, Reid 1979). Each hypothesis is therefore a motion filter with a weight; together they are
the prior of the next frame, and the modes of that frame's posterior are the next hypotheses. No frame decides for good:
the prior reserves the share `rootmatch.explain.prior_validation.DOUBT` for the case that none of them is right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.explain.image_decision import mode_misfit
from rootmatch.explain.prior_validation import DOUBT
from rootmatch.explain.rig_triples import is_met_by_search
from rootmatch.frozen import copy_with
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import Doubted
from rootmatch.model.priors import IN_VIEW, PRESENT_ODDS, WRONG_MODEL, log_chance
from rootmatch.model.widened_prediction import FREEDOM
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.samplers.guided.rivals import EXISTS
from rootmatch.tracking.averaged_pose import average_pose
from rootmatch.tracking.followed_places import (
    LOOKED_AT,
    GonePlaces,
    absence_chance,
    clutter_after,
    copy_chance,
    log_absence,
    log_return,
    log_returned,
    overlooked_chance,
    sole_odds_of,
)
from rootmatch.tracking.followed_pose import (
    FollowedPose,
    Step,
    pool_place_weights,
    share_misfit_odds,
    unify_alike_moves,
    update_motion,
)
from rootmatch.tracking.mistaken_identity import (
    FLOOR,
    GIVEN_UP,
    TEMPER,
    log_other_presence,
    seeing_centres,
    update_identity,
)
from rootmatch.tracking.motion_filter import ALIKE, MotionFilter, MotionOptions
from rootmatch.tracking.weighed_modes import LIKELY, WeighedModes, weigh_modes

MAXIMUM = 4
"""Largest number of poses followed at once, each for about a millisecond per frame. A round value."""
NEGLIGIBLE = math.log(1e4)
"""Log-odds against the best hypothesis at which one is given up: the decision holds for the rest of a flight."""
DOUBTED = 1e-3
"""Initial weight, relative to the best pose, of one that looks the same: frames may have decided wrongly. Round."""


class Belief:
    """The hypotheses of one body's pose; none while it is lost. ``source``: (n, 3) its points."""

    def __init__(self, source: Floats, motion: MotionOptions) -> None:
        self.source, self.motion = source, motion
        self.forget()

    def forget(self) -> None:
        """Give up all, and know nothing of the body any more."""
        self.poses: list[FollowedPose] = []
        self.others: Sequence[MotionFilter] = ()
        """Of the body in the places in which others of its family are followed."""
        self.time = -math.inf
        """Of the last frame that was taken in, seconds."""
        self.gone = GonePlaces()
        self.given_up: MotionFilter | None = None
        self.maximum = 0
        """Largest number of matches with which a single place was weighed for itself alone."""
        self.absent = 1.0 - IN_VIEW
        """Probability that the body is not in view, as of that frame, if it is not where it is followed."""
        self.excluded = -math.inf
        """Time of the last search that met nothing but what is followed."""
        self.room: tuple[float, int] | None = None
        """Time of the last frame, and how many of its detections nothing explained that is followed."""

    def __bool__(self) -> bool:
        return bool(self.poses)

    @property
    def best(self) -> MotionFilter:
        """The filter of the most probable hypothesis."""
        return self.poses[0].filter

    def presence_after_return(self, time: float) -> float:
        """See `log_returned`; 0 if the body was seen in the last frame, or the caller says where it is now."""
        for one in self.poses:
            if not one.filter.time < self.time < time:
                return 0.0
        return log_returned(time - self.time) if self.poses else 0.0

    @property
    def unfollowed(self) -> float:
        """See `FollowedPose.unfollowed`; of the most probable hypothesis."""
        return self.poses[0].unfollowed if self.poses else 0.0

    @property
    def places(self) -> dict[int, float]:
        """The followed places, and the share of each."""
        out = dict[int, float]()
        for one, share in zip(self.poses, self.shares.tolist(), strict=True):
            out[one.place] = out.get(one.place, 0.0) + share
        return out

    @property
    def shares(self) -> Floats:
        """Probability of each hypothesis, which add up to one."""
        weight = np.array([one.log_weight for one in self.poses])
        weight = np.exp(weight - weight.max(initial=-math.inf))
        return np.asarray(weight / weight.sum())

    def predicted(self, time: float) -> tuple[Pose, tuple[tuple[Pose, float], ...]]:
        """The most probable pose at a time, and the others with their probabilities."""
        poses = [one.filter.predicted(time) for one in self.poses]
        return poses[0], tuple(zip(poses[1:], self.shares[1:].tolist(), strict=True)) if len(poses) > 1 else ()

    def forget_before(self, time: float) -> None:
        """Give up the hypotheses that no frame has confirmed since a time."""
        self._keep([one.filter.time >= time for one in self.poses])

    def leave_before(self, time: float) -> None:
        """Give up the places in which no frame has confirmed a hypothesis since a time."""
        if len(self.poses) > 1:
            seen = {one.place for one in self.poses if one.filter.time >= time}
            self._keep([one.place in seen for one in self.poses])

    def _keep(self, kept: Sequence[bool]) -> None:
        """Give up some hypotheses, and remember the share of the places that are not followed any more."""
        if all(kept):
            return
        before, things = self.places, {one.place: copy_chance(one.alone) for one in self.poses}
        self.poses = [one for one, keep in zip(self.poses, kept, strict=True) if keep]
        self.gone.add(before, self.places, things)

    def lose(self, absent: float = 1.0) -> None:
        """Give up all: what is found next may be what was in any of the places, or else, if the body is ``absent``."""
        self._keep([False] * len(self.poses))
        self.absent, self.maximum = absent, 0

    def keep_best(self, time: float) -> None:
        """Give up all hypotheses but the most probable one: the caller says at a time where the body is."""
        self.poses = [copy_with(one, since=time, log_absent=math.log(DOUBT), told=math.inf) for one in self.poses[:1]]
        self.gone, self.absent, self.time, self.given_up = GonePlaces(), DOUBT, time, None

    def add_turned(self, motions: Sequence[tuple[Floats, Floats]]) -> None:
        """Also follow the best pose after motions (R, t) that nearly map the body onto itself.

        Neither the search nor the frames since need have found all of these poses.
        """
        for R, t in motions:
            self._add(self.best.turned(R, t), math.log(DOUBTED))

    def add_place(self, filter_: MotionFilter) -> None:
        """Also follow a pose elsewhere, as of another body for which this one may have been taken."""
        pose = filter_.predicted(filter_.time)
        if len(self.poses) < MAXIMUM and not any(one.filter.is_near(pose, filter_.time) for one in self.poses):
            log_weight = self.poses[0].log_weight + math.log(DOUBTED)
            self.poses.append(copy_with(self.poses[0], filter=filter_, log_weight=log_weight))

    def _add(self, filter_: MotionFilter, log_share: float) -> None:
        """Follow another pose, unless one like it is followed, or as many as are followed at once."""
        known = any(float((filter_.R * one.filter.R).sum()) > ALIKE for one in self.poses)
        if len(self.poses) < MAXIMUM and not known:
            self.poses.append(copy_with(self.poses[0], filter=filter_, log_weight=self.poses[0].log_weight + log_share))

    def take(self, found: Finding, time: float, searched: bool = False) -> None:
        """Take in a frame's posterior: its modes continue the hypotheses about which they lie, or are new ones.

        A hypothesis that no mode continues stays as predicted; for it, the frame counts as one that does not show the
        body. ``searched``: whether a search for the body ended in this frame.
        """
        others = self._take(found, time)
        if searched and not others:
            self.excluded = time
            if not self.poses:  # nor did it meet the body
                absent = absence_chance(self.absent, time - self.time)
                self.absent, self.time = absent / (absent + (1.0 - absent) * found.facts.missed), time
        if self.poses:  # were it not seen again where it is followed
            self.absent = absence_chance(1.0, time - self.best.time)

    def _take(self, found: Finding, time: float) -> bool:
        """Take in a frame's posterior; whether it has something beside what is followed."""
        told, model = found.posterior, found.model
        if found.task.problem.takes_motion_prior:
            of_body = self.source, self.motion
            every = update_motion(self.poses, found, time, of_body, self.given_up, weight=TEMPER)
            self.given_up = next((one.filter for one in every if one.log_other >= GIVEN_UP), self.given_up)
            self.poses = [one for one in every if one.log_other < GIVEN_UP]
        elif self.poses and (told is None or not len(told.probabilities)):
            self.time = time  # it does not show what is followed
        if told is None or model is None or not len(told.probabilities):
            return False
        shares = self.shares
        if self.poses and isinstance(model.prior, Doubted):
            assert told.origins is not None
            origin, doubt = told.origins[:LOOKED_AT], model.prior.doubt
        else:
            origin, doubt = np.full(min(len(told.probabilities), LOOKED_AT), -1), 1.0
        log_shares = log_chance(np.concatenate([shares * (1.0 - doubt), [doubt]]))  # the last is that of a new one
        back = self.presence_after_return(time)
        nothing = math.log(max(clutter_after(told, back), 1e-300)) - back
        continued = origin >= 0
        if origin.size > 1:  # what is less probable than that the frame does not show the body continues nothing
            continued &= log_chance(told.probabilities[: len(origin)]) >= nothing + log_shares[origin]
        first = int(continued.argmax())
        often = TEMPER if origin[first] >= 0 else 1.0  # what was not there before is no evidence that frames repeat
        weighed, self.maximum = weigh_modes(
            found, origin, log_shares, (first, often), poses=self.poses, maximum=self.maximum, time=time
        )
        go_on = weighed.steps(found, model, nothing, log_shares)
        own = (log_chance(shares) if doubt == 1.0 else log_shares[:-1] - math.log1p(-doubt)).tolist()
        going = {step.origin for step in go_on}
        left = [k for k in range(len(self.poses)) if k not in going]
        stay = [self._keep_unmatched(k, often * nothing, go_on, own) for k in left]
        self._follow(found, weighed, sorted([*stay, *go_on], key=lambda one: -one.total), time)
        return weighed.others

    def _follow(self, found: Finding, weighed: WeighedModes, after: list[Step], time: float) -> None:
        """Follow the likeliest of the hypotheses that may be ``after`` a frame, the most probable first."""
        (told, model), modes, origin = found.posterior_and_model, weighed.modes, weighed.origin
        # no frame makes more of a place than it is, so one that is less probable than a wrong model never counts
        minimum = [math.log(WRONG_MODEL) if one.place != after[0].place else -NEGLIGIBLE for one in after]
        likely = [one for one, gap in zip(after, minimum, strict=True) if one.total > after[0].total + gap][:MAXIMUM]
        # an average takes several evaluations of the posterior: only poses that are followed have one
        seen = [step for step in after if step.mode is not None and step.origin >= 0] != []
        every = [self._advance(step, found, modes, time, seen) for step in likely]
        every = unify_alike_moves(every, [step.mode for step in likely], model, modes)
        self.given_up = next((one.filter for one in every if one.log_other >= GIVEN_UP), self.given_up)
        stands = origin[0] >= 0 or not weighed.is_shown or 0 in [step.mode for step in after]
        new = None if stands else (int(weighed.place[0]), float(weighed.weights[0] + weighed.shown[0]))
        every = share_misfit_odds(every, new)
        known, unfollowed = bool(self.poses), {one.place: one.unfollowed for one in self.poses}
        self.poses = pool_place_weights([one for one in every if one.log_other < GIVEN_UP])
        share = np.exp([step.total - after[0].total for step in after]).tolist()
        left = sum([one for one, step in zip(share, after, strict=True) if step not in likely]) / max(sum(share), 1.0)
        left += float(told.probabilities[len(origin) :].sum())
        if origin[0] < 0 and found.facts.missed > EXISTS and is_met_by_search(found.task, model, modes.assignments[0]):
            left = max(left, found.facts.missed)  # of what looks like itself, and does so in the next frame too
        for lead in after[:1]:
            unfollowed[lead.place] = max(left, unfollowed.get(lead.place, 0.0))
        for k, one in enumerate(self.poses):
            if one.unfollowed != (chance := unfollowed.get(one.place, 0.0)):
                self.poses[k] = copy_with(one, unfollowed=chance)
        if not known and len({one.place for one in self.poses if copy_chance(one.alone) >= LIKELY}) > 1:
            self.gone = GonePlaces()  # they are in view again
        if known and any(one.filter.time == time for one in self.poses):
            self.gone.fade(time - self.time)
        self.time = time

    def _keep_unmatched(self, k: int, more: float, go_on: Sequence[Step], log_shares: Sequence[float]) -> Step:
        """A hypothesis that no mode continues; ``more``: what the frame adds to its log-weight, if it tells of it.

        It does not where what is followed elsewhere explains the frame as well if the body is hidden.
        """
        last, shown = self.poses[k], 0.0
        lead = next((step for step in go_on if step.origin >= 0), None)
        if lead is not None and all(step.place != last.place for step in go_on):
            more, shown = lead.log_weight - lead.more - log_shares[lead.origin], lead.shown
        return Step(log_shares[k] + more, shown, k, None, 0.0, place=last.place, alone=last.alone)

    def log_absent(self, found: Finding, mode: int, time: float, seen: bool) -> float:
        """Log-odds that the body is not in view where a new place is found; ``seen``: if it is where it is followed."""
        if found.is_exchanged(mode):  # it was put in the place of another body, and did not come back
            return -PRESENT_ODDS
        if seen:
            return log_return(self.poses[0], time)
        before, since = (1.0, self.best.time) if self.poses else (self.absent, self.time)
        ago, overlooked, told = 0.0, 1.0, found.posterior
        if self.room and told is not None and found.model is not None and mode < len(told.probabilities):
            ago, overlooked = time - self.room[0], overlooked_chance(found.model, told.modes, mode, self.room[1])
        return log_absence(before, time - since, time - self.excluded, ago=ago, overlooked=overlooked)

    def log_other(self, k: int, pose: Pose | None, time: float, found: Finding, assignment: Integers) -> float:
        """Log-odds that what is found with a pose is something else, before it is known how well it fits.

        ``k``: the hypothesis that it continues, −1 for a new one; ``assignment``: by which it is found. What was not
        seen in the last frame may be what was given up.
        """
        known = self.poses[k].log_other if k >= 0 else FLOOR
        if self.given_up is None or pose is None or (k >= 0 and self.poses[k].filter.time == self.time):
            return known
        centres = seeing_centres(found, assignment)
        return max(known, log_other_presence(self.given_up, pose, time, centres))

    def _advance(self, step: Step, found: Finding, modes: Modes, time: float, seen: bool) -> FollowedPose:
        """The hypothesis that a step leads to; ``seen``: whether the body is where it is followed."""
        _, model = found.posterior_and_model
        if step.mode is None:
            return copy_with(self.poses[step.origin], log_weight=step.log_weight, shown=step.shown)
        pose = average_pose(model, modes, step.mode)
        if step.origin < 0:
            moving = MotionFilter(self.source, pose, time, self.motion)
            exchanged = found.is_exchanged(step.mode)
            if exchanged and (there := next((one for one in self.others if one.is_near(pose, time)), None)):
                moving = there.copy()  # as what was expected there
                moving.update(pose, time)
            absent = self.log_absent(found, step.mode, time, seen)
            last = FollowedPose(moving, since=time, log_absent=absent)
        else:
            last = self.poses[step.origin]
            moving = last.filter.copy()
            moving.update(pose, time, step.chance, tails=(FREEDOM, 0.0))
        misfit = Misfit.of_finding(found) if step.mode == found.mode else None
        misfit = misfit or mode_misfit(model, modes, step.mode)
        stands = found.status is Status.MATCHED or math.isfinite(step.weighed)
        shows = stands + (last.shows if step.origin >= 0 and last.filter.time == self.time else 0)
        before = self.log_other(step.origin, pose, time, found, modes.assignments[step.mode])
        log_other = update_identity(before, misfit, TEMPER, len(model.images) > 1)
        # what the caller knows counts as well where a body is found
        k = step.mode
        told = last.log_odds_with(lambda: sole_odds_of(model, modes, k) if self.poses else float(modes.log_mass[k]))
        return copy_with(
            last, filter=moving, log_weight=step.log_weight, shown=step.shown, log_other=log_other, place=step.place,
            alone=step.alone, weighed=step.weighed, shows=shows, told=told, frames=last.frames + 1,
        )  # fmt: skip
