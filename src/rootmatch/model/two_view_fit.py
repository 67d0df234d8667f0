"""Poses of whole assignments between two views: the centres of the samples of `rootmatch.model.two_view_posterior`.

Starts are the rotations about the common direction for which the epipolar constraints agree best; from there the fit
goes to deviations from the epipolar planes and of the log inverse distances, in turn with the spread of these.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.two_view_model import SCALES, SPREADS, Relative, Seen, TwoViewModel
from rootmatch.problems.pose_fit.baselines import baseline_directions, rotation_alone
from rootmatch.problems.pose_fit.descent import regularise_normal
from rootmatch.problems.pose_fit.two_view_pose import ANGLES, OPEN

VALLEYS = 4
"""The best of them, from which epipolar planes are fitted. A round value."""
STARTS = 4
"""The best of those fits, which go on to inverse distances. A round value."""
STEPS = 3
"""Steps of a fit in each of its rounds; samples need no better centres. A round value."""
ROUNDS = 2
"""Rounds with epipolar planes alone, and as many with inverse distances. A round value."""
DOUBTED = 3.0
"""Deviation from which a match counts less, in σ or in medians of all where those are larger. A round value."""
IMPOSSIBLE = 6.0
"""Deviation, in σ, of a match that lies behind a camera. As of the descent."""
RIDGE = 1e-9
"""Added to variances, relative to them: an inverse that rounding leaves without a root gets one. A round value."""
FIRST_SCALE = 0.1
"""Baseline over distance before any is known. A round value."""
ALIKE = 0.7
"""Share of its matches from which an assignment has the pose of another one. As of the search for them."""


class Fitted(NamedTuple):
    """Assignments (K, n), the pose of each, its covariance (K, p, p), and χ² (K,) of the epipolar deviations."""

    assignments: Integers
    poses: Relative
    covariance: Floats
    chi2: Floats

    def take(self, rows: Integers) -> Fitted:
        """Some of them."""
        return Fitted(self.assignments[rows], self.poses.take(rows), self.covariance[rows], self.chi2[rows])

    def joined(self, more: Fitted) -> Fitted:
        """These and others."""
        return Fitted(
            np.concatenate([self.assignments, more.assignments]),
            Relative.joined([self.poses, more.poses]),
            np.concatenate([self.covariance, more.covariance]),
            np.concatenate([self.chi2, more.chi2]),
        )


def drop_similar(assignments: Integers) -> Integers:
    """Assignments (K, n) without those that have much in common with one before them."""
    kept: list[Integers] = []
    for one in assignments:
        used = one >= 0
        if all(((one == other) & used).sum() < ALIKE * used.sum() for other in kept):
            kept.append(one)
    return np.array(kept, np.int64).reshape(-1, assignments.shape[1])


def fit_relative_poses(model: TwoViewModel, assignments: Integers) -> Fitted:
    """Poses of assignments (K, n), `STARTS` of each."""
    poses, rows = _find_starts(model, assignments)
    poses, seen = _descend_robustly(model, poses, assignments[rows], near=False)
    used = assignments[rows] >= 0
    # if the camera hardly moved, half a turn about a baseline fits epipolar planes as well, with all points behind it
    e = np.where(seen.ahead > 0.0, seen.e, np.maximum(np.abs(seen.e), IMPOSSIBLE))
    total = np.where(used, np.log1p((e / DOUBTED) ** 2), 0.0).sum(axis=1).reshape(len(assignments), -1)
    count = total.shape[1]
    best = (np.argsort(total, axis=1, kind="stable")[:, :STARTS] + count * np.arange(len(assignments))[:, None]).ravel()
    side = np.where(used, _robust_weights(seen.e, used) * seen.parallax / seen.sine, 0.0).sum(axis=1)
    poses = poses._replace(translation=poses.translation * np.where(side < 0.0, -1.0, 1.0)[:, None]).take(best)
    assignments = assignments[rows[best]]
    poses, seen = _descend_robustly(model, poses, assignments, near=True)
    used = assignments >= 0
    poses = _estimate_scale(poses, seen, used)
    _, normal = _descend_weighted(model, poses, assignments, np.sqrt(_robust_weights(seen.e, used)), near=True, steps=0)
    size, matched = model.size, np.maximum(used.sum(axis=1), 1)
    covariance = np.zeros((len(best), size, size))
    covariance[:, :-1, :-1] = np.linalg.inv(regularise_normal(normal) + np.eye(size - 1) / OPEN**2)
    sigma = np.minimum(1.0 / np.sqrt(np.maximum(2.0 * (matched - 1.0), 1.0)), 0.5 * (SPREADS[1] - SPREADS[0]))
    covariance[:, -1, -1] = sigma**2
    covariance[:, np.arange(size), np.arange(size)] *= 1.0 + RIDGE
    return Fitted(assignments, poses, covariance, (np.minimum(np.abs(seen.e), DOUBTED) ** 2 * used).sum(axis=1))


def _descend_robustly(model: TwoViewModel, poses: Relative, assignments: Integers, near: bool) -> tuple[Relative, Seen]:
    """Poses after some rounds of a fit, and their matches."""
    used = assignments >= 0
    seen = _see_matches(model, poses, assignments)
    for _ in range(ROUNDS):
        if near:
            poses = _estimate_scale(poses, seen, used)
        poses, _ = _descend_weighted(model, poses, assignments, _robust_weights(seen.e, used), near=near, steps=STEPS)
        seen = _see_matches(model, poses, assignments)
    return poses, seen


def _see_matches(model: TwoViewModel, poses: Relative, assignments: Integers) -> Seen:
    """The matches of each assignment (K, n) at its pose; of unmatched points anything."""
    return model.seen(poses, np.arange(assignments.shape[1]), np.maximum(assignments, 0))


def _descend_weighted(
    model: TwoViewModel, poses: Relative, assignments: Integers, weights: Floats, near: bool, steps: int
) -> tuple[Relative, Floats]:
    """Poses nearer to the bottom of their χ², the spread as it is, and their normal equations (K, p − 1, p − 1).

    ``weights`` (K, n): roots of the weights of matches; ``near``: whether inverse distances count.
    """
    from rootmatch.model.two_view_descent import (  # compiled code, which not every import needs
        descend_poses,
        descent_scratch,
    )

    states = np.concatenate([poses.turn[:, None], poses.translation, poses.tilt, poses.scale[:, None]], axis=1)
    normals = np.empty((len(states), model.size - 1, model.size - 1))
    descend_poses(
        model.views, (model.planar, model.tilt), states, poses.spread, np.ascontiguousarray(assignments),
        np.ascontiguousarray(weights), near, steps, normals, *descent_scratch(),
    )  # fmt: skip
    return Relative(states[:, 0], states[:, 1:4], states[:, 4:6], states[:, 6], poses.spread), normals


def _robust_weights(e: Floats, used: Bools) -> Floats:
    """Roots (…, n) of the weights of matches with deviations e: less from `DOUBTED` on, or from medians as large."""
    middle = masked_median(np.abs(e), used)[..., None]
    return np.asarray(1.0 / np.sqrt(1.0 + (e / (DOUBTED * np.maximum(middle, 1.0))) ** 2))


def masked_median(values: Floats, used: Bools) -> Floats:
    """Medians (…,) of those of some values (…, n) that are used, the lower one of two; 1 without any."""
    order = np.sort(np.where(used, values, np.inf), axis=-1)
    place = (np.maximum(np.count_nonzero(used, axis=-1), 1) - 1) // 2
    middle = np.take_along_axis(order, place[..., None], axis=-1)[..., 0]
    return np.where(np.isfinite(middle), middle, 1.0)


def _estimate_scale(poses: Relative, seen: Seen, used: Bools) -> Relative:
    """Poses with the median of the log inverse distances of their matches, and the spread about it."""
    front = np.asarray(used & (seen.ahead > 0.0) & (seen.parallax > 0.0) & (seen.r2 > 4.0 * seen.floor2), np.bool_)
    with np.errstate(all="ignore"):
        log = 0.5 * np.log(seen.r2)
    middle = np.where(front.any(axis=1), masked_median(log, front), math.log(FIRST_SCALE))
    spread = np.log(1.4826 * masked_median(np.abs(log - middle[:, None]), front) + np.exp(SPREADS[0] + 0.1))
    scale = np.clip(middle, SCALES[0] + 0.1, SCALES[1] - 0.1)
    return poses._replace(scale=scale, spread=np.minimum(spread, SPREADS[1] - 0.1))


def _find_starts(model: TwoViewModel, assignments: Integers) -> tuple[Relative, Integers]:
    """Poses of least deviation on a grid of rotations, `VALLEYS` of each assignment, and its number.

    And the rotation that fits best alone with `DIRECTIONS`: where the parallax is less than the steps of the grid,
    baselines at these say nothing.
    """
    from rootmatch.model.two_view_descent import scan_rotations  # compiled code, which not every import needs

    count = len(assignments)
    total, t = np.empty((count, ANGLES)), np.empty((count, ANGLES, 3))
    scan_rotations(model.views, model.planar, np.ascontiguousarray(assignments), DOUBTED, total, t)
    valley = (total <= np.roll(total, 1, axis=1)) & (total <= np.roll(total, -1, axis=1))
    best = np.argsort(np.where(valley, total, np.inf), axis=1, kind="stable")[:, :VALLEYS]
    ways = baseline_directions(model.planar)
    alone = rotation_alone(model.first, model.second[np.maximum(assignments, 0)], assignments >= 0)
    turn = np.concatenate([2.0 * np.pi / ANGLES * best, np.repeat(alone[:, None], len(ways), axis=1)], axis=1).ravel()
    every = np.concatenate([np.take_along_axis(t, best[..., None], axis=1), np.tile(ways, (count, 1, 1))], axis=1)
    rows = np.repeat(np.arange(count), VALLEYS + len(ways))
    scale, spread = np.full(len(rows), math.log(FIRST_SCALE)), np.full(len(rows), SPREADS[1] - 0.1)
    return Relative(turn, every.reshape(-1, 3), np.zeros((len(rows), 2)), scale, spread), rows
