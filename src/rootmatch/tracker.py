"""Follow a body, or several, from frame to frame: lost at first, then each pose predicts the next one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.cameras.rig import rig_of
from rootmatch.errors import InputError
from rootmatch.matcher import Matcher
from rootmatch.options import Options, option
from rootmatch.pipeline.body_labels import BodyLabels, Label, check_bodies
from rootmatch.pipeline.motion_filter import DEFAULT_MOTION, MotionFilter, MotionOptions
from rootmatch.pipeline.status import Status
from rootmatch.predicted import free_pose
from rootmatch.problems.base import Problem
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.result import Match
from rootmatch.rival_poses import RivalPose, decided, rivals_of

LIKELY = 0.5
"""Probability of an assignment about a prediction from which its pose is taken: more likely than all others."""


class TrackingState(Enum):
    """Whether a body is being followed."""

    LOST = "lost: its pose is not known; the next frame is searched for it"
    COASTING = "coasting: not found in the last frame; its pose is predicted from those before"
    TRACKING = "tracking: found in the last frame"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class TrackingOptions(Options):
    """When a tracker searches and gives up; what follows is measured in benchmarks/tracking.py."""

    interval: float = option(1.0 / 60.0, above=0.0)
    """Seconds between frames that are given without a time."""
    coasting: float = option(0.5, least=0.0)
    """Seconds without a match after which a body is lost."""
    patience: int = option(1, least=0)
    """Frames in which a prediction may fail before one is searched without it: an occlusion often ends by itself."""
    present: float = option(0.7, least=0.0)
    """Detections, over those of the last frame that was matched, from which it is searched: with fewer the body is
    hidden. A round value."""
    search_budget: int = option(30_000, least=1)
    """Evaluations of a search, all but that of the first frame, so that it ends within 50 ms; it is as good as one of
    100,000 (benchmarks/tracking.py, six flights, seeds from 1000)."""
    search_every: int = option(10, least=1)
    """With several bodies those that are not found are searched for in one of so many frames. A round value."""
    motion: MotionOptions = option(DEFAULT_MOTION)
    """How fast a body may move."""


class Tracker:
    """`rootmatch.match` for the frames of a sequence, each of which predicts the next.

    The first frame is matched as by `rootmatch.Matcher`. From then on a constant velocity predicts a pose with its
    covariance (a Kalman filter), which is the prior of the next match: a frame takes about a millisecond. A body that
    is not found is predicted further for a while, then lost, and searched for.

    Parameters
    ----------
    source : (n, 3) array
        Points in space in any frame and unit.
    problem : Problem
        `P3P` or `UP2P`.
    noise : float or (n',) array
        Standard deviation of a pixel coordinate, in pixels, unless `match` is given another.
    tracking : TrackingOptions
        Frame rate, patience, and how fast bodies may move.
    **options
        Of `rootmatch.match`: normals, view_angle, detection, bodies, max_seconds (which bounds the searches), and so
        on.

    Attributes
    ----------
    state : TrackingState
        LOST, COASTING or TRACKING; with several bodies that of the best followed. `states` has all.

    Raises
    ------
    InputError
        If the arguments cannot be used.
    """

    def __init__(
        self,
        source: ArrayLike,
        problem: Problem,
        *,
        noise: ArrayLike = 1.0,
        tracking: TrackingOptions = TrackingOptions(),
        **options: Any,
    ) -> None:
        if isinstance(noise, str):
            raise InputError(f"noise: {noise!r} given; a tracker needs a number of pixels, as Matcher may estimate it")
        if rig_of(problem) is not None:
            raise InputError(
                "tracker: a Rig given, whose poses are not predicted; match its frames by rootmatch.Matcher"
            )
        self.matcher = Matcher(source, problem, noise=noise, **options)
        Capability.PRIOR.require(problem.takes_prior, problem.name)
        self.tracking = tracking
        self.time: float | None = None
        labels = self.matcher.bodies
        self.labels: BodyLabels | None = (
            None if labels is None else check_bodies(labels, self.matcher.source, problem.order)
        )
        self._frame = 0
        self._bodies: dict[Label | None, _Followed] = {}
        for k, label in enumerate([None] if self.labels is None else self.labels.names):
            points = slice(None) if self.labels is None else self.labels.points_of(k)
            self._bodies[label] = _Followed(self.matcher.source[points], tracking)

    @property
    def state(self) -> TrackingState:
        """Whether the body, or any of several, is being followed."""
        order = list(TrackingState)
        return max(self.states.values(), key=order.index)

    @property
    def states(self) -> dict[Label | None, TrackingState]:
        """The state of each body by its label; of a single one by None."""
        return {label: body.state for label, body in self._bodies.items()}

    def predicted(self, time: float | None = None) -> dict[Label | None, Pose]:
        """Predicted poses of the bodies that are not lost, by label (None for a single one).

        Parameters
        ----------
        time : float, optional
            Seconds; that of the next frame by default.
        """
        if self.time is None:
            return {}
        when = self.time + self.tracking.interval if time is None else time
        return {label: body.filter.predicted(when) for label, body in self._bodies.items() if body.filter is not None}

    def reset(self) -> None:
        """Forget all poses: the next frame is searched."""
        self.time, self._frame = None, 0
        for body in self._bodies.values():
            body.filter, body.missed, body.rivals = None, 0, []

    def match(
        self,
        target: ArrayLike,
        *,
        time: float | None = None,
        prior: Pose | Mapping[Label, Pose] | None = None,
        noise: ArrayLike | None = None,
        max_seconds: float | None = None,
    ) -> Match:
        """The match of the next frame.

        Parameters
        ----------
        target : (n', 2) array
            Pixels, in any order, clutter among them; n' may change from frame to frame and may be 0.
        time : float, optional
            Seconds, later than that of the frame before; by default one interval later.
        prior : Pose or dict, optional
            What is known better than by the tracker's own prediction, say from an inertial sensor.
        noise : float or (n',) array, optional
            Of this frame.
        max_seconds : float, optional
            Bounds the search of this frame.

        Returns
        -------
        Match
            Untrusted where nothing is found. `Match.fused_pose` is the pose of detections and prediction together.

        Raises
        ------
        InputError
            If the frame is not later than the one before, or as `rootmatch.Matcher.match`.
        """
        when = self._time(time)
        priors = self.predicted(when)
        if prior is not None:
            given_priors: dict[Label | None, Pose] = {None: prior} if isinstance(prior, Pose) else dict(prior.items())
            priors |= given_priors
        given: Pose | Mapping[Label, Pose] | None
        if self.labels is None:
            given = priors.get(None)
            searching = given is None or self._bodies[None].worth_a_search(len(np.asarray(target)))
        else:
            given = {label: pose for label, pose in priors.items() if label is not None}
            lost = self.time is None or any(body.missed or body.filter is None for body in self._bodies.values())
            searching = lost and self._frame % self.tracking.search_every == 0
        self._frame += 1
        single = self._bodies.get(None)
        if single is not None and single.rivals and prior is None:
            self.time = when
            return single.settle(target, lambda pose: self.matcher.follow(target, pose, noise, searching=False), when)
        budget = None if self.time is None else self.tracking.search_budget
        found = self.matcher.follow(target, given, noise, max_seconds, searching=searching, budget=budget)
        self.time = when
        if self.labels is None:
            self._bodies[None].take(found, priors.get(None), when)
        elif found.bodies is not None:
            for label, match in found.bodies.items():
                self._bodies[label].take(match, priors.get(label), when)
        else:
            for body in self._bodies.values():
                body.take(None, None, when)
        return found

    def _time(self, time: float | None) -> float:
        if time is None:
            return 0.0 if self.time is None else self.time + self.tracking.interval
        if not isinstance(time, int | float | np.number) or not math.isfinite(time):
            raise InputError(f"time: {time!r} given; give seconds")
        if self.time is not None and time <= self.time:
            raise InputError(f"time: {time:g} s given after {self.time:g} s; give frames in order, or reset() first")
        return float(time)


class _Followed:
    """One body: its filter while it is not lost, and the frames in which it was not found."""

    def __init__(self, source: NDArray[np.float64], options: TrackingOptions) -> None:
        self.source, self.options = source, options
        self.filter: MotionFilter | None = None
        self.rivals: list[RivalPose] = []
        self.missed = 0
        self.detections = 0

    def worth_a_search(self, detections: int) -> bool:
        """Whether so many detections may show the body elsewhere than predicted."""
        return self.missed >= self.options.patience and detections >= self.options.present * self.detections

    @property
    def state(self) -> TrackingState:
        if self.filter is None:
            return TrackingState.LOST
        return TrackingState.TRACKING if self.missed == 0 else TrackingState.COASTING

    def take(self, match: Match | None, prior: Pose | None, time: float) -> None:
        """Take the match of a frame, which was made with a prior or without.

        With a prior that holds, a doubt about one detection does not stop the filter.
        """
        held = match is not None and match.prior_holds is True and match.status is not Status.UNTRUSTED
        sure = match is not None and match.status is Status.MATCHED
        self.rivals = []
        if match is None or not (sure or (held and (match.fitted_probability or 0.0) >= LIKELY)):
            self.missed += 1
            if self.filter is None and match is not None and match.status is Status.AMBIGUOUS and match.bodies is None:
                self.rivals = rivals_of(match, self.source, time, self.options.motion)
            if self.filter is not None and time - self.filter.time > self.options.coasting:
                self.filter, self.missed = None, 0
            return
        self.missed, self.detections = 0, match.task.shape[1]
        if held and match.fused_pose is not None and self.filter is not None and prior is not None:
            self.filter.update(match.fused_pose, time)
            return
        self.filter = MotionFilter(self.source, free_pose(match), time, self.options.motion)

    def settle(self, target: ArrayLike, follow: Callable[[Pose], Match], time: float) -> Match:
        """The match of a frame where the pose is one of several; see `rootmatch.rival_poses`."""
        after = decided(self.rivals, follow, time)
        self.rivals = after.left
        if after.sure:
            self.filter, self.rivals = after.left[0].filter, []
            self.missed, self.detections = 0, len(np.asarray(target))
        return after.match
