"""Assignments about a predicted pose: gated by its covariance, assigned one to one, and settled.

A good prediction leaves one detection or two for each point. Those are assigned and weighed at once. Where gates hold
several detections, single correspondences are tried first: each moves the whole prediction and narrows all other gates
(a Kalman update), and those that explain most are settled. No minimal sets are solved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import one_rotation_matrix
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import OutOfTime, checkpoint
from rootmatch.model.compiled.gating import gate
from rootmatch.model.compiled.looking import follow_gates
from rootmatch.model.compiled.updates import choose_pairs, fill_explained, update_with_each
from rootmatch.model.detection_model import USUAL_RATE, DetectionModel
from rootmatch.model.evidence import STEEP, Evidence, evidence_buffers, kernel_mixture, step_poses, weigh_assignments
from rootmatch.model.linearised import Linearised, image_room
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.proposals import Proposals

ENTRIES = 200_000
"""Densities of detections that are computed between two looks at the time: some milliseconds."""


GATE = 4.0
"""Standard deviations of a prediction, its own and the detection's, within which a detection is a candidate."""
MAX_PAIRS = 400
"""Candidate pairs in an image beyond which a prediction is too wide to propose anything."""
TRIED = 64
"""Most single correspondences that are tried, those of the points with the fewest candidates. Not tuned."""
BEAMS = 4
"""Hypotheses that are settled: four find as much as eight (benchmarks/tracking.py, 6 flights, seeds from 1000)."""
COMPLETE = 0.8
"""Share of the visible points from which the first assignment is accepted without trying others, if it also fits."""
FITTING = 2.5
"""χ² over its degrees of freedom up to which it fits."""
ENOUGH = 4
"""Fewest matches with which it fits: three fit many poses."""
ROUNDS = 5
"""Most assignments and steps in turn."""
NARROWER = 8
"""Looks about a prediction that is too wide, each half as far as the one before: a body is hardly ever as far off as it
may be. A round value."""
SEVERAL = 1.5
"""Detections in a gate, in the mean, from which it is looked nearer. A round value."""
HIDDEN = 0.1
"""Least visibility of a point with candidates."""


class Settled(NamedTuple):
    """An assignment about a pose, with its evidence there and the pose that it leads to."""

    assignment: Integers
    rotation: Floats
    position: Floats
    covariance: Floats
    log_odds: float
    squared: float
    visible: Floats

    @classmethod
    def of(cls, assignment: Integers, found: Evidence, poses: tuple[Floats, Floats], k: int) -> Settled:
        """One of some hypotheses; ``poses``: those after the steps of their evidence."""
        return cls(
            assignment, poses[0][k], poses[1][k], found.covariance[k], log_odds=float(found.log_odds[k]),
            squared=float(found.squared[k]), visible=found.visible[k],
        )  # fmt: skip

    def is_convincing(self, near: int) -> bool:
        """Whether it fits, and has all pairs that are ``near``, so many, or nearly all that should be visible."""
        matched = int(np.count_nonzero(self.assignment >= 0))
        if matched < near and (matched < ENOUGH or matched < COMPLETE * float(self.visible.sum())):
            return False
        return self.squared <= FITTING * 2.0 * matched


def collect_proposals(every: Sequence[Settled]) -> Proposals | None:
    """Those of some assignments that are possible, with the poses they lead to; None without any."""
    possible = [one for one in every if math.isfinite(one.log_odds)]
    if not possible:
        return None
    assignments, rotations, positions, *_ = zip(*possible, strict=True)
    return Proposals(np.array(assignments), np.array(rotations), np.array(positions))


def propose_about(model: DetectionModel, prediction: Gaussian) -> Proposals | None:
    """Assignments about a predicted pose with the poses they lead to, the most probable first.

    The prediction is of all six parameters, and part of the model's prior.

    Returns
    -------
    Proposals or None
        None if the prediction has no candidates, or too many even where it is narrowed.
    """
    return collect_proposals(_settle_about(model, prediction)[0])


def propose_about_each(
    model: DetectionModel, predictions: Sequence[Gaussian], narrowed: Sequence[int] | None = None
) -> list[Proposals]:
    """What `propose_about` tells of several predictions, the most probable first.

    A wide one is narrowed by single correspondences if it is among those to be ``narrowed``, all by default, and none
    before it fits: look-alikes of what fits are proposed as twins.
    """
    out, narrowing = list[Proposals](), True
    for k, prediction in enumerate(predictions):
        found, fits = _settle_about(model, prediction, narrowing=narrowing and (narrowed is None or k in narrowed))
        narrowing = narrowing and not fits
        if (proposals := collect_proposals(found)) is not None:
            out.append(proposals)
    return out


