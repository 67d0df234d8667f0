"""Poses proposed where the rotation is known: two matches tell the rest, and most pairs of them contradict it.

With R known, two lines of sight d and d' through points X and X' meet them in depths s and s' with
R (X − X') = s d − s' d' − (o' − o), o and o' the centres of the cameras: three equations for two unknowns. The third
says how far off a pair is. Every pair that is not is a pose, whose distribution with the rotation's own predicts all
other points; those that explain most are assigned and fitted. Any two lines of sight will do, of one camera or of two.

A pose that explains m sightings is that of m (m − 1) / 2 pairs, so not all have to be looked at: they are drawn in
blocks, until a pose which explains nearly as many as the best would have been met.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import rotation_from_vector, rotation_vector
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import OutOfTime, Pace, active_deadline
from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.known_density import Known
from rootmatch.model.prediction import Settled, collect_proposals, score_predictions, settle_assignment
from rootmatch.model.proposals import Proposals
from rootmatch.problems.limits import GATE
from rootmatch.problems.noise import mean_deviation
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.samplers.guided.visibility import MISSED

MAX_PAIRS = 2_000_000
"""Pairs of matches that are looked at, drawn at random where there are more. A round value."""
MAX_POSES = 30_000
"""Poses whose predictions are compared with all detections, drawn at random where there are more. A round value."""
BLOCK, PARTS = 4096, 16
"""Pairs that are looked at before it is asked whether that is enough, or such a part of all, if that is more. Round
values."""
FEWER = 1
"""By how many sightings a pose may lag behind the best one and still be met: one with fewer explains too little to
matter. A round value."""
KEPT = 12
"""Poses that are assigned and fitted. A round value."""
BATCH = 4_000_000
"""Numbers of an array that is worked on at once."""
MAX_RANKED = 1000
"""Best poses of pairs among which different ones are looked for. A round value."""
LAG = 12.0
"""Log-odds, to first order, by which a pose may lag behind the best one. A round value."""
SAME = 3.0
"""Standard deviations on each axis within which poses are the same. A round value."""
LISTED, RANKED, FIRST = 0.25, 0.5, 64
"""Shares of the time left, where it is limited, in which pairs are looked at and poses are compared, and how many of
these are the first. Round values."""
SECONDS_PER_PAIR = 4e-7
"""Time to look at a pair of matches."""


class PairPoses(NamedTuple):
    """Pairs of matches that agree with what is known, and the poses they tell."""

    pairs: Integers
    """(K, 2, 2): rows of an assignment, then detections."""
    rotation: Floats
    """(K, 3, 3)."""
    position: Floats
    """(K, 3) of the centre of the points."""
    share: float
    """Of all pairs of matches, those that were looked at for these."""


class _Ranked(NamedTuple):
    """Poses with the log-odds of what they explain, to first order, and their covariances."""

    score: Floats
    rotation: Floats
    position: Floats
    covariance: Floats

    def take(self, some: Integers) -> _Ranked:
        return _Ranked(*(one[some] for one in self))

    def best(self, maximum: int) -> _Ranked:
        """At most so many, the best first."""
        return self.take(np.argsort(-self.score, kind="stable")[:maximum])


def propose_by_rotation(task: MatchingTask, known: PosePrior, model: DetectionModel) -> Proposals | None:
    """What is assigned about the best poses with a known rotation; None without one, or if no pair agrees with it."""
    if known.turn is None:
        return None
    return assign_about_poses(model, known, _find_agreeing(task, known, model.centre))


def assign_about_poses(model: DetectionModel, known: PosePrior, drawn: Iterable[PairPoses]) -> Proposals | None:
    """What is assigned about the best of the poses of pairs, of as many as are needed; None if that is nothing."""
    prior = Known(known, model.centre, body_radius(model.points))
    settled, ranked, share, first = dict[bytes, Settled](), list[_Ranked](), 0.0, -math.inf
    for some in drawn:
        share += some.share
        if len(some.pairs) and len((scored := _score_poses(model, prior, some)).score):
            ranked = [_join([*ranked, scored]).best(MAX_RANKED)]
        if not ranked or share >= 1.0:
            continue
        if ranked[0].score[0] > first:
            first = float(ranked[0].score[0])
            _settle(model, ranked[0].take(np.arange(1)), settled)
        if _unmet_probability(settled, share) <= MISSED:
            break
    if ranked:
        _settle(model, _select_different(ranked[0]), settled)
    return collect_proposals(list(settled.values()))


def _settle(model: DetectionModel, poses: _Ranked, settled: dict[bytes, Settled]) -> None:
    """Add what is assigned about the poses to ``settled``."""
    for _, R, place, covariance in zip(*poses, strict=True):
        with suppress(OutOfTime):  # what is known by then is handed on
            settle_assignment(model, (R[None], place[None]), covariance, known=settled)


def _unmet_probability(settled: dict[bytes, Settled], share: float) -> float:
    """The probability that a pose which explains nearly as much as the best has no pair among this share of all."""
    best = max(settled.values(), key=lambda one: one.log_odds, default=None)
    if best is None or not best.log_odds > 0.0:
        return 1.0
    matched = int(np.count_nonzero(best.assignment >= 0)) - FEWER
    return float((1.0 - share) ** math.comb(max(matched, 0), 2))


def has_many_pairs(task: MatchingTask) -> bool:
    """Whether there are more pairs of matches than are looked at, before any is excluded."""
    count = task.shape[0] * task.shape[1] if task.allowed is None else int(task.allowed.sum())
    return math.comb(count, 2) > MAX_PAIRS


def lines_of_sight(task: MatchingTask) -> tuple[Floats, Floats, Floats]:
    """Origins (n', 3) and unit directions (n', 3) of the detections' lines of sight, and their σ (n',) in radians."""
    points, camera = task.points, task.problem.camera  # type: ignore[attr-defined]
    rays = np.asarray(camera.bearings(points.target), np.float64)
    origins = np.zeros_like(rays) if task.rig is None else task.rig.centres[task.camera_of]
    return origins, rays, np.asarray(camera.angular_noise(points.target, points.target_noise))


def _find_agreeing(task: MatchingTask, known: PosePrior, centre: Floats) -> Iterator[PairPoses]:
    """Pairs of matches that agree with the rotation, block by block; ``centre`` (3,): of the points."""
    assert known.turn is not None
    rng = np.random.default_rng(task.options.seed)
    (R, covariance), (origins, rays, angles) = known.turn, lines_of_sight(task)
    sigma = math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
    turned = task.points.source @ R.T
    i, j = np.nonzero(_possible_matches(task, known, turned, rays, origins=origins, sigma=sigma))
    row = task.camera_of[j] * task.shape[0] + i
    own = np.zeros(len(i))
    if task.points.source_covariance is not None:
        own = mean_deviation(task.points.source_covariance)[i] ** 2
    angle = angles[j]
    points, origin, ray = turned[i], origins[j], rays[j]
    for first, second, share in draw_match_pairs(row, j, rng):
        a, b = ray[first], ray[second]
        between = points[first] - points[second]
        apart = between + origin[second] - origin[first]
        cosine = (a * b).sum(axis=1)
        of_a, of_b = (apart * a).sum(axis=1), (apart * b).sum(axis=1)
        sine2 = np.maximum(1.0 - cosine**2, 1e-12)
        depth_a, depth_b = (of_a - cosine * of_b) / sine2, (cosine * of_a - of_b) / sine2
        off = np.linalg.norm(apart - depth_a[:, None] * a + depth_b[:, None] * b, axis=1)
        variance = sigma**2 * (between**2).sum(axis=1) + own[first] + own[second]
        variance += (depth_a * angle[first]) ** 2 + (depth_b * angle[second]) ** 2
        agrees = np.flatnonzero((off <= GATE * np.sqrt(variance)) & (depth_a > 0.0) & (depth_b > 0.0))
        agrees, share = draw_poses(agrees, share, rng)
        first, second = first[agrees], second[agrees]
        one = origin[first] + depth_a[agrees, None] * a[agrees] - points[first]
        other = origin[second] + depth_b[agrees, None] * b[agrees] - points[second]
        rotation = np.broadcast_to(R, (len(first), 3, 3))
        yield PairPoses(pack_pairs(row, j, first, second), rotation, 0.5 * (one + other) + R @ centre, share)


def draw_match_pairs(
    row: Integers, j: Integers, rng: np.random.Generator
) -> Iterator[tuple[Integers, Integers, float]]:
    """Pairs (K,), (K,) of matches of different points and detections, block by block, with the share of all pairs.

    In all they are some, if there are many or the time is short.
    """
    first, second = np.triu_indices(len(j), 1)
    every = max(len(first), 1)
    maximum = active_deadline().part(LISTED).cut(min(len(first), MAX_PAIRS), SECONDS_PER_PAIR)
    size = max(BLOCK, every // PARTS)
    if maximum > size:
        some: Integers | slice = rng.choice(len(first), maximum, replace=False)
    else:
        some = draw_some(len(first), maximum, rng)
    first, second = first[some], second[some]
    for begin in range(0, len(first), size):
        one, other = first[begin : begin + size], second[begin : begin + size]
        different = (j[one] != j[other]) & (row[one] != row[other])
        yield one[different], other[different], len(one) / every


def draw_poses(agreeing: Integers, share: float, rng: np.random.Generator) -> tuple[Integers, float]:
    """Those of the pairs of a block that are compared with all detections, and the share of all pairs that leaves."""
    maximum = max(math.ceil(share * MAX_POSES), 1)
    if len(agreeing) <= maximum:
        return agreeing, share
    return agreeing[draw_some(len(agreeing), maximum, rng)], share * maximum / len(agreeing)


def draw_some(count: int, maximum: int, rng: np.random.Generator) -> Integers | slice:
    """Which of so many to take: all, or as many as ``maximum``, in order."""
    return slice(None) if count <= maximum else np.sort(rng.choice(count, maximum, replace=False))


def pack_pairs(row: Integers, j: Integers, first: Integers, second: Integers) -> Integers:
    """Pairs of matches (K, 2, 2): rows of an assignment come before detections."""
    return np.stack([np.stack([one[first], one[second]], axis=1) for one in (row, j)], axis=1)


def _possible_matches(
    task: MatchingTask, known: PosePrior, turned: Floats, rays: Floats, *, origins: Floats, sigma: float
) -> Bools:
    """Correspondences (n, n') that normals and a known position leave, with the rotation."""
    points = task.points
    allowed = np.ones(task.shape, np.bool_) if task.allowed is None else task.allowed
    if points.normals is not None and known.turn is not None:
        length = np.linalg.norm(points.normals, axis=1)
        unit = points.normals / np.where(length > 0.0, length, 1.0)[:, None]
        cosine = -(unit @ known.turn[0].T) @ rays.T
        minimum = np.zeros(len(unit)) if points.view_cosine is None else points.view_cosine
        rim = np.cos(np.minimum(np.arccos(minimum) + GATE * sigma, np.pi))
        allowed = allowed & ((cosine >= rim[:, None]) | (length == 0.0)[:, None])
    if known.place is not None:
        t, covariance = known.place
        where = t + turned[:, None] - origins  # (n, n', 3)
        along = (where * rays).sum(axis=2)
        off = np.linalg.norm(where - along[..., None] * rays, axis=2)
        reach = np.sqrt(np.linalg.eigvalsh(covariance)[-1] + sigma**2 * (turned**2).sum(axis=1))
        allowed = allowed & (off <= GATE * reach[:, None]) & (along > 0.0)
    return np.asarray(allowed)


def _score_poses(model: DetectionModel, prior: Known, given: PairPoses) -> _Ranked:
    """What the poses of pairs explain, of those that are looked at in time."""
    size, deadline, parts = max(BATCH // (model.shape[0] * max(model.shape[1], 1)), 1), active_deadline(), []
    order, pace = np.arange(len(given.pairs)), Pace(deadline.part(RANKED), FIRST)
    if deadline.is_set:  # which may pass before all are compared
        order = np.random.default_rng(0).permutation(order)
    while len(order) and (count := pace.block(min(size, len(order)))):
        some, order = order[:count], order[count:]
        parts.append(_score(model, prior, given.pairs[some], (given.rotation[some], given.position[some])))
    return _join(parts) if parts else _Ranked(np.empty(0), np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 6, 6)))


