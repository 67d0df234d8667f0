"""A hypothesis of a body's pose that is followed, and what becomes of it in a frame of images or of point sets."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.explain.point_set_decision import matches_pose
from rootmatch.frozen import copy_with
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.modes import Modes
from rootmatch.model.widened_prediction import FREEDOM
from rootmatch.tracking.mistaken_identity import FLOOR, GIVEN_UP, log_other_presence, update_identity
from rootmatch.tracking.motion_filter import MotionFilter, MotionOptions

TOLD = math.log(1e6)
"""Log-odds from which frames are not asked any more what they tell for themselves. A round value; it bounds time."""
SURE = 2.0 * FLOOR
"""Log-odds of something else from which what is followed is the body, as long as each match of point sets shows it.
Nothing else comes to be where points of space are predicted, to the noise, and a marker may be bent meanwhile. A round
value."""
NEAR = 0.25
"""Distance of a point's place from that of another, over that of the nearest points, up to which they are the same. A
round value: the predictions need not be as good as the poses."""


@dataclass(frozen=True, eq=False)
class FollowedPose:
    """A hypothesis: the pose and motion of the body, with the logarithm of its weight among the hypotheses.

    ``shown``: log-probability that just these of its visible points were seen in the last frame. It is no part of the
    weight, as the same points are hidden in the next frame, which tells it anew. ``log_other``: log-odds that it is the
    pose of something else. ``place``: number of the place that it has with all hypotheses about the same detections;
    ``alone``: mean log-odds of that place without a prediction; ``shows``: the frames that it is of, those in a row in
    which the place was trusted, or weighed among several; ``weighed``: `log_weight` by which it was weighed last.
    ``since``: when the place was found; ``log_absent``: log-odds that the body was not in view then. ``unfollowed``:
    probability, if the body is in that place, of poses that a frame left possible there and that are not followed.
    ``told``: log-odds of what it shows against clutter that persists, by ``frames``; see `log_odds_with`.
    """

    filter: MotionFilter
    log_weight: float = 0.0
    shown: float = 0.0
    log_other: float = FLOOR
    place: int = 0
    alone: float = -math.inf
    since: float = -math.inf
    log_absent: float = -math.inf
    unfollowed: float = 0.0
    weighed: float = -math.inf
    shows: int = 0
    told: float = -math.inf
    frames: int = 0

    @property
    def total(self) -> float:
        """Logarithm of its weight with the last frame."""
        return self.log_weight + self.shown

    def alone_with(self, told: float) -> float:
        """``alone`` after a frame that tells log-odds by itself, if none did before those."""
        return told if self.alone == -math.inf else self.alone + (told - self.alone) / (1 + self.shows)

    def log_odds_with(self, now: Callable[[], float]) -> float:
        """``told`` after a frame that tells log-odds by itself, which is asked only if that may matter.

        Clutter that persists shows the same in each frame, and which of them tells is unknown: the t-th since it was
        found does with 1 / t (t + 1). Over images of clutter the mean of these odds is 1, however frames repeat each
        other, and none makes less of what another one told.
        """
        if self.told > TOLD:
            return self.told
        return float(np.logaddexp(self.told, now() - math.log((self.frames + 1) * (self.frames + 2))))


class Step(NamedTuple):
    """A hypothesis after a frame, before its pose is known."""

    log_weight: float
    shown: float
    origin: int
    """The hypothesis that it goes on from; −1 for a new one."""
    mode: int | None
    """None for a hypothesis that stays as predicted."""
    chance: float
    """Probability that the mode is what became of the prediction."""
    place: int
    alone: float
    """See `FollowedPose`."""
    weighed: float = -math.inf
    """See `FollowedPose`."""
    more: float = 0.0
    """Part of ``log_weight``: by how much more the place shows than before."""

    @property
    def total(self) -> float:
        """See `FollowedPose.total`."""
        return self.log_weight + self.shown


def temper(evidence: Floats, origin: Integers, often: float) -> Floats:
    """Logarithms (M,) of evidence of modes that counts for less; what several of one hypothesis have, counts once.

    Otherwise a hypothesis that a frame splits into two gains by that. ``origin``: (M,) the
    hypothesis of each, −1 for a new one, which each is; ``often``: weight of a frame's evidence.
    """
    out = often * evidence
    if len(out) < 2:
        return out
    for one in np.unique(origin[origin >= 0]):
        own = origin == one
        if np.count_nonzero(own) > 1:
            whole, split = (np.logaddexp.reduce(part[own]) for part in (evidence, out))
            out[own] += often * whole - split
    return out


def pool_place_weights(poses: list[FollowedPose]) -> list[FollowedPose]:
    """Hypotheses of which those of a place weigh together what it has with the last frame.

    Which points a frame shows tells of the poses of a place, for that frame, and is no reason for the place itself.
    """
    if len({one.place for one in poses}) < 2:
        return poses
    out = []
    for one in poses:
        own = [other for other in poses if other.place == one.place]
        whole, weight = (
            np.logaddexp.reduce([getattr(other, name) for other in own]) for name in ("total", "log_weight")
        )
        out.append(copy_with(one, log_weight=one.log_weight + float(whole - weight)))
    return out


def share_misfit_odds(poses: Sequence[FollowedPose], left: tuple[int, float] | None) -> list[FollowedPose]:
    """Hypotheses of which those of a place share the odds that it is of something else.

    What is in a place, and does not fit the body in the most probable of its poses, is something else. Then so it is in
    the others, however well they fit: these were improbable beside the first one, and are not what is left without it.

    ``left``: place and logarithm of the weight of a pose that does not fit and is not followed at all.
    """
    out, misfits = list(poses), [] if left is None else [left]
    misfits += [(one.place, one.total) for one in poses if one.log_other >= GIVEN_UP]
    for place in {place for place, _ in misfits}:
        own = [k for k, one in enumerate(poses) if one.place == place and one.log_other < GIVEN_UP]
        if not own:
            continue
        odds = np.logaddexp.reduce([weight for where, weight in misfits if where == place])
        odds -= np.logaddexp.reduce([poses[k].total for k in own])
        for k in own:
            out[k] = copy_with(out[k], log_other=float(np.logaddexp(out[k].log_other, odds)))
    return out


def unify_alike_moves(
    poses: Sequence[FollowedPose], of: Sequence[int | None], model: DetectionModel, modes: Modes
) -> list[FollowedPose]:
    """Hypotheses of which those between which the body looks the same move as the first does; ``of``: their modes.

    Poses that have looked the same for some frames, a period of a lattice apart or half a turn, do so in the next one.
    They differ by how far the body's centre is moved, which tells nothing: it may be the camera that moves.
    """
    out = list(poses)
    for k, mode in enumerate(of[1:], 1):
        if mode is None or of[0] is None:
            continue
        if (motion := _motion_between_modes(model, modes, of[0], mode)) is not None:
            out[k] = copy_with(out[k], filter=out[0].filter.turned(*motion))
    return out


def _motion_between_modes(model: DetectionModel, modes: Modes, first: int, second: int) -> tuple[Floats, Floats] | None:
    """The motion (R, t), x' = R x + t, from one mode to another, if the body looks the same after it.

    None if the other mode has not all detections of the first one as those of the points that come to their places, or
    if these are the same points.
    """
    here, there = modes.assignments[first], modes.assignments[second]
    if (here == there).all() or (here >= 0).sum() != (there >= 0).sum():
        return None
    turn = modes.rotation[first].T @ modes.rotation[second]
    shift = modes.rotation[first].T @ (modes.position[second] - modes.position[first])
    if (_move_assignment(model, (turn, shift), here) != there).any():
        return None
    return turn, model.centre + shift - turn @ model.centre


def _move_assignment(model: DetectionModel, motion: tuple[Floats, Floats], assignment: Integers) -> Integers:
    """An assignment (n,) as one of the points that are at their places after a motion x' = R x + t about the centre."""
    images = max(len(model.images), 1)
    points = (model.points - model.centre)[: len(assignment) // images]
    rows = assignment.reshape(images, -1)
    (matched,) = np.nonzero((rows >= 0).any(axis=0))
    apart = ((points[matched, None] - points) ** 2).sum(axis=2)
    apart[np.arange(len(matched)), matched] = np.inf
    far = ((points[matched, None] - (points @ motion[0].T + motion[1])) ** 2).sum(axis=2)
    nearest = far.argmin(axis=1)
    same = far[np.arange(len(matched)), nearest] <= NEAR**2 * apart.min(axis=1)
    out = np.full(rows.shape, -1)
    out[:, nearest[same]] = rows[:, matched[same]]
    return out.reshape(-1)


class NarrowedPredictions:
    """The frames that narrow the wide predictions of a missing body, one of several.

    A wide prediction is narrowed by single matches, which takes as long as a search. So a frame does one or the other,
    and of several predictions it narrows one.
    """

    def __init__(self) -> None:
        self.last = self.count = 0

    def of_frame(self, frame: int, predictions: int, *, searching: bool) -> tuple[int, ...]:
        """The number of the prediction that a frame narrows; none in every other frame while a search is under way."""
        if searching and self.last == frame - 1:
            return ()
        self.last, self.count = frame, self.count + 1
        return (self.count % predictions,)


def update_motion(
    followed: list[FollowedPose],
    found: Finding,
    time: float,
    of_body: tuple[Floats, MotionOptions],
    given_up: MotionFilter | None,
    *,
    weight: float,
) -> list[FollowedPose]:
    """Hypotheses after a match of two point sets: only one that is trusted tells a pose.

    Whether what is followed is something else, each frame tells that shows it where it was expected.
    ``of_body``: points of the body, and how fast it may move, of a new hypothesis. ``given_up``: what was followed and
    did not fit. ``weight``: of a frame's evidence that it is something else.
    """
    matched, holds = found.status is Status.MATCHED, bool(found.prior_holds and found.pose is not None and followed)
    if holds and found.pose is not None:
        (best,) = [*(one for one in followed if one.filter.is_near(found.pose, time)), *followed][:1]
        if matched:
            best.filter.update(found.pose, time, tails=(FREEDOM, 1.0))
        return [copy_with(best, log_other=_log_other(best.log_other, found, weight))]
    is_another = not matched and found.another >= GIVEN_UP and (found.log_odds or 0.0) > 0.0
    pose = matches_pose(found) if matched or is_another else None
    new = None if pose is None else MotionFilter(of_body[0], pose, time, of_body[1])
    if not matched or pose is None or new is None:
        # what comes into view next may be something else
        still = [copy_with(one, log_other=max(one.log_other, FLOOR)) for one in followed[:1]]
        return still if new is None else [*still, FollowedPose(new, log_other=found.another)]
    log_other = FLOOR if given_up is None else log_other_presence(given_up, pose, time, None)
    return [FollowedPose(new, log_other=_log_other(log_other, found, weight))]


def _log_other(log_odds: float, found: Finding, weight: float) -> float:
    """Log-odds after a frame that it shows something else, of the body as it most probably is: with points off."""
    misfit = Misfit.of_finding(found)
    if log_odds <= SURE or misfit is None or not (found.log_odds or 0.0) > 0.0:
        return log_odds
    return update_identity(
        log_odds, misfit, weight, as_off=misfit.largest_error_gain(found.task.log_inexact), minimum=SURE
    )