def _settle_about(model: DetectionModel, prediction: Gaussian, *, narrowing: bool = True) -> tuple[list[Settled], bool]:
    """The assignments of `propose_about`, and whether one fits that was settled at once."""
    pose, covariance = (prediction.rotation[None], prediction.position[None]), prediction.bounded_covariance
    maximum = MAX_PAIRS * max(len(model.images), 1)
    known: dict[bytes, Settled] = {}
    start, near, torn = None, 0, list[tuple[Looked, Floats]]()
    for _ in range(NARROWER):
        looked = look_about(model, pose, covariance, rounds=ROUNDS, maximum=maximum)
        if not (count := np.count_nonzero(looked.candidates)):
            break
        if count <= maximum:
            try:
                start = settle_assignment(model, pose, covariance, known=known, looked=looked)
            except OutOfTime:
                if not torn:
                    raise
                break
            near = near if torn else int(count)
            torn.append((looked, covariance))
            if start is not None and start.log_odds > 0.0:
                break
            if count <= SEVERAL * np.count_nonzero(looked.candidates.any(axis=1)):
                break
        covariance = 0.25 * covariance
    if not torn:
        return [], False
    fits = start is not None and start.is_convincing(near)
    if narrowing and not fits:
        with suppress(OutOfTime):  # what is known by then is handed on
            for looked, covariance in (torn[0], *torn[1:][-1:]):  # the widest and the narrowest
                first = looked.at.one(0)
                for step, narrowed in _narrow_by_pairs(model, looked, covariance):
                    moved = one_rotation_matrix(step[:3]) @ first.rotation, first.position + step[3:]
                    settle_assignment(model, moved, narrowed, known=known)
    return sorted(known.values(), key=lambda one: -one.log_odds), fits


def settle_assignment(
    model: DetectionModel,
    pose: tuple[Floats, Floats],
    covariance: Floats,
    *,
    known: dict[bytes, Settled],
    looked: Looked | None = None,
) -> Settled | None:
    """Assignment and step in turn until the assignment stays; all of them are added to ``known``.

    ``pose``: rotation (1, 3, 3) and position (1, 3); ``looked``: what is seen about it, if that is known.
    """
    best, rounds = None, ROUNDS
    while rounds > 0:
        checkpoint()
        looked = looked or look_about(model, pose, covariance, rounds=rounds)
        for one in looked.settled:
            key = one.assignment.tobytes()
            if key in known:
                return known[key]
            best = known[key] = one
        assignment, about, looked = looked.last, looked.about, None
        key = assignment.tobytes()
        if about is None or key in known:
            return known.get(key, best)
        if not (assignment >= 0).any():
            break
        found, rounds = weigh_assignments(model, assignment[None], about), rounds - 1
        pose, covariance = step_poses(found, about), found.covariance[0]
        best = known[key] = Settled.of(assignment, found, pose, 0)
        if np.count_nonzero(assignment >= 0) >= float(best.visible.sum()):
            break  # nothing is left to assign
    return best


class Looked(NamedTuple):
    """What is seen about a pose, and about those that it leads to."""

    at: Linearised
    """Images about the pose itself, the first; with the visibility (n,) of the points and the candidates (n, n') there.
    """
    visible: Floats
    candidates: Bools
    settled: list[Settled]
    last: Integers
    """The last assignment (n,)."""
    about: Linearised | None
    """Images about the pose where that is to be weighed; None if nothing more is."""


