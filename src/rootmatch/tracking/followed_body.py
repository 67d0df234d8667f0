"""One body that a tracker follows: its pose, or several, and the frames in which it was not found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from rootmatch.arrays import Floats
from rootmatch.errors import InputError
from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.image_hypotheses import is_search_needless
from rootmatch.explain.prior_validation import DOUBT, Rivals
from rootmatch.explain.rig_triples import is_met_by_search
from rootmatch.frozen import copy_with
from rootmatch.model.priors import PRESENT, WRONG_MODEL
from rootmatch.options import Options, option
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.tracking.belief import Belief
from rootmatch.tracking.certainty import drop_doubtful, pose_certainty
from rootmatch.tracking.dark_points import DarkPoints
from rootmatch.tracking.followed_places import RETURN, later_chance
from rootmatch.tracking.followed_pose import NarrowedPredictions
from rootmatch.tracking.mistaken_identity import FLOOR
from rootmatch.tracking.motion_filter import DEFAULT_MOTION, MotionOptions

LONGEST = 8
"""Times `TrackingOptions.search_every` that may lie between two searches for a followed body. A round value: bodies are
right and trusted as often as with 1 (benchmarks/flights.py, all families, 3 flights from 1100 and 1300)."""

MISSING = 3
"""Largest number of frames between searches for one of several bodies that is missing. A round value: in 15 flights of
a rig (seeds from 1110) a controller with five LEDs in view was not told in 8 frames, in 14 with 10; the median frame
takes a tenth longer where one is out of view."""

LONGEST_INTERVAL = 5.0
"""Seconds between frames from which no time of a frame may be left out: as many frames a second were meant. A round
value."""

DOUBTED = 0.5
"""Share of the evaluations of a search for a body that is found where it is expected. A round value."""

UNCERTAIN = "this frame fits, but no earlier frame was certain of this pose, and so few points may all match by chance"
UNSEARCHED = "this frame fits, but no search has yet excluded that another pose explains more"


class TrackingState(Enum):
    """Whether a body is being followed."""

    LOST = "lost: its pose is not known; the next frame is searched for it"
    COASTING = "coasting: not found in the last frame; its pose is predicted from earlier frames"
    TRACKING = "tracking: found in the last frame"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class TrackingOptions(Options):
    """Options that decide when a tracker searches and gives up; their effect is measured in benchmarks/tracking.py.

    Parameters
    ----------
    interval : float
        Seconds between frames that are given without a time.
    coasting : float
        Seconds without a match after which a body is lost, whatever the interval. With three intervals or more, it may
        be missed in a frame or two; at one frame a second, the default allows for one missed frame.
    present : float
        Number of detections, relative to the last matched frame, from which a frame is searched if its prediction
        fails; with fewer, the body is taken to be hidden. A round value.
    search_budget : int
        Evaluations of a search at 60 frames a second, in proportion more at longer intervals, all but that of the first
        frame: with what else is done in such a frame, 5 to 10 ms. The next search draws other minimal sets. A lost body
        takes no more evaluations by short searches than by long ones: 64 bodies among 4 to 40 other detections were
        searched for in 1,933 frames with 30,000 (eight were not found in 120), in 1,518 with 60,000 (six), and in 945
        with 120,000 (two). A round value, larger for a body of many points, such as a map, where a long frame does no
        harm.
    search_every : int
        Frames before a followed body is searched for if another pose may explain more, twice as many after each search
        that finds none, up to eight times; and between doubts about its poses. A round value.
    motion : MotionOptions
        How fast a body, or the camera, may move.
    """

    interval: float = option(1.0 / 60.0, above=0.0)
    coasting: float = option(0.5, minimum=0.0)
    present: float = option(0.7, minimum=0.0)
    search_budget: int = option(60_000, minimum=1)
    search_every: int = option(10, minimum=1)
    motion: MotionOptions = option(DEFAULT_MOTION)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.interval > LONGEST_INTERVAL:
            raise InputError(
                f"TrackingOptions: interval is {self.interval:g}; give the seconds between frames, such as 1/60; if "
                "frames are that far apart, give `update` their times"
            )


class FollowedBody:
    """One body: the belief about its pose, and the frames in which it was not found.

    ``source``: (n, 3) its points; ``symmetries``: motions (R, t) after which it looks the same from some side.
    """

    def __init__(
        self, source: Floats, options: TrackingOptions, symmetries: Sequence[tuple[Floats, Floats]] = ()
    ) -> None:
        self.options, self.symmetries = options, symmetries
        self.belief, self.dark = Belief(source, options.motion), DarkPoints()
        self.waiting: list[int | None] = []
        """Images that a search under way has not come to: cameras of a rig, None for a single one."""
        self.looked: list[int | None] = []
        """Images that it has come to."""
        self.detections = self.own = self.searched = self.served = self.failures = self.agreements = 0
        self.narrowed = NarrowedPredictions()
        self.since = self.begun = 0
        """Frames in which it was found after it was lost, and in which the last search for it began."""
        self.tried: int | None = None
        """Frame in which a search for it among all detections began, the last one that ended; None before one did."""
        self.left = 0
        """Detections that were left unexplained in the frame of the last search."""
        self.beside = False
        """Whether all that there was beside the body when it was found has been searched, if there was anything."""
        self.rest = False
        """Whether the search under way is among what is left, see `appeared`."""
        self.presence: tuple[float, float] | None = None
        """Probability that it is in view after all by the last search for it, and its time; None if it was found."""
        self.forget()

    def forget(self) -> None:
        """Know nothing of the body any more."""
        self._lose()
        self.belief.forget()
        self.dark, self.tried = DarkPoints(), None

    def _lose(self, absent: float = 1.0) -> None:
        """Declare the body lost; ``absent``: probability that it is not in view."""
        self.belief.lose(absent)
        self.dark.lose()
        self.settled, self.matched, self.beside, self.left = False, -math.inf, False, 0
        self.missed = self.agreements = 0
        self.excluded = False
        """Whether a search has ended since it was found, whatever it showed then."""
        self.confirmed = False
        """Whether poses elsewhere have been excluded since it was found: by a search, or by all that it explains."""

    def predicted(self, time: float, frame: int | None = None) -> tuple[Pose, Rivals]:
        """The most probable pose at a time, and what else it may be; of several bodies, in which ``frame``.

        That it does not move as predicted has the probability `DOUBT` in each interval in which it is not seen.
        """
        unseen = (time - self.belief.best.time) / self.options.interval
        moved = DOUBT if unseen <= 1.0 else 1.0 - (1.0 - DOUBT) ** unseen
        doubt = min(max(moved, 1.0 - self.dark.holds), 1.0 - WRONG_MODEL)
        pose, others = self.belief.predicted(time)
        narrowed = None
        if frame is not None and self.missed:
            narrowed = self.narrowed.of_frame(frame, len(self.belief.poses), searching=bool(self.waiting))
        places = tuple([one.place for one in self.belief.poses])
        return pose, Rivals(others, doubt, places, self.dark.at(time), self.dark.placed, narrowed=narrowed)

    def keep_best(self, time: float) -> None:
        """The caller says where the body is: nothing beside it is taken for its points."""
        self.belief.keep_best(time)
        self.dark.forget_lights()
        self.confirmed = True

    @property
    def state(self) -> TrackingState:
        """Whether the body is being followed; not while several poses are followed of which none was certain before."""
        if not self.belief or not self.settled:
            return TrackingState.LOST
        return TrackingState.TRACKING if self.missed == 0 else TrackingState.COASTING

    def present(self, time: float) -> float | None:
        """Probability that it is in view at a time, before the frame is seen; None while nothing is known of that.

        What was not in view a moment ago hardly is now: the probability of the last search goes back to that of a body
        of which no frame is known, within `RETURN` seconds. Point sets are asked so: images by `log_returned`.
        """
        if self.presence is None or self.belief:
            return None
        chance, then = self.presence
        return later_chance(chance, PRESENT, time - then, RETURN)

    def is_due(self, frame: int) -> bool:
        """Whether to search again for a body that is not followed: soon at first, since each frame shows other points.

        The interval doubles with every search that fails, up to `MISSING`.
        """
        wait = min(1 << min(self.failures - 1, 30), MISSING) if self.failures else 0
        return frame - self.searched >= wait

    def is_looked_for(self, frame: int) -> bool:
        """Whether a frame narrows a prediction of it in the place of a search: see `NarrowedPredictions`."""
        return bool(self.belief) and self.narrowed.last == frame

    def needs_search(self, found: Finding, frame: int, free: int = 0) -> bool:
        """Whether to search for the body in a frame, judged by the finding about its predicted poses.

        ``free``: detections that no other body has for certain, of several.
        """
        if not self.belief:
            return found.status is not Status.MATCHED  # what the caller knows may have found it
        if found.status is Status.UNTRUSTED:
            shown = found.task.shape[1] >= self.options.present * self.detections
            return shown or free >= max(self.options.present * self.own, found.task.minimal + 1)
        appeared = self.has_new_detections(found)
        if appeared and not self.beside:  # another one like it: nobody looked
            return True
        interval = self.options.search_every if appeared else self._interval
        return frame - self.searched >= interval and not _is_enough(found)

    def has_new_detections(self, found: Finding) -> bool:
        """Whether more is left beside a body that holds than at the last search: that is searched by itself."""
        holds = bool(self.belief) and found.status is not Status.UNTRUSTED
        return holds and _unused_count(found) - self.left > found.task.minimal

    def search_share(self, found: Finding) -> float:
        """Share of `TrackingOptions.search_budget` for a search: what a frame shows where it is expected can wait."""
        return DOUBTED if self.belief and found.status is Status.MATCHED else 1.0

    @property
    def _interval(self) -> int:
        """Frames between searches for poses that may explain more; it doubles with each that found none."""
        return self.options.search_every * min(1 << min(self.agreements, 30), LONGEST)

    def needs_joint_search(self, found: Finding, frame: int, free: int = 0) -> bool:
        """Whether a search for the body is due among those for several bodies."""
        if found.status is Status.UNTRUSTED:
            return self.is_due(frame) and self.needs_search(found, frame, free)
        known = self.settled and _is_enough(found, of_several=True)
        return not known and self.needs_search(found, frame)

    def checked(self, found: Finding, time: float, frame: int, searched: bool) -> Finding:
        """What was found in a frame: ambiguous if a pose elsewhere could explain more, and no search has excluded it.

        A search that met another pose has excluded the rest: the belief weighs what it met from then on.
        ``searched``: whether this frame was searched.
        """
        weighed = self.dark.weighed(found, time) if self.belief and found.prior_holds else found
        certain, why = 1.0, ""
        if found.status is Status.MATCHED:
            certain, why = pose_certainty(self.belief, weighed, time)
        sure, minimum = weighed.confidence, found.facts.min_probability
        surest = 0.0 if sure is None else float(sure[weighed.assignment >= 0].max(initial=0.0))
        doubted = certain < minimum or surest * certain < minimum <= surest
        whole = weighed.scale_probability(certain) if certain < 1.0 - WRONG_MODEL else weighed
        rest = whole if doubted else drop_doubtful(found, whole)
        matched = (weighed if doubted else rest).status is Status.MATCHED
        if searched:
            agrees = matched and found.prior_holds
            if self.beside or not (agrees and self.has_new_detections(found)):  # else it was among what is left alone
                self.agreements = self.agreements + 1 if agrees else 0
            self.failures = 0 if matched else self.failures + 1
            # a search for the body itself ends with it, whatever else there is
            self.searched, self.beside = frame, bool(self.belief) or _unused_count(found) <= found.task.minimal
            self.left = _unused_count(found) if self.beside else 0
        told = bool(found.prior_holds) and not self.belief  # by the caller
        if found.status is not Status.UNTRUSTED:
            self.excluded |= searched
            self.confirmed |= told or (self.excluded and found.facts.missed <= TRUST.missed)
        if not matched:
            return rest
        self.confirmed = self.confirmed or _is_enough(found, of_several=True)
        # a pose that no frame was certain of is not made certain by the next one: what it explains by chance, stays
        unsure = bool(self.belief) and not self.settled and not _is_met(rest)
        if self.confirmed and not unsure and not doubted:
            return rest
        reason = (
            f"this frame fits, but judging by earlier ones, {why}" if doubted else UNCERTAIN if unsure else UNSEARCHED
        )
        return copy_with(rest.with_facts(contested=True, sure_of_the_rest=False), reason=reason)

    def acquit(self) -> None:
        """Forget that what is followed did not fit: the noise was larger than it was taken to be."""
        self.belief.poses = [copy_with(one, log_other=FLOOR) for one in self.belief.poses]
        self.belief.given_up = None

    def take(self, found: Finding, time: float, frame: int, searched: bool) -> None:
        """Take in the finding of a frame that was searched for the body, or was not.

        From time to time, poses that look the same are followed beside the best one.
        """
        if self.belief:
            self.dark.take(found, time, self.belief.presence_after_return(time))
            if self.dark.more < found.another:
                found = copy_with(found, another=self.dark.more)
        self.belief.take(found, time, searched)
        in_space = found.task.problem.takes_motion_prior
        if found.status is Status.MATCHED or self.belief:
            self.presence = None
        elif searched and in_space:  # the search of an image is bounded: what it did not find may be there
            self.presence = found.facts.present or 0.0, time
        if found.status is Status.MATCHED:
            self.since = self.since if self.settled else frame
            self.settled, self.matched = True, time
        elif time - self.matched > self.options.coasting:
            self.settled = False
        # in space only a match that is trusted tells a pose
        if found.status is Status.UNTRUSTED or (in_space and not found.status):
            self.missed += 1
            self.belief.forget_before(time - self.options.coasting)
            if not self.belief:
                self._lose(1.0 - (found.facts.present or 0.0) if searched else self.belief.absent)
            return
        self.belief.leave_before(time - self.options.coasting)
        self.missed, self.detections, self.own = 0, found.task.shape[1], found.matched_count
        minimum = found.facts.min_probability
        if (
            self.belief
            and 1.0 - self.belief.unfollowed < minimum
            and frame - self.searched >= self.options.search_every
        ):
            self._lose(absent=0.0)  # what is not followed can only be found anew
            return
        if frame % self.options.search_every == 0 and self.belief and not in_space:
            self.belief.add_turned(self.symmetries)


def _unused_count(found: Finding) -> int:
    """Number of detections that a finding does not explain."""
    return found.task.shape[1] - found.matched_count


def _is_met(found: Finding) -> bool:
    """Whether a search would have met other poses of as many matches; two point sets need none."""
    if found.task.problem.takes_motion_prior or found.model is None:
        return True
    return is_met_by_search(found.task, found.model, found.assignment)


def _is_enough(found: Finding, of_several: bool = False) -> bool:
    """Whether no pose elsewhere could explain more than what was found; see `is_search_needless`."""
    if found.task.problem.takes_motion_prior:
        return True  # two point sets: every motion was weighed
    told, model = found.posterior_and_model
    return is_search_needless(model, told, found.task.minimal, of_several=of_several)
