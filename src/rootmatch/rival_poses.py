"""Poses between which the frames so far do not decide, each followed through the next ones until one is left.

Two halves of a headset that are copies of one another, but for fractions of a millimetre, look the same from one side.
The pose and its twin then agree in frame after frame, and each adds a little to the odds: its noise is independent of
that of the others, so the logarithms of the likelihoods are summed up (a tracker of several hypotheses, Reid 1979).
Until they decide no frame needs a search. Which of the visible points are missing is no such evidence, as the same
points are missing in the next frame: of that a mean over some frames counts once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.pipeline.motion_filter import MotionFilter, MotionOptions
from rootmatch.pipeline.prior import DEFAULT_PRIOR, Found
from rootmatch.pipeline.prior_frame import PriorFit, PriorFrame
from rootmatch.pipeline.status import TRUST, Status
from rootmatch.predicted import free_fits, pose_of
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.result import Match

MOST = 4
"""Poses that are followed at once, a millisecond each in every frame. A round value."""
SURE = 0.99
"""Probability from which one of them is reported as the pose. A round value."""
NEGLIGIBLE = math.log(1e4)
"""Log-odds against the best at which one is given up: what is decided here stands for the rest of a flight."""
TEMPER = 0.5
"""Weight of a frame's evidence: source points that are off by part of what tells two poses apart, or a σ that is stated
too small, are wrong in the same way in every frame. It delays decisions; it changes none of which pose is ahead."""
RECENT = 0.2
"""Weight of a frame in the mean of which points are visible. A round value."""
LIKELY = 0.5
"""Probability of an assignment about a prediction from which its pose is taken: more likely than all others."""
TENTATIVE = 4
"""Matches from which what is found, but not believed, is followed beside the prediction. One more than give a pose."""


@dataclass
class RivalPose:
    """One of them.

    Attributes
    ----------
    filter : MotionFilter
    evidence : float
        Log-odds against clutter, tempered, summed over the frames.
    visibility : float or None
        Recent mean of the log-probability of which visible points are matched.
    """

    filter: MotionFilter
    evidence: float = 0.0
    visibility: float | None = None

    @property
    def total(self) -> float:
        """Logarithm of its weight among the others."""
        return self.evidence + (self.visibility or 0.0)

    def take(self, evidence: float, visibility: float) -> None:
        """Add what a frame says."""
        self.evidence += TEMPER * evidence
        before = visibility if self.visibility is None else self.visibility
        self.visibility = (1.0 - RECENT) * before + RECENT * visibility


@dataclass(frozen=True, eq=False)
class Decided:
    """What a frame said.

    Attributes
    ----------
    match : Match
        Of the most likely of the poses; ambiguous unless it is sure.
    left : list of RivalPose
        Those that are still followed, the most likely first.
    found : Found or None
        What the most likely one found, where that is believed.
    probability : float
        Of the most likely one.
    """

    match: Match
    left: list[RivalPose]
    found: Found | None
    probability: float

    @property
    def sure(self) -> bool:
        """Whether there is hardly a doubt which of them it is."""
        return self.probability >= SURE


def decided(rivals: Sequence[RivalPose], follow: Callable[[Pose], tuple[Match, Found | None]], time: float) -> Decided:
    """The rivals after another frame.

    Parameters
    ----------
    rivals : sequence of RivalPose
        At least one. Their filters take the frame.
    follow : callable
        The match of the frame with a predicted pose, and what was found.
    time : float
        Of the frame, seconds.
    """
    every: list[tuple[RivalPose, Match, Found | None]] = []
    for rival in rivals:
        match, found = follow(rival.filter.predicted(time))
        if found is not None and found.believed:
            rival.take(max(found.log_odds - found.visibility, 0.0), found.visibility)
            if found.probability >= LIKELY:
                rival.filter.update(found.pose, time)
        elif found is not None and _tentative(found):
            other = RivalPose(rival.filter.copy(), rival.evidence, rival.visibility)
            other.filter.update(found.pose, time)
            other.take(found.beyond_chance, found.visibility)
            every.append((other, match, found))
        every.append((rival, match, found))
    every.sort(key=lambda one: -one[0].total)
    distinct: dict[bytes, tuple[RivalPose, Match, Found | None]] = {}
    for one in every:
        same = one[2] is not None and one[2].believed
        distinct.setdefault(one[1].assignment.tobytes() if same else id(one[0]).to_bytes(8, "little"), one)
    ranked = list(distinct.values())[:MOST]
    ranked = [one for one in ranked if one[0].total > ranked[0][0].total - NEGLIGIBLE]
    shares = _shares([rival for rival, _, _ in ranked])
    _, match, found = ranked[0]
    if found is not None and match.status is not Status.UNTRUSTED:
        sure = shares[0] >= SURE and found.probability >= TRUST.probability
        match = replace(
            match,
            status=Status.MATCHED if sure else Status.AMBIGUOUS,
            fitted_probability=float(shares[0]) * found.probability,
            alternatives=[
                *((other.assignment, other.score) for _, other, what in ranked[1:] if what is not None),
                *match.alternatives,
            ],
        )
    believed = found if found is not None and found.believed else None
    return Decided(match, [rival for rival, _, _ in ranked], believed, float(shares[0]))


def _tentative(found: Found) -> bool:
    return (
        found.matched >= TENTATIVE
        and found.probability >= LIKELY
        and found.log_odds > found.visibility
        and found.chi2_prior < DEFAULT_PRIOR.contradicted
    )


def _shares(rivals: Sequence[RivalPose]) -> NDArray[np.float64]:
    total = np.array([rival.total for rival in rivals])
    weight = np.exp(total - total.max())
    return np.asarray(weight / weight.sum())


def searched(
    match: Match, before: Sequence[RivalPose], source: NDArray[np.float64], time: float, options: MotionOptions
) -> Decided:
    """The poses that a searched frame leaves, together with those followed until then.

    Each assignment goes on from each prediction that it does not contradict; without one, it has to be the more likely
    for itself.

    Parameters
    ----------
    match : Match
        Of the frame, searched without a prediction, and not untrusted.
    before : sequence of RivalPose
        Those that were followed, none of which the frame confirmed. They are left as they are.
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
    floor = min((rival.evidence for rival in before), default=0.0)
    frames = [PriorFrame(match.task, rival.filter.predicted(time)) for rival in before]
    known: list[tuple[RivalPose, PriorFit, bool]] = []
    for free in free_fits(match.task, every):
        for rival, frame in zip(before, frames, strict=True):
            fit = frame.fitted(free.assignment, free.R, free.t)
            if fit.chi2_prior < DEFAULT_PRIOR.contradicted:
                one = RivalPose(rival.filter.copy(), rival.evidence, rival.visibility)
                one.filter.update(pose_of(fit), time)
                one.take(fit.log_odds - fit.visibility, fit.visibility)
                known.append((one, fit, True))
        one = RivalPose(MotionFilter(source, pose_of(free), time, options), floor)
        one.take(free.log_odds - free.visibility, free.visibility)
        known.append((one, free, False))
    if not known:
        return Decided(match, list(before), None, 0.0)
    known.sort(key=lambda one: -one[0].total)
    distinct: dict[bytes, tuple[RivalPose, PriorFit, bool]] = {}
    for entry in known:
        distinct.setdefault(entry[1].assignment.tobytes(), entry)
    ranked = [one for one in distinct.values() if one[0].total > known[0][0].total - NEGLIGIBLE]
    if match.status is Status.MATCHED:
        ranked = [one for one in ranked if np.array_equal(one[1].assignment, match.assignment)][:1] or ranked[:1]
    shares = _shares([rival for rival, _, _ in ranked])
    _, fit, held = ranked[0]
    if match.status is not Status.MATCHED:
        scores = {one.tobytes(): score for one, score in [(match.assignment, match.score), *match.alternatives]}
        match = replace(
            match,
            assignment=fit.assignment,
            score=scores.pop(fit.assignment.tobytes()),
            alternatives=[(np.frombuffer(one, np.int64), score) for one, score in scores.items()],
            motions=np.where(fit.assignment >= 0, 0, -1),
            fitted_probability=float(shares[0]),
            status=Status.MATCHED if shares[0] >= SURE else Status.AMBIGUOUS,
        )
    match = replace(match, prior_holds=held if before else None, fused_pose=pose_of(fit) if held else None)
    return Decided(match, [rival for rival, _, _ in ranked], None, float(shares[0]))