def look_about(
    model: DetectionModel,
    pose: tuple[Floats, Floats],
    covariance: Floats,
    *,
    rounds: int = ROUNDS,
    maximum: float = math.inf,
    at: Linearised | None = None,
) -> Looked:
    """What is seen about a pose; nothing follows from it with more than ``maximum`` candidates.

    ``at``: images about it, if they are known and the points or detections have covariances.
    """
    n, _ = shape = model.shape
    gated = np.empty(shape, np.bool_), np.empty(shape), np.empty(n, np.int64)
    limits = GATE**2, model.rate or USUAL_RATE, HIDDEN
    if (prior := kernel_mixture(model)) is None or model.has_covariances:
        at = at or model.linearise_about(*pose)
        visible = model.visibility(at, np.array([_direction_sigma(covariance)]))[0]
        gate((*_image_arguments(model, at), visible), np.array(covariance), model.gating_image, limits, gated)
        return Looked(at, visible, gated[0], settled=[], last=gated[2], about=at)
    rotation, position = pose[0].repeat(rounds + 1, axis=0), pose[1].repeat(rounds + 1, axis=0)
    at = image_room(n, model.normals is not None, rotation, position)
    found, rows = evidence_buffers(rounds, n), np.empty((rounds, n), np.int64)
    candidates, visible = np.empty(shape, np.bool_), np.empty(n)
    count = follow_gates(
        np.array(covariance), model.scene_for_kernels, prior, (*limits, float(maximum), STEEP),
        (*at[:4], at.for_kernels[0], at.expected, at.rotation, at.position), (rows, tuple(found)),
        (candidates, visible, *gated),
    )  # fmt: skip
    after = at.rotation[1:], at.position[1:]
    settled = [Settled.of(rows[k], found, after, k) for k in range(count)]
    return Looked(at, visible, candidates, settled=settled, last=gated[2], about=None)


def _image_arguments(model: DetectionModel, at: Linearised) -> tuple[Floats, Floats, Floats]:
    """Pixels (n, 2) of the points in one pose, their Jacobian (n, 2, 6), and covariances (n, 2, 2) if not exact."""
    return at.pixels[0], at.jacobian[0], model.of_points(at)[0]


def _narrow_by_pairs(model: DetectionModel, looked: Looked, covariance: Floats) -> list[tuple[Floats, Floats]]:
    """Steps and covariances after two correspondences each, those that explain most."""
    points = *_image_arguments(model, looked.at), (model.rate or USUAL_RATE) * looked.visible
    beams = [(np.zeros(6), np.array(covariance))]
    for _ in range(2):
        every = [_kalman_updates(points, about, model.gating_image, looked.candidates) for about in beams]
        steps, spreads, scores = (np.concatenate(part) for part in zip(*every, strict=True))
        if not len(scores):
            break
        rounded, distinct = np.round(scores, 6).tolist(), dict[float, int]()
        for k in np.argsort(-scores, kind="stable").tolist():
            distinct.setdefault(rounded[k], k)
        beams = [(steps[k], spreads[k]) for k in list(distinct.values())[:BEAMS]]
    return beams


def _kalman_updates(
    points: tuple[Floats, ...], about: tuple[Floats, Floats], image: tuple[Floats, ...], candidates: Bools
) -> tuple[Floats, Floats, Floats]:
    """Steps (P, 6), covariances (P, 6, 6) and scores (P,) after a Kalman update with each of some candidate pairs."""
    n, n_target = candidates.shape
    pairs = np.empty((max(TRIED, n_target), 2), np.int64)
    count = choose_pairs(points, about, image, candidates, (GATE**2, TRIED), pairs)
    steps, covariances, scores = np.empty((count, 6)), np.empty((count, 6, 6)), np.empty(count)
    maximum = max(ENTRIES // (n * n_target), 1)
    for begin in range(0, count, maximum):
        checkpoint()
        part = slice(begin, min(begin + maximum, count))
        out = steps[part], covariances[part], scores[part]
        update_with_each(points, about, image, candidates, pairs[part], out)
    return steps, covariances, scores


def score_predictions(model: DetectionModel, at: Linearised, step: Floats, covariance: Floats) -> Floats:
    """Log-odds (K,) of what poses explain, to first order, each point with its likeliest detection.

    ``step`` (K, 6) and ``covariance`` (K, 6, 6): of the distributions of the poses, from those of ``at``.
    """
    chance = model.visibility(at, np.sqrt(np.trace(covariance[:, :3, :3], axis1=1, axis2=2) / 3.0))
    if model.rate:
        chance *= model.rate
    else:  # of many points that face the camera no more are seen than are detected
        shown = np.maximum(chance.sum(axis=1, keepdims=True), 1.0)
        chance *= np.minimum(USUAL_RATE, model.shape[1] / shown)
    points, scores = (at.pixels, at.jacobian, model.of_points(at), chance), np.empty(len(step))
    fill_explained(points, (step, covariance), model.gating_image, scores)
    return scores


def _direction_sigma(covariance: Floats) -> float:
    """Standard deviation of a pose's direction, in radians."""
    return min(math.sqrt(max(0.5 * float(covariance[0, 0] + covariance[1, 1] + covariance[2, 2]), 0.0)), 1.0)
