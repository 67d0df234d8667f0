"""Poses between which a frame could not decide, each followed through the next frames until one is left.

Two halves of a headset that are copies of one another look the same from one side. The pose and its twin then agree in
frame after frame; it is the first view of something else that tells them apart, and until then no frame needs a search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.pipeline.motion_filter import MotionFilter, MotionOptions
from rootmatch.pipeline.status import Status
from rootmatch.predicted import free_pose
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.result import Match

MOST = 4
"""Poses that are followed at once, a millisecond each in every frame. A round value."""
SURE = 0.99
"""Probability, by one frame alone, from which one of them is followed and the others are given up: what is decided here
stands for the rest of a flight. With the evidence of frames added up, and 0.9, one of twelve flights followed the wrong
one (benchmarks/tracking.py, seeds from 1000)."""


@dataclass
class RivalPose:
    """One of them, and its log-odds against clutter in the last frame."""

    filter: MotionFilter
    log_odds: float = 0.0


@dataclass(frozen=True, eq=False)
class Decided:
    """What a frame said.

    Attributes
    ----------
    match : Match
        Of the most likely of the poses; ambiguous unless it is sure.
    left : list of RivalPose
        Those that the frame agrees with, the most likely first; none where it agrees with none.
    """

    match: Match
    left: list[RivalPose]

    @property
    def sure(self) -> bool:
        """Whether one of them is."""
        return self.match.status is Status.MATCHED


def rivals_of(match: Match, source: NDArray[np.float64], time: float, options: MotionOptions) -> list[RivalPose]:
    """The poses between which an ambiguous match does not decide.

    Parameters
    ----------
    match : Match
        Of a frame that was searched.
    source : (n, 3) array
        The body's points.
    time : float
        Of the frame, seconds.
    options : MotionOptions
        How fast the body may move.
    """
    least = match.problem.minimal + 1
    every = [match.assignment, *(other for other, _ in match.alternatives)]
    every = [one for one in every if (one >= 0).sum() >= least][:MOST]
    poses = [free_pose(replace(match, assignment=one)) for one in every]
    return [RivalPose(MotionFilter(source, pose, time, options)) for pose in poses]


def decided(rivals: Sequence[RivalPose], follow: Callable[[Pose], Match], time: float) -> Decided:
    """The rivals after another frame.

    Parameters
    ----------
    rivals : sequence of RivalPose
        At least one. Their filters take the frame.
    follow : callable
        The match of the frame with a predicted pose; untrusted where they do not agree.
    time : float
        Of the frame, seconds.
    """
    found = [(rival, follow(rival.filter.predicted(time))) for rival in rivals]
    held: dict[bytes, tuple[RivalPose, Match]] = {}
    for rival, match in found:
        if match.prior_holds is not True or match.status is Status.UNTRUSTED or match.fused_pose is None:
            continue
        rival.filter.update(match.fused_pose, time)
        rival.log_odds = match.score
        same = held.get(match.assignment.tobytes())
        if same is None or rival.log_odds > same[0].log_odds:
            held[match.assignment.tobytes()] = rival, match
    if not held:
        return Decided(found[0][1], [])
    ranked = sorted(held.values(), key=lambda one: -one[0].log_odds)
    best, match = ranked[0]
    share = 1.0 / sum(math.exp(max(rival.log_odds - best.log_odds, -700.0)) for rival, _ in ranked)
    probability = share * (match.fitted_probability or 0.0)
    match = replace(
        match,
        status=Status.MATCHED if probability >= SURE else Status.AMBIGUOUS,
        fitted_probability=probability,
        alternatives=[*((other.assignment, other.score) for _, other in ranked[1:]), *match.alternatives],
    )
    return Decided(match, [rival for rival, _ in ranked])