def challengers(
    match: Match, current: Match, rival: RivalPose, source: NDArray[np.float64], time: float, options: MotionOptions
) -> list[RivalPose]:
    """Other poses that a search found in a frame where the one that is followed misses much of what should be visible.

    Both are judged by this frame alone, and share the evidence of those before.

    Parameters
    ----------
    match : Match
        Of the frame, searched without a prediction, and not untrusted.
    current : Match
        Of the frame and the pose that is followed.
    rival : RivalPose
        That pose.
    source : (n, 3) array
        The body's points.
    time : float
        Of the frame, seconds.
    options : MotionOptions
        How fast the body may move.
    """
    least = match.problem.minimal + 1
    every = [match.assignment, *(other for other, _ in match.alternatives)]
    kept = current.assignment >= 0
    every = [
        one for one in every if (one >= 0).sum() >= least and 2 * (one == current.assignment)[kept].sum() < kept.sum()
    ]
    own, *fits = free_fits(match.task, [current.assignment, *every[: MOST - 1]])
    found = []
    for fit in fits:
        lead = fit.log_odds - fit.visibility - own.log_odds + own.visibility
        one = RivalPose(
            MotionFilter(source, pose_of(fit), time, options), rival.evidence + TEMPER * lead, fit.visibility
        )
        if one.total > rival.total - NEGLIGIBLE:
            found.append(one)
    return found
