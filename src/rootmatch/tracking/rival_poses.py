"""Rival poses that the frames so far do not tell apart, each followed through the next frames until one is left.

If the two halves of a headset are copies of each other to within fractions of a millimetre, one side looks like the
other. The pose and its near-symmetric pose then agree in frame after frame, and each frame adds a little to the odds:
the noise of frames is independent, so log-likelihoods are summed (multiple hypothesis tracking, Reid 1979). Until they
decide, no frame needs a search. Missing points are not independent evidence, because the same points are missing in the
next frame: their mean over some frames counts once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.predicted_assignment import DEFAULT_PRIOR, Found
from rootmatch.explain.predicted_likelihood import PriorFit
from rootmatch.explain.predicted_pose import match_of, pose_of
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.tracking.motion_filter import MotionFilter, MotionOptions
from rootmatch.tracking.pose_flip import flipped_pose

MOST = 4
"""Largest number of poses followed at once, each for a millisecond per frame. A round value."""
SURE = 0.99
"""Probability from which one of several poses that are rotated copies is reported as the pose. A round value."""
NEGLIGIBLE = math.log(1e4)
"""Log-odds against the best pose at which a rival is given up: the decision holds for the rest of a flight."""
TEMPER = 0.5
"""Weight of a frame's evidence: errors of the source points, or a σ that is stated too small, act in the same way in
every frame. The weight delays decisions; it does not change which pose leads."""
RECENT = 0.2
"""Weight of a frame in the running mean of the points' visibility. A round value."""
LIKELY = 0.5
"""Probability of an assignment about a prediction from which its pose is taken: more likely than all others."""
NEAR = 1.0 + 2.0 * math.cos(0.5)
"""Trace of the rotation between two poses above which they are the same one, not a turned copy. A round value."""
TENTATIVE = 4
"""Number of matches from which an assignment that is not accepted is followed beside the prediction. One more than a
pose needs."""


@dataclass
class RivalPose:
    """One of the poses between which the frames so far do not decide.

    Attributes
    ----------
    filter : MotionFilter
    evidence : float
        Log-odds against clutter, tempered, summed over the frames.
    visibility : float or None
        Recent mean of the log-probability of which visible points are matched.
    tentative : bool
        Whether it continues from an assignment of the last frame that its prediction found but did not accept.
    presumed : (Pose, float) or None
        Pose from too few detections of this frame to be accepted, and the probability that they are the body's.
    """

    filter: MotionFilter
    evidence: float = 0.0
    visibility: float | None = None
    tentative: bool = False
    presumed: tuple[Pose, float] | None = None

    @property
    def total(self) -> float:
        """Logarithm of its weight among the others."""
        return self.evidence + (self.visibility or 0.0)

    def take(self, evidence: float, visibility: float) -> None:
        """Add the evidence of a frame."""
        self.evidence += TEMPER * evidence
        before = visibility if self.visibility is None else self.visibility
        self.visibility = (1.0 - RECENT) * before + RECENT * visibility

    def presume(self, time: float) -> None:
        """Take in the result of too few detections of a frame, weighted by its probability."""
        if self.presumed is not None:
            pose, probability = self.presumed
            self.filter.update(pose, time, probability)
            self.presumed = None


@dataclass(frozen=True, eq=False)
class Decided:
    """The outcome of a frame.

    Attributes
    ----------
    match : Finding
        Of the most likely of the poses; ambiguous unless it is sure.
    left : list of RivalPose
        Those that are still followed, the most likely first.
    found : Found or None
        Result of the most likely pose, if it is accepted.
    sure : bool
        Whether there is hardly any doubt about which pose it is.
    """

    match: Finding
    left: list[RivalPose]
    found: Found | None
    sure: bool


@dataclass(frozen=True, eq=False)
class Shape:
    """Prior knowledge of a body.

    Attributes
    ----------
    source : (n, 3) float64
        Its points.
    symmetries : list of (R, t)
        Motions after which it looks the same from some side; see `rootmatch.explain.near_symmetries`.
    motion : MotionOptions
        How fast it may move.
    """

    source: NDArray[np.float64]
    symmetries: list[tuple[NDArray[np.float64], NDArray[np.float64]]]
    motion: MotionOptions


