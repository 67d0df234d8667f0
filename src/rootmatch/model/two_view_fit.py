"""Poses of whole assignments between two views: the centres of the samples of `rootmatch.model.two_view_posterior`.

Starts are the rotations about the common direction for which the epipolar constraints agree best; from there the fit
goes to deviations from the epipolar planes and of the log inverse distances, in turn with the spread of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross, rotation_about_y
from rootmatch.model.two_view_model import SCALES, SPREADS, Relative, Seen, TwoViewModel
from rootmatch.problems.pose_fit.descent import covariance_of, descended

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

ANGLES = 240
"""Rotations about the common direction that are tried for a start, 1.5° apart. A round value."""
VALLEYS = 4
"""The best of them, from which epipolar planes are fitted. A round value."""
STARTS = 2
"""The best of those fits, which go on to inverse distances. A round value."""
STEPS = 3
"""Steps of a fit in each of its rounds; samples need no better centres. A round value."""
ROUNDS = 2
"""Rounds with epipolar planes alone, and as many with inverse distances. A round value."""
OPEN = 1.0
"""σ in radians of a pose's angles, and of its log scale, that the points leave open. By construction."""
IMPOSSIBLE = 6.0
"""Deviation, in σ, of a match that lies behind a camera, so that a fit can go on without it. A round value."""
DOUBTED = 3.0
"""Deviation from which a match counts less, in σ or in medians of all where those are larger. A round value."""
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


def distinct(assignments: Integers) -> Integers:
    """Assignments (K, n) without those that have much in common with one before them."""
    kept: list[Integers] = []
    for one in assignments:
        used = one >= 0
        if all(((one == other) & used).sum() < ALIKE * used.sum() for other in kept):
            kept.append(one)
    return np.array(kept)


def fitted(model: TwoViewModel, assignments: Integers) -> Fitted:
    """Poses of assignments (K, n), `STARTS` of each."""
    poses, rows = _starts(model, assignments)
    poses, seen = _descended(model, poses, assignments[rows], near=False)
    used = assignments[rows] >= 0
    total = np.where(used, np.log1p((seen.e / DOUBTED) ** 2), 0.0).sum(axis=1).reshape(len(assignments), -1)
    count = total.shape[1]
    best = (np.argsort(total, axis=1, kind="stable")[:, :STARTS] + count * np.arange(len(assignments))[:, None]).ravel()
    side = np.where(used, _doubts(seen.e, used) * seen.parallax / seen.sine, 0.0).sum(axis=1)
    poses = poses._replace(translation=poses.translation * np.where(side < 0.0, -1.0, 1.0)[:, None]).take(best)
    assignments = assignments[rows[best]]
    poses, seen = _descended(model, poses, assignments, near=True)
    used = assignments >= 0
    poses = _scaled(poses, seen, used)
    fit = _Fit(model, assignments, poses.spread, np.sqrt(_doubts(seen.e, used)), near=True)
    size, matched = model.size, np.maximum(used.sum(axis=1), 1)
    covariance = np.zeros((len(best), size, size))
    precision = np.linalg.inv(covariance_of(fit, poses[:4])) + np.eye(size - 1) / OPEN**2
    covariance[:, :-1, :-1] = np.linalg.inv(precision)
    sigma = np.minimum(1.0 / np.sqrt(np.maximum(2.0 * (matched - 1.0), 1.0)), 0.5 * (SPREADS[1] - SPREADS[0]))
    covariance[:, -1, -1] = sigma**2
    return Fitted(assignments, poses, covariance, (np.minimum(np.abs(seen.e), DOUBTED) ** 2 * used).sum(axis=1))


def _descended(model: TwoViewModel, poses: Relative, assignments: Integers, near: bool) -> tuple[Relative, Seen]:
    """Poses after some rounds of a fit, and their matches."""
    used = assignments >= 0
    fit = _Fit(model, assignments, poses.spread, np.zeros(used.shape), near)
    seen = fit.seen(poses[:4])
    for _ in range(ROUNDS):
        if near:
            poses = _scaled(poses, seen, used)
        fit = replace(fit, spread=poses.spread, weights=_doubts(seen.e, used))
        state, _ = descended(fit, poses[:4], STEPS)
        poses = _with(state, poses.spread)
        seen = fit.seen(state)
    return poses, seen


