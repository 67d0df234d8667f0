"""Poses proposed where the rotation is known: two matches tell the rest, and most pairs of them contradict it.

With R known, two lines of sight d and d' through points X and X' meet them in depths s and s' with
R (X − X') = s d − s' d' − (o' − o), o and o' the centres of the cameras: three equations for two unknowns. The third
says how far off a pair is. Every pair that is not is a pose, whose distribution with the rotation's own predicts all
other points; those that explain most are assigned and fitted. Any two lines of sight will do, of one camera or of two.
"""

from __future__ import annotations

import math
from contextlib import suppress

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

MAX_PAIRS = 2_000_000
"""Pairs of matches that are looked at, drawn at random where there are more. A round value."""
MAX_POSES = 30_000
"""Poses whose predictions are compared with all detections, drawn at random where there are more. A round value."""
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


def propose_by_rotation(task: MatchingTask, known: PosePrior, model: DetectionModel) -> Proposals | None:
    """What is assigned about the best poses with a known rotation; None without one, or if no pair agrees with it."""
    turn = known.turn
    if turn is None:
        return None
    rng = np.random.default_rng(task.options.seed)
    pairs, origin = _find_agreeing(task, known, rng)
    if not len(origin):
        return None
    rotation = np.broadcast_to(turn[0], (len(origin), 3, 3))
    return assign_about_poses(model, known, pairs, (rotation, origin + turn[0] @ model.centre))


def assign_about_poses(
    model: DetectionModel, known: PosePrior, pairs: Integers, poses: tuple[Floats, Floats]
) -> Proposals | None:
    """What is assigned about the best of the poses of pairs (K, 2, 2); None if that is nothing.

    ``poses``: rotations (K, 3, 3) and positions (K, 3) of the centre.
    """
    settled: dict[bytes, Settled] = {}
    for R, place, covariance in _rank_poses(model, Known(known, model.centre, body_radius(model.points)), pairs, poses):
        with suppress(OutOfTime):  # what is known by then is handed on
            settle_assignment(model, (R[None], place[None]), covariance, known=settled)
    return collect_proposals(list(settled.values()))


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


def _find_agreeing(task: MatchingTask, known: PosePrior, rng: np.random.Generator) -> tuple[Integers, Floats]:
    """Pairs of matches (K, 2, 2) that agree with the rotation, and the origin (K, 3) by each.

    Rows of an assignment come before detections.
    """
    assert known.turn is not None
    (R, covariance), (origins, rays, angles) = known.turn, lines_of_sight(task)
    sigma = math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
    turned = task.points.source @ R.T
    i, j = np.nonzero(_possible_matches(task, known, turned, rays, origins=origins, sigma=sigma))
    row = task.camera_of[j] * task.shape[0] + i
    first, second = list_match_pairs(row, j, rng)
    a, b = rays[j[first]], rays[j[second]]
    apart = turned[i[first]] - turned[i[second]] + origins[j[second]] - origins[j[first]]
    cosine = (a * b).sum(axis=1)
    of_a, of_b = (apart * a).sum(axis=1), (apart * b).sum(axis=1)
    sine2 = np.maximum(1.0 - cosine**2, 1e-12)
    depth_a, depth_b = (of_a - cosine * of_b) / sine2, (cosine * of_a - of_b) / sine2
    off = np.linalg.norm(apart - depth_a[:, None] * a + depth_b[:, None] * b, axis=1)
    length2 = ((turned[i[first]] - turned[i[second]]) ** 2).sum(axis=1)
    variance = sigma**2 * length2 + (depth_a * angles[j[first]]) ** 2 + (depth_b * angles[j[second]]) ** 2
    if task.points.source_covariance is not None:
        own = mean_deviation(task.points.source_covariance) ** 2
        variance = variance + own[i[first]] + own[i[second]]
    agrees = np.flatnonzero((off <= GATE * np.sqrt(variance)) & (depth_a > 0.0) & (depth_b > 0.0))
    agrees = agrees[draw_some(len(agrees), MAX_POSES, rng)]
    first, second = first[agrees], second[agrees]
    one = origins[j[first]] + depth_a[agrees, None] * a[agrees] - turned[i[first]]
    other = origins[j[second]] + depth_b[agrees, None] * b[agrees] - turned[i[second]]
    return pack_pairs(row, j, first, second), 0.5 * (one + other)


def list_match_pairs(row: Integers, j: Integers, rng: np.random.Generator) -> tuple[Integers, Integers]:
    """Pairs (K,), (K,) of matches of different points and detections: some, if there are many or the time is short."""
    first, second = np.triu_indices(len(j), 1)
    maximum = active_deadline().part(LISTED).cut(min(len(first), MAX_PAIRS), SECONDS_PER_PAIR)
    some = draw_some(len(first), maximum, rng)
    first, second = first[some], second[some]
    different = (j[first] != j[second]) & (row[first] != row[second])
    return first[different], second[different]


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


def _rank_poses(
    model: DetectionModel, prior: Known, pairs: Integers, poses: tuple[Floats, Floats]
) -> list[tuple[Floats, Floats, Floats]]:
    """The poses of pairs whose predictions explain most, with their covariances: different ones, the best first."""
    size, deadline, parts = max(BATCH // (model.shape[0] * max(model.shape[1], 1)), 1), active_deadline(), []
    order, pace = np.arange(len(pairs)), Pace(deadline.part(RANKED), FIRST)
    if deadline.is_set:  # which may pass before all are compared
        order = np.random.default_rng(0).permutation(order)
    while len(order) and (count := pace.block(min(size, len(order)))):
        some, order = order[:count], order[count:]
        parts.append(_score(model, prior, pairs[some], (poses[0][some], poses[1][some])))
    if not parts:
        return []
    score, R, place, covariance = (np.concatenate(column) for column in zip(*parts, strict=True))
    kept: list[int] = []
    for k in np.argsort(-score, kind="stable")[:MAX_RANKED].tolist():
        if score[k] < score.max() - LAG:
            break
        off = np.concatenate([rotation_vector(R[kept] @ R[k].T), place[kept] - place[k]], axis=1)
        scale = SAME**2 * np.diagonal(covariance[k])
        if not ((off**2) <= scale).all(axis=1).any():
            kept.append(k)
        if len(kept) == KEPT:
            break
    return [(R[k], place[k], covariance[k]) for k in kept]


def _score(
    model: DetectionModel, prior: Known, pairs: Integers, poses: tuple[Floats, Floats]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Log-odds (K,) of what poses with a pair each explain, to first order, and those poses with their covariances."""
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
    return score, rotation_from_vector(step[:, :3]) @ rotation, position + step[:, 3:], covariance