def decided(
    rivals: Sequence[RivalPose],
    follow: Callable[[Pose], tuple[Finding, Found | None]],
    time: float,
    shape: Shape | None = None,
) -> Decided:
    """The rivals after another frame.

    Parameters
    ----------
    rivals : sequence of RivalPose
        At least one. Their filters take the frame.
    follow : callable
        The match of the frame with a predicted pose, and what was found.
    time : float
        Of the frame, seconds.
    shape : Shape, optional
        The best pose is then also tried after the body's near symmetries, unless there is another rival: neither the
        search nor the frames since need have found both.
    """
    only = all(rival.tentative for rival in rivals)
    before = [replace(rival, filter=rival.filter.copy()) for rival in rivals] if shape is not None else []
    tried = [follow(rival.filter.predicted(time)) for rival in rivals]
    there = any(what is not None and what.believed for _, what in tried)
    every: list[tuple[RivalPose, Finding, Found | None]] = []
    for rival, (match, what) in zip(rivals, tried, strict=True):
        every += _taken(rival, match, what, there=there, kept=only or not rival.tentative, time=time)
    every.sort(key=lambda one: -one[0].total)
    best = next((k for k, rival in enumerate(rivals) if rival is every[0][0]), None)
    if there and shape is not None and best is not None:
        for R, t in shape.symmetries:
            turned = before[best].filter.turned(R, t)
            pose = turned.predicted(time)
            poses = [what.pose for _, _, what in every if what is not None and what.believed]
            if not any(_alike(pose.R, one.R) for one in poses):
                # what was known of it stays known
                near = next((one for one in before if _alike(turned.R, one.filter.R)), before[best])
                rival = RivalPose(turned, near.evidence, near.visibility)
                every += _taken(rival, *follow(pose), there=True, kept=False, time=time)
    every.sort(key=lambda one: -one[0].total)
    distinct: dict[bytes, tuple[RivalPose, Finding, Found | None]] = {}
    for one in every:
        same = one[2] is not None and one[2].believed
        distinct.setdefault(one[1].assignment.tobytes() if same else id(one[0]).to_bytes(8, "little"), one)
    ranked = list(distinct.values())[:MOST]
    # a tentative rival does not displace others
    firm = max((one[0].total for one in ranked if not one[0].tentative), default=-math.inf)
    ranked = [one for one in ranked if one[0].tentative or one[0].total > firm - NEGLIGIBLE]
    shares = shares_of([rival for rival, _, _ in ranked])
    rival, match, found = ranked[0]
    apart = any(not _alike(rival.filter.R, one.filter.R) for one, _, _ in ranked[1:])
    decides = bool(shares[0] >= (SURE if apart else TRUST.probability))
    if found is not None and match.status is not Status.UNTRUSTED:
        probability = float(shares[0]) * found.probability
        of_others = [other for _, other, what in ranked[1:] if what is not None]
        match = replace(
            match.with_facts(probability=probability, contested=not decides),
            others=[*(other.assignment for other in of_others), *match.others],
            scores=[match.every_score[0], *(other.every_score[0] for other in of_others), *match.every_score[1:]],
        )
    believed = found if found is not None and found.believed else None
    return Decided(match, [rival for rival, _, _ in ranked], believed, decides)


def _taken(
    rival: RivalPose, match: Finding, found: Found | None, *, there: bool, kept: bool, time: float
) -> list[tuple[RivalPose, Finding, Found | None]]:
    """A rival after a frame; if its result is not accepted, also a tentative rival with that result.

    ``there``: whether one of the rivals is accepted, so that the body is in view and only its pose is in question.
    ``kept``: whether it is still followed if nothing is found.
    """
    if found is not None and there and not found.believed and _worth_following(found):
        found = replace(found, believed=True)
        match = match.with_facts(confirmed=True, contested=True)
        match = replace(match, prior_holds=True, fused_pose=found.pose, reason=None)
    if found is not None and found.believed:
        rival.tentative = False
        taken = []
        if found.runner_up is not None:
            found, second = _apart(found, found.runner_up)
            branch = replace(rival, filter=rival.filter.copy())
            branch.take(max(second.log_odds - second.visibility, 0.0), second.visibility)
            branch.filter.update(second.pose, time)
            taken.append((branch, match_of(match.task, second), second))
        rival.take(max(found.log_odds - found.visibility, 0.0), found.visibility)
        if found.probability >= LIKELY:
            rival.filter.update(found.pose, time, found.probability)
            flipped = flipped_pose(match.task, found.assignment, found.pose)
            if flipped is not None:
                rival.filter.widen(*flipped)
        return [(rival, match, found), *taken]
    if not kept:
        return []
    rival.presumed = None
    if found is None:
        return [(rival, match, None)]
    if not _worth_following(found):
        probability = found.probability / (1.0 + math.exp(-found.beyond_chance))
        if probability >= LIKELY and found.chi2_prior < DEFAULT_PRIOR.contradicted:
            rival.presumed = found.pose, probability
        return [(rival, match, found)]
    other = RivalPose(rival.filter.copy(), rival.evidence, rival.visibility, tentative=True)
    other.filter.update(found.pose, time)
    other.take(found.log_odds - found.visibility, found.visibility)
    return [(other, match, found), (rival, match, None)]


def _apart(found: Found, second: PriorFit) -> tuple[Found, Found]:
    """The result and its runner-up, each with the probability that it would have without the other."""
    odds = math.exp(max(second.log_odds - found.log_odds, -700.0))
    rest = max(1.0 / found.probability - 1.0 - odds, 0.0)
    other = replace(
        found,
        assignment=second.assignment,
        pose=pose_of(second),
        log_odds=second.log_odds,
        probability=1.0 / (1.0 + rest / max(odds, 1e-300)) if rest > 0.0 else 1.0,
        chi2_prior=second.chi2_prior,
        visibility=second.visibility,
        expected=second.expected,
        alternatives=[],
        runner_up=None,
    )
    return replace(found, probability=1.0 / (1.0 + rest), runner_up=None), other


def _alike(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    """Whether two rotations belong to one pose, not to rotated copies."""
    return float((first * second).sum()) >= NEAR


def _worth_following(found: Found) -> bool:
    return (
        found.matched >= TENTATIVE
        and found.probability >= LIKELY
        and found.log_odds > found.visibility
        and found.chi2_prior < DEFAULT_PRIOR.contradicted
    )


def shares_of(rivals: Sequence[RivalPose]) -> NDArray[np.float64]:
    """Probability of each of them, which add up to one."""
    total = np.array([rival.total for rival in rivals])
    weight = np.exp(total - total.max())
    return np.asarray(weight / weight.sum())