def _with(state: tuple[Floats, ...], spread: Floats) -> Relative:
    """The poses of a state of the fit."""
    turn, translation, tilt, scale = state
    return Relative(turn, translation, tilt, scale, spread)


def _doubts(e: Floats, used: NDArray[np.bool_]) -> Floats:
    """Roots (…, n) of the weights of matches with deviations e: less from `DOUBTED` on, or from medians as large."""
    middle = _middle(np.abs(e), used)[..., None]
    return np.asarray(1.0 / np.sqrt(1.0 + (e / (DOUBTED * np.maximum(middle, 1.0))) ** 2))


def _middle(values: Floats, used: NDArray[np.bool_]) -> Floats:
    """Medians (…,) of those of some values (…, n) that are used, the lower one of two; 1 without any."""
    order = np.sort(np.where(used, values, np.inf), axis=-1)
    place = (np.maximum(np.count_nonzero(used, axis=-1), 1) - 1) // 2
    middle = np.take_along_axis(order, place[..., None], axis=-1)[..., 0]
    return np.where(np.isfinite(middle), middle, 1.0)


def _scaled(poses: Relative, seen: Seen, used: NDArray[np.bool_]) -> Relative:
    """Poses with the median of the log inverse distances of their matches, and the spread about it."""
    front = np.asarray(used & (seen.ahead > 0.0) & (seen.parallax > 0.0) & (seen.r2 > 4.0 * seen.floor2), np.bool_)
    with np.errstate(all="ignore"):
        log = 0.5 * np.log(seen.r2)
    middle = np.where(front.any(axis=1), _middle(log, front), math.log(FIRST_SCALE))
    spread = np.log(1.4826 * _middle(np.abs(log - middle[:, None]), front) + np.exp(SPREADS[0] + 0.1))
    scale = np.clip(middle, SCALES[0] + 0.1, SCALES[1] - 0.1)
    return poses._replace(scale=scale, spread=np.minimum(spread, SPREADS[1] - 0.1))


def _starts(model: TwoViewModel, assignments: Integers) -> tuple[Relative, Integers]:
    """Poses of least deviation on a grid of rotations, `VALLEYS` of each assignment, and its number."""
    angle = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    u = model.first @ rotation_about_y(np.cos(angle), np.sin(angle)).swapaxes(-1, -2)
    every = []
    for one in assignments:
        own = np.flatnonzero(one >= 0)
        rows = cross(u[:, own], model.second[one[own]])
        if model.planar:
            rows = rows[..., [0, 2]]
        t = np.linalg.eigh(rows.swapaxes(-1, -2) @ rows)[1][..., 0]
        if model.planar:
            t = np.stack([t[:, 0], np.zeros(ANGLES), t[:, 1]], axis=1)
        scale, spread = np.full(ANGLES, math.log(FIRST_SCALE)), np.full(ANGLES, SPREADS[1] - 0.1)
        poses = Relative(angle, t, np.zeros((ANGLES, 2)), scale, spread)
        total = np.log1p((model.seen(poses, own, one[own]).e / DOUBTED) ** 2).sum(axis=1)
        valley = (total <= np.roll(total, 1)) & (total <= np.roll(total, -1))
        every.append(poses.take(np.argsort(np.where(valley, total, np.inf), kind="stable")[:VALLEYS]))
    return Relative.joined(every), np.repeat(np.arange(len(assignments)), VALLEYS)


