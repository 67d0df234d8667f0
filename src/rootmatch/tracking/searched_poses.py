"""Poses that a search adds to those followed, if none was confirmed or if one misses too many points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.decide import TRUST, Facts, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.near_symmetries import body_radius
from rootmatch.explain.predicted_assignment import DEFAULT_PRIOR, match_with_prior
from rootmatch.explain.predicted_likelihood import PriorFit, PriorFrame
from rootmatch.explain.predicted_pose import free_fits, pose_of
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.tracking.motion_filter import MotionFilter
from rootmatch.tracking.rival_poses import MOST, NEGLIGIBLE, SURE, TEMPER, Decided, RivalPose, Shape, shares_of

TURNED, LOOSE = 2, 0.03
"""Number of poses of a searched frame whose rotated copies are tried, and how far these may be off, in radians and
radii. Round values."""
DRIFTED, DRIFT = 10.0, math.log(100.0)
"""How much less sure than it claims a prediction may be that was not confirmed, and the log-odds against that: a pose
that three or four points showed may have drifted. Round values."""


def searched(
    match: Finding,
    before: Sequence[RivalPose],
    shape: Shape,
    time: float,
    found: NDArray[np.int64] | None = None,
) -> Decided:
    """The poses that a searched frame leaves, together with those followed until then.

    Each assignment continues each prediction that it does not contradict; without one, it has to be the more likely by
    itself.

    Parameters
    ----------
    match : Finding
        Of the frame, searched without a prediction, and not untrusted.
    before : sequence of RivalPose
        Poses that were followed, none of which the frame confirmed. They are not changed.
    shape : Shape
    time : float
        Of the frame, seconds.
    found : (n,) array, optional
        Assignment that a prediction found but did not accept.
    """
    least = match.task.problem.minimal + 1
    every = [*match.every, *([] if found is None else [found])]
    scores = {one.tobytes(): score for one, score in zip(match.every, match.every_score, strict=True)}
    distinct = {one.tobytes(): one for one in every if (one >= 0).sum() >= least}
    fits = free_fits(match.task, list(distinct.values())[:MOST])
    fits += _turned(match, fits[:TURNED], shape, set(distinct))
    floor = min((rival.evidence for rival in before), default=0.0)
    before = [rival for rival in before if not rival.tentative]
    frames = [
        (rival, PriorFrame(match.task, _widened(rival.filter.predicted(time), wider)), cost)
        for rival in before
        for wider, cost in ((1.0, 0.0), (DRIFTED, DRIFT))
    ]
    known: list[tuple[RivalPose, PriorFit, bool]] = []
    for free in fits:
        for rival, frame, cost in frames:
            fit = frame.fitted(free.assignment, free.R, free.t)
            if fit.chi2_prior < DEFAULT_PRIOR.contradicted:
                one = RivalPose(rival.filter.copy(), rival.evidence, rival.visibility)
                if cost:
                    one.filter = MotionFilter(shape.source, pose_of(free), time, shape.motion)
                else:
                    one.filter.update(pose_of(fit), time)
                one.take(fit.log_odds - fit.visibility - cost, fit.visibility)
                known.append((one, fit, True))
        one = RivalPose(MotionFilter(shape.source, pose_of(free), time, shape.motion), floor)
        one.take(free.log_odds - free.visibility, free.visibility)
        known.append((one, free, False))
    if not known:
        return Decided(match, list(before), None, False)
    known.sort(key=lambda one: -one[0].total)
    first: dict[bytes, tuple[RivalPose, PriorFit, bool]] = {}
    for entry in known:
        first.setdefault(entry[1].assignment.tobytes(), entry)
    ranked = [one for one in first.values() if one[0].total > known[0][0].total - NEGLIGIBLE][:MOST]
    shares = shares_of([rival for rival, _, _ in ranked])
    _, fit, held = ranked[0]
    listed = fit.assignment.tobytes() in scores
    same = match.status is Status.MATCHED and np.array_equal(fit.assignment, match.assignment)
    sure = listed and shares[0] >= (TRUST.probability if same else SURE)
    facts = match.facts
    if not (same and sure):
        facts = Facts(lead=match.facts.lead, probability=float(shares[0]), contested=not sure)
    # the hyper-edges of an assignment that only poses propose were not evaluated
    score = scores.pop(fit.assignment.tobytes(), math.nan)
    others = dict.fromkeys((one[1].assignment.tobytes() for one in ranked[1:]), math.nan) | scores
    match = replace(
        match,
        assignment=fit.assignment,
        others=[np.frombuffer(one, np.int64) for one in others],
        facts=facts,
        scores=[score, *others.values()],
        labels=None,
        log_odds=fit.log_odds,
        prior_holds=held if before else None,
        fused_pose=pose_of(fit) if held else None,
    )
    return Decided(match, [rival for rival, _, _ in ranked], None, bool(shares[0] >= SURE))


def _widened(pose: Pose, factor: float) -> Pose:
    assert pose.covariance is not None
    return Pose.unchecked(pose.R, pose.t, factor**2 * pose.covariance)


def _turned(match: Finding, fits: Sequence[PriorFit], shape: Shape, known: set[bytes]) -> list[PriorFit]:
    """Fits of what each pose explains after a near symmetry of the body, except those already known."""
    loose = np.diag(np.repeat([LOOSE, LOOSE * body_radius(shape.source)], 3) ** 2)
    new: dict[bytes, NDArray[np.int64]] = {}
    for fit in fits:
        for R, t in shape.symmetries:
            pose = Pose(fit.R @ R, fit.R @ t + fit.t, fit.covariance + loose)
            found = match_with_prior(match.task, pose)
            if found is not None and found.matched > match.task.problem.minimal:
                key = found.assignment.tobytes()
                if key not in known:
                    new[key] = found.assignment
    return free_fits(match.task, list(new.values()))


def challengers(match: Finding, current: Finding, rival: RivalPose, shape: Shape, time: float) -> list[RivalPose]:
    """Other poses that a search found in a frame where the followed pose misses many visible points.

    Both are judged by this frame alone and share the evidence of the previous ones.

    Parameters
    ----------
    match : Finding
        Of the frame, searched without a prediction, and not untrusted.
    current : Finding
        Of the frame and the pose that is followed.
    rival : RivalPose
        That pose.
    shape : Shape
    time : float
        Of the frame, seconds.
    """
    least = match.task.problem.minimal + 1
    every = match.every
    kept = current.assignment >= 0
    every = [
        one for one in every if (one >= 0).sum() >= least and 2 * (one == current.assignment)[kept].sum() < kept.sum()
    ]
    fits = free_fits(match.task, [current.assignment, *every[: MOST - 1]])
    if not fits or fits[0].assignment is not current.assignment:
        return []  # a few matches in each camera of a rig do not determine a pose
    own, *fits = fits
    fits += _turned(match, fits[:TURNED], shape, {one.tobytes() for one in [current.assignment, *every]})
    found = []
    for fit in fits:
        lead = fit.log_odds - fit.visibility - own.log_odds + own.visibility
        one = RivalPose(
            MotionFilter(shape.source, pose_of(fit), time, shape.motion), rival.evidence + TEMPER * lead, fit.visibility
        )
        if one.total > rival.total - NEGLIGIBLE:
            found.append(one)
    return found