def _join(parts: list[_Ranked]) -> _Ranked:
    return parts[0] if len(parts) == 1 else _Ranked(*(np.concatenate(one) for one in zip(*parts, strict=True)))


def _select_different(ranked: _Ranked) -> _Ranked:
    """Different ones of the poses, the best first."""
    score, R, place, covariance = ranked
    kept: list[int] = []
    for k in range(len(score)):
        if score[k] < score[0] - LAG:
            break
        scale = SAME**2 * np.diagonal(covariance[k])
        near = [other for other in kept if ((place[other] - place[k]) ** 2 <= scale[3:]).all()]
        if not near or not (rotation_vector(R[near] @ R[k].T) ** 2 <= scale[:3]).all(axis=1).any():
            kept.append(k)
        if len(kept) == KEPT:
            break
    return ranked.take(np.array(kept, np.int64))


def _score(model: DetectionModel, prior: Known, pairs: Integers, poses: tuple[Floats, Floats]) -> _Ranked:
    """The poses that pairs lead to from these, and what they explain."""
    count, (rotation, position) = len(pairs), poses
    at = model.linearise_about(rotation, position)
    of_prior = prior.terms(rotation, position)
    rows = np.arange(count)[:, None]
    points, detections = pairs[:, 0], pairs[:, 1]
    weight = 1.0 / model.sigma[detections]
    jacobian = (at.jacobian[rows, points] * weight[..., None, None]).reshape(count, 4, 6)
    off = ((model.target[detections] - at.pixels[rows, points]) * weight[..., None]).reshape(count, 4)
    precision = of_prior.precision + jacobian.swapaxes(1, 2) @ jacobian
    scale = np.sqrt(np.diagonal(precision, axis1=1, axis2=2))
    unit = scale[:, :, None] * scale[:, None]
    covariance = np.linalg.inv(precision / unit + 1e-12 * np.eye(6)) / unit
    slope = of_prior.slope + (off[:, None] @ jacobian)[:, 0]
    step = (covariance @ slope[..., None])[..., 0]
    score = score_predictions(model, at, step, covariance)
    return _Ranked(score, rotation_from_vector(step[:, :3]) @ rotation, position + step[:, 3:], covariance)