@dataclass(frozen=True, eq=False)
class _Fit:
    """See `rootmatch.problems.pose_fit.descent.Model`: the pose of each of some assignments, the spread known."""

    model: TwoViewModel
    assignments: Integers
    spread: Floats
    weights: Floats
    """(K, n) roots of the weights of matches."""
    near: bool
    """Whether inverse distances count."""

    def seen(self, state: tuple[Floats, ...]) -> Seen:
        """The matches at the poses; of unmatched points anything."""
        rows = np.arange(self.assignments.shape[1])
        return self.model.seen(_with(state, self.spread), rows, np.maximum(self.assignments, 0))

    def residuals(self, state: tuple[Floats, ...]) -> Floats:
        """See `Model`."""
        seen, used = self.seen(state), self.assignments >= 0
        z = np.where(self._usable(seen), seen.z, IMPOSSIBLE) if self.near else 0.0
        weights = np.where(used, self.weights, 0.0)
        parts = [weights * seen.e, weights * z, weights * seen.behind * self.near]
        if self.model.tilt > 0.0:
            parts.append(state[2] / self.model.tilt)
        return np.concatenate(parts, axis=1)

    def jacobian(self, state: tuple[Floats, ...]) -> Floats:
        """See `Model`; how the spread of inverse distances changes with the pose is left out."""
        model, seen = self.model, self.seen(state)
        used, usable = self.assignments >= 0, self._usable(seen)
        count, n = used.shape
        weights = np.where(used, self.weights, 0.0)
        rest = 2 if model.tilt > 0.0 else 0
        out = np.zeros((count, 3 * n + rest, model.size - 1))
        t, moves = state[1][:, None], model.bases(state[1])
        axes = np.eye(3)[[1, 0, 2]] if rest else np.eye(3)[[1]]
        still = np.zeros((1, 1, 3))
        turned = [cross(axis, seen.u) for axis in axes]
        steps = [(turned[0], still), *((still, moves[:, d, None]) for d in range(moves.shape[1]))]
        steps += [(du, still) for du in turned[1:]]
        with np.errstate(all="ignore"):
            width, own = 1.0 / (seen.sine * np.sqrt(seen.across)), 1.0 / np.sqrt(seen.spread2)
            second = model.second_variance[np.maximum(self.assignments, 0)]
            by_parallax = seen.parallax / (seen.ahead * seen.ahead * seen.r2)
            damped = 1.0 - seen.floor2 / seen.r2
            for place, (du, dt) in enumerate(steps):
                dk, dpt, dpu = (
                    (du * t + dt * seen.u).sum(axis=-1),
                    (dt * seen.p).sum(axis=-1),
                    (du * seen.p).sum(axis=-1),
                )
                triple = ((cross(t, du) + cross(dt, seen.u)) * seen.p).sum(axis=-1)
                parallax = dpt - dk * seen.pu - seen.k * dpu
                ahead = dpu - dk * seen.pt - seen.k * dpt
                z = own * (by_parallax * parallax - damped * ahead / seen.ahead)
                e = triple * width + seen.e * width**2 * (second * seen.k * dk + model.first_variance * seen.pt * dpt)
                out[:, :n, place] = weights * e
                if self.near:
                    out[:, n : 2 * n, place] = weights * np.where(usable & np.isfinite(z), z, 0.0)
                    behind = np.where(seen.behind < 0.0, parallax / (seen.sine * np.sqrt(seen.noise)), 0.0)
                    out[:, 2 * n : 3 * n, place] = weights * behind
            scale = -own * np.minimum(np.exp(2.0 * state[3])[:, None] / seen.mean2, 1.0)
            out[:, n : 2 * n, -1] = weights * np.where(usable, scale, 0.0) * self.near
        for axis in range(rest):
            out[:, 3 * n + axis, 1 + moves.shape[1] + axis] = 1.0 / model.tilt
        return out

    def moved(self, state: tuple[Floats, ...], step: Floats) -> tuple[Floats, ...]:
        """See `Model`."""
        whole = np.concatenate([step, np.zeros((len(step), 1))], axis=1)
        return tuple(self.model.moved(_with(state, self.spread), whole)[:4])

    @staticmethod
    def _usable(seen: Seen) -> NDArray[np.bool_]:
        """Which matches lie in front, so that they have an inverse distance."""
        return np.asarray((seen.ahead > 0.0) & np.isfinite(seen.z))
