"""The search for the modes of a posterior: proposed poses are fitted, grown by their best changes, and summed.

A mode is a pose with its best assignment and the changes of it that leave the pose as it is: a point left out, added,
or moved to another detection, or two points with exchanged detections. Changes of different points are taken to be
independent, so a mode's mass is its evidence times a product, and the probability of a point's match is a share of that
mass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from operator import attrgetter

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import active_deadline, checkpoint
from rootmatch.frozen import once
from rootmatch.hypergraph.assignment import are_targets_disjoint
from rootmatch.model.blobs import assign_blobs
from rootmatch.model.compiled.mode_changes import IMPOSSIBLE, likely_mode_changes, sum_over_changes
from rootmatch.model.compiled.same_pose import ALIKE, is_same_pose
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import (
    Evidence,
    kernel_mixture,
    settle_evidence,
    settle_likely,
    settle_poses,
    step_poses,
    weigh_assignments,
)
from rootmatch.model.linearised import Linearised
from rootmatch.model.modes import Modes, empty_changes, empty_modes, object_array
from rootmatch.model.pose_density import MINIMUM
from rootmatch.model.priors import COPY, COUNTS
from rootmatch.model.proposals import Proposals

NO_STEP = np.zeros(6)
SECONDS_PER_DENSITY = 3e-10
"""To weigh and settle a proposal, for each detection and centre of a crowd (benchmarks/deadlines.py, task 785)."""
ROUNDS = 6
"""Largest number of changes by which a mode grows. A round value."""
WEIGHED = 32
"""Number of changes of a mode that are weighed with the pose they lead to; the others count to first order. A round
value."""
INDEPENDENT = 9
"""Number of matches from which changes of different points hardly move the pose and are therefore independent; with
fewer, only single changes are summed. A round value: two minimal sets more than one."""
NEGLIGIBLE = 9.0
"""Log-odds against a change or a mode at which it is left out: e⁻⁹ is a tenth of `WRONG_MODEL`."""
HOPELESS = 30.0
"""Log-odds against a proposal at which it is not fitted, to first order about its given pose, and at which what a
prediction or another body's pose proposes does not grow, against clutter alone: of 181 such modes two grew to be more
probable than clutter, by .2 (benchmarks/flights.py, rooms and rigs, 3 flights each from 1100). A round value."""
SAME_POSE = 2.0
"""Difference in standard deviations up to which two poses count as one. With 5, the two poses of a board that faces the
camera were one, and a tracker kept to the wrong one; 1 finds the same as 2.5 (benchmarks/flights.py, board)."""


def find_modes(
    model: DetectionModel,
    proposals: Proposals,
    known: Modes | None = None,
    *,
    of_several: bool = False,
    minimum: float = -math.inf,
    twins: bool = False,
) -> Modes:
    """The distinct poses among some proposals, grown, with the sums over their changes.

    Parameters
    ----------
    model : DetectionModel
    proposals : Proposals
    known : Modes, optional
        Modes found before, which are among the result.
    of_several : bool
        Whether other bodies may take the detections of better modes: whatever is better than clutter is kept then.
    minimum : float
        Log-odds against clutter alone from which a proposal grows; −∞ for assignments that may be right in part only,
        as a solver's.
    twins : bool
        Whether the proposals are twins of known modes: one that lacks a part of what it shows seems far behind, and
        grows as well.
    """
    told = (proposals.assignments >= 0).sum(axis=1) >= model.prior.minimum
    proposals = proposals if np.count_nonzero(told) == len(told) else proposals.take(told)
    if not (wanted := len(proposals.assignments)):
        return empty_modes(model.shape[0]) if known is None else known
    kept = before = [] if known is None else _Mode.every(known)
    enough = 0.0 if of_several else math.inf
    """Log-odds from which a mode counts, however much better others are."""
    of_copy = min(enough, -math.log(COPY) - COUNTS)
    """The same of one with other detections than the best."""
    far, near = (HOPELESS, HOPELESS) if twins else (2.0 * NEGLIGIBLE, NEGLIGIBLE)
    """How far behind the best mode another one does not count, and does not grow."""
    floor = max((mode.log_mass for mode in kept), default=-math.inf) - 2.0 * NEGLIGIBLE
    checkpoint()
    each = SECONDS_PER_DENSITY * model.shape[1] * len(model.clutter.centres)
    if (count := active_deadline().cut(wanted, each)) < wanted:
        proposals = proposals.take(slice(count))
    assignments, found, at, poses = _settle_possible(model, proposals, floor, of_copy)
    order = (-found.log_odds).argsort(kind="stable")
    for k in order[np.isfinite(found.log_odds[order])].tolist():
        log_odds = float(found.log_odds[k])
        behind = bool(kept) and log_odds < min(kept[0].log_mass - far, enough)
        if kept and ((behind and log_odds < of_copy) or active_deadline().passed()):
            break
        rivals = kept
        if behind:  # of the best, but maybe not of the best one of a copy
            there = np.array([other.assignment for other in kept])
            rivals = [kept[i] for i in np.flatnonzero(~are_targets_disjoint(there, assignments[k]))]
            if rivals and (rivals[0] is kept[0] or log_odds < rivals[0].log_mass - far):
                continue
        mode = _Mode.of(assignments[k], found, poses, k)
        grows = max(min(rivals[0].log_mass - near, enough), minimum) if rivals else minimum
        if mode.log_odds > grows and not _is_known(mode, kept):
            mode = _grow(model, mode, at.one(k))
        kept = _add_mode(kept, mode)
    return known if known is not None and kept is before else _stack_modes(kept, model.shape[0])


def _add_mode(kept: list[_Mode], mode: _Mode) -> list[_Mode]:
    """Modes with another one, unless it is one of them."""
    return kept if _is_known(mode, kept) else _insert_mode(kept, mode)


def _insert_mode(kept: list[_Mode], mode: _Mode) -> list[_Mode]:
    """Modes with another one that is none of them, but without those that are part of it."""
    parts = [other for other in _similarly_turned(mode, kept) if _is_part(other, mode)]
    kept = [other for other in kept if other not in parts]
    return sorted([*kept, mode], key=lambda one: -one.log_mass)


def pool_modes(several: list[Modes]) -> Modes:
    """The distinct modes of several bodies that are weighed alike: what one may be, each may be."""
    if len(several) == 1:
        return several[0]
    kept = list[_Mode]()
    for mode in sorted((one for modes in several for one in _Mode.every(modes)), key=lambda one: -one.log_mass):
        kept = _add_mode(kept, mode)
    return _stack_modes(kept, several[0].assignments.shape[1])


def grow_mode(model: DetectionModel, modes: Modes, which: int) -> Modes:
    """Modes of which one is grown that seemed too far behind the best: other bodies may have taken its detections."""
    kept = _Mode.every(modes)
    mode = kept.pop(which)
    at = model.linearise_about(mode.rotation[None], mode.position[None])
    return _stack_modes(_add_mode(kept, _grow(model, mode, at)), model.shape[0])


def _is_known(mode: _Mode, kept: list[_Mode]) -> bool:
    """Whether a mode is part of one that is no worse; a worse one, known from a search among less, gives way to it."""
    no_worse = [other for other in kept if mode.log_odds <= other.log_mass]
    return any(_is_part(mode, other) for other in _similarly_turned(mode, no_worse))


def _settle_possible(
    model: DetectionModel, proposals: Proposals, floor: float, enough: float
) -> tuple[Integers, Evidence, Linearised, tuple[Floats, Floats]]:
    """The proposals that may be worth a fit, to first order about their given poses, fitted, with their best poses.

    Compiled: log-odds of −∞ for the others, and for what ends where another one does.
    """
    assignments, *poses = proposals
    if (prior := kernel_mixture(model)) is not None:
        hopeless = HOPELESS, floor, enough
        return assignments, *settle_likely(model, assignments, (poses[0], poses[1]), prior, hopeless)
    at = model.linearise_about(*poses)
    assignments = assignments if at.blob is None else assign_blobs(assignments, at.blob)
    rough = weigh_assignments(model, assignments, at)
    best = max(float(rough.log_odds.max(initial=-math.inf)), floor)
    worth = rough.log_odds > min(best - HOPELESS, enough)
    if not worth.all():
        (some,) = np.nonzero(worth)
        assignments, rough, at = assignments[some], rough.take(some), at.take(some)
    found, at = settle_evidence(model, assignments, rough, at)
    return assignments, found, at, step_poses(found, at)


@dataclass(eq=False)
class _Mode:
    """One of `Modes`, its fields in their order."""

    assignment: Integers
    rotation: Floats
    position: Floats
    covariance: Floats
    log_odds: float
    log_mass: float
    local: Floats
    freedom: float
    visible: Floats
    detected: float
    unmatched: Floats
    summed: bool
    near: tuple[Integers, Floats, Floats]
    """Changed assignments that were weighed, with their log-odds, and steps (C, 6) to the poses that they lead to."""

    @classmethod
    def every(cls, modes: Modes) -> list[_Mode]:
        """The modes that arrays hold."""
        return [cls(*row) for row in zip(*modes, strict=True)]

    @property
    def pose(self) -> tuple[Floats, Floats, Floats]:
        """Rotation, position and covariance."""
        return self.rotation, self.position, self.covariance

    @once
    def changes(self) -> dict[bytes, tuple[float, Floats]]:
        """Log-odds of the changed assignments that were weighed, and steps to their poses."""
        every, log_odds, steps = self.near
        return {one.tobytes(): (odds, step) for one, odds, step in zip(every, log_odds.tolist(), steps, strict=True)}

    @classmethod
    def of(cls, assignment: Integers, found: Evidence, poses: tuple[Floats, Floats], k: int) -> _Mode:
        """The mode of one of several weighed proposals; ``poses``: those after the remaining steps."""
        return cls(
            assignment=assignment,
            rotation=poses[0][k],
            position=poses[1][k],
            covariance=found.covariance[k],
            log_odds=float(found.log_odds[k]),
            freedom=float(found.freedom[k]),
            visible=found.visible[k],
            detected=float(found.detected[k]),
            log_mass=float(found.log_odds[k]),
            local=np.ones(len(assignment)),
            unmatched=(assignment < 0).astype(float),
            summed=False,
            near=empty_changes(len(assignment)),
        )


def _similarly_turned(mode: _Mode, others: list[_Mode]) -> list[_Mode]:
    """Those of several modes that are turned nearly as one is: no other is part of it, nor it of another."""
    if not others:
        return []
    turns = np.array([other.rotation for other in others]).reshape(-1, 9) @ mode.rotation.ravel()
    return [others[k] for k in (turns >= ALIKE).nonzero()[0].tolist()]


def _is_part(mode: _Mode, other: _Mode) -> bool:
    """Whether a mode has the pose of another one, or that of a change of its assignment that was weighed there."""
    if mode is other:
        return False
    if is_same_pose(mode.pose, other.pose, NO_STEP, SAME_POSE):
        return True
    value, moved = other.changes.get(mode.assignment.tobytes(), (-math.inf, NO_STEP))
    return mode.log_odds < value + 1.0 and bool(is_same_pose(mode.pose, other.pose, moved, SAME_POSE))


def _small_step(turn: Floats, shift: Floats) -> Floats:
    """A step (6,) of a rotation by a small angle and a translation."""
    half = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.concatenate([half, shift])


def _grow(model: DetectionModel, mode: _Mode, at: Linearised) -> _Mode:
    """A mode after its best changes, with the sum over the others."""
    for turn in range(ROUNDS + 1):
        checkpoint()
        columns, gains, order, changed = _list_mode_changes(model, mode, at)
        if len(order):
            weighed = weigh_assignments(model, changed, at)
            values = np.maximum(weighed.log_odds, IMPOSSIBLE)
            gains[order] = values[: len(order)] - mode.log_odds
            to_mode = _small_step(mode.rotation @ at.rotation[0].T, mode.position - at.position[0])
            mode.near = changed, values, weighed.step - to_mode
            vars(mode).pop("changes", None)
            enough = (changed >= 0).sum(axis=1) >= model.prior.minimum
            best = int(np.where(enough, values, -np.inf).argmax())
            if enough[best] and values[best] > mode.log_odds and turn < ROUNDS:
                found, settled_at = settle_poses(model, changed[[best]], mode.rotation[None], mode.position[None])
                better = _Mode.of(changed[best], found, step_poses(found, settled_at), 0)
                if better.log_odds > mode.log_odds:
                    mode, at = better, settled_at
                    continue
        break
    mode.local, mode.unmatched = np.empty(len(mode.assignment)), np.empty(len(mode.assignment))
    sums = sum_over_changes(mode.assignment, columns, gains, INDEPENDENT, mode.local, mode.unmatched)
    mode.log_mass, mode.summed = mode.log_odds + sums, True
    return mode


def _list_mode_changes(
    model: DetectionModel, mode: _Mode, at: Linearised
) -> tuple[Integers, Floats, Integers, Integers]:
    """The changes of a mode that are not negligible to first order in its pose, see `likely_mode_changes`."""
    minimum = model.prior.minimum
    *_, log_counts, image_of = model.image_for_kernels
    may_lose = (
        np.count_nonzero(mode.assignment >= 0) > minimum or minimum < MINIMUM
    )  # one match is no mode, but is weighed
    found: tuple[Integers, Floats, Integers, Integers] = likely_mode_changes(
        mode.assignment,
        (at.pixels[0], at.jacobian[0], model.of_points(at)[0], mode.visible, at.seen[0]),
        mode.covariance,
        (*model.gating_image, log_counts, image_of),
        (math.nan if model.rate is None else model.rate, -NEGLIGIBLE, may_lose, WEIGHED, minimum),
    )
    return found


def _stack_modes(kept: list[_Mode], n: int) -> Modes:
    if not kept:
        return empty_modes(n)
    *arrays, near = zip(*map(_COLUMNS, kept), strict=True)
    return Modes._make([*map(np.array, arrays), object_array(near)])


_COLUMNS = attrgetter(*(field.name for field in fields(_Mode)))
"""Of a mode, the columns of `Modes`."""
