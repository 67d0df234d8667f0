"""One body that a tracker follows: its pose, or several, and the frames in which it was not found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.predicted_assignment import Found
from rootmatch.explain.predicted_pose import free_pose
from rootmatch.options import Options, option
from rootmatch.tracking.motion_filter import DEFAULT_MOTION, MotionFilter, MotionOptions
from rootmatch.tracking.rival_poses import LIKELY, Decided, RivalPose, Shape
from rootmatch.tracking.searched_poses import searched


class TrackingState(Enum):
    """Whether a body is being followed."""

    LOST = "lost: its pose is not known; the next frame is searched for it"
    COASTING = "coasting: not found in the last frame; its pose is predicted from those before"
    TRACKING = "tracking: found in the last frame"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class TrackingOptions(Options):
    """Options that decide when a tracker searches and gives up; their effect is measured in benchmarks/tracking.py."""

    interval: float = option(1.0 / 60.0, above=0.0)
    """Seconds between frames that are given without a time."""
    coasting: float = option(0.5, least=0.0)
    """Seconds without a match after which a body is lost."""
    patience: int = option(1, least=0)
    """Number of frames in which a prediction may fail before one is searched without it: occlusions often end by
    themselves."""
    present: float = option(0.7, least=0.0)
    """Number of detections, relative to the last matched frame, from which a frame is searched: with fewer, the body is
    hidden. A round value."""
    search_budget: int = option(30_000, least=1)
    """Evaluations of a search, all but that of the first frame, so that it ends within 50 ms. 100,000 find the same;
    with 10,000 two of 120 flights followed a wrong pose where 30,000 found the right one (benchmarks/tracking.py, seeds
    from 1100 and 2100)."""
    search_every: int = option(10, least=1)
    """Interval in frames between searches for missing bodies (with several bodies), and for a followed body most of
    whose visible points are missing. A round value."""
    missing: float = option(0.6, least=0.0, most=1.0)
    """Share of the visible points below which most of them count as missing. A round value."""
    motion: MotionOptions = option(DEFAULT_MOTION)
    """How fast a body may move."""


class FollowedBody:
    """One body: its pose, or several, while it is not lost, and the frames in which it was not found.

    Parameters
    ----------
    source : (n, 3) array
        Its points.
    options : TrackingOptions
    symmetries : list of (R, t)
        Motions after which the body looks the same from some side.
    """

    def __init__(
        self,
        source: NDArray[np.float64],
        options: TrackingOptions,
        symmetries: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]] = (),
    ) -> None:
        self.shape, self.options = Shape(source, list(symmetries), options.motion), options
        self.detections = self.searched = 0
        self.forget()

    def forget(self) -> None:
        """Declare the body lost."""
        self.rivals: list[RivalPose] = []
        self.settled = False
        self.missed = self.scant = 0

    @property
    def state(self) -> TrackingState:
        """Whether the body is being followed; not while several poses are followed of which none was certain before."""
        if not self.rivals or not self.settled:
            return TrackingState.LOST
        return TrackingState.TRACKING if self.missed == 0 else TrackingState.COASTING

    def worth_a_search(self, detections: int) -> bool:
        """Whether this many detections may show the body elsewhere than predicted."""
        return self.missed >= self.options.patience and detections >= self.options.present * self.detections

    def misses(self, found: Found, others: int) -> bool:
        """Whether many visible points were missing in this frame and the previous one, so the body may be elsewhere."""
        few = found.matched < self.options.missing * found.expected and others >= found.matched
        self.scant = self.scant + 1 if few else 0
        return self.scant > self.options.patience

    def late(self, frame: int) -> bool:
        """Whether the last search for the followed body was long ago; if so, the next interval starts now."""
        if frame - self.searched < self.options.search_every:
            return False
        self.searched = frame
        return True

    def hold(self, after: Decided, detections: int) -> None:
        """Take in a frame that agrees with one of the poses."""
        self.rivals = after.left
        self.settled |= after.sure
        self.missed, self.detections = 0, detections

    def miss(self, time: float) -> None:
        """Take in a frame in which the body was not found."""
        self.missed += 1
        self.rivals = [one for one in self.rivals if time - one.filter.time <= self.options.coasting]
        if not self.rivals:
            self.forget()

    def presume(self, time: float) -> None:
        """Let a frame without a match narrow the predictions by detections that are probably the body's."""
        for rival in self.rivals:
            rival.presume(time)

    def start(self, match: Finding, time: float) -> None:
        """Take in the match of a frame that was searched while the body was lost."""
        if match.status is Status.UNTRUSTED:
            return
        after = searched(match, [], self.shape, time)
        self.hold(after, match.task.shape[1])

    def take(self, match: Finding | None, predicted: bool, time: float) -> None:
        """Take in the match of a frame, made with or without a prior, while only one pose is followed.

        With a prior that holds, a doubt about one detection does not stop the filter.
        """
        held = match is not None and match.prior_holds is True and match.status is not Status.UNTRUSTED
        sure = match is not None and match.status is Status.MATCHED
        if match is None or not (sure or (held and (match.probability or 0.0) >= LIKELY)):
            self.miss(time)
            return
        self.missed, self.detections, self.settled = 0, match.task.shape[1], True
        if held and match.fused_pose is not None and self.rivals and predicted:
            del self.rivals[1:]
            self.rivals[0].filter.update(match.fused_pose, time)
        else:
            self.rivals = [RivalPose(MotionFilter(self.shape.source, free_pose(match), time, self.options.motion))]
