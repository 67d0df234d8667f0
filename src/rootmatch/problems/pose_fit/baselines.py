"""Baselines all around, for two cameras that hardly moved: then any of them may be right.

The rotation is well known then and the baseline is not, χ² has several minima, and (Jᵀ J)⁻¹ at one of them says nothing
of the others.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rootmatch.algebra.rotation import rotation_vector
from rootmatch.arrays import Bools, Floats
from rootmatch.problems.pose_fit.descent import DELTA, State, regularise_normal, sum_of_squares

AROUND = 192
"""Directions all around, about 15° apart. Not tuned."""
TURNS = 3
"""Steps of the rotation at each of them. Not tuned: it is nearly linear where it matters."""
LARGEST = 0.1
"""Of these, in radians. Not tuned."""
NEGLIGIBLE = 30.0
"""Excess of χ² from which a direction counts for nothing: 3e-7."""


def baseline_directions(planar: bool) -> Floats:
    """Directions (D, 3) of a baseline or its opposite, at most 55° from any: axes and diagonals."""
    every = np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0], [1, 1, 1], [1, 1, -1], [1, -1, 1], [1, -1, -1]], np.float64)
    if planar:
        every = np.array([[1, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, -1]], np.float64)
    return np.asarray(every / np.linalg.norm(every, axis=1, keepdims=True))


def rotation_alone(first: Floats, second: Floats, used: Bools) -> Floats:
    """Angle (K,) about y that turns bearings (n, 3) best onto those of their matches (K, n, 3)."""
    x, z = first[:, 0], first[:, 2]
    sine, cosine = z * second[..., 0] - x * second[..., 2], x * second[..., 0] + z * second[..., 2]
    return np.asarray(np.arctan2(np.where(used, sine, 0.0).sum(axis=1), np.where(used, cosine, 0.0).sum(axis=1)))


def add_far_baselines(model: Any, state: State, lowest: float, covariance: Floats) -> Floats:
    """Second moments (p, p) of steps from a pose, with those to baselines far from it that fit as well.

    By quadrature over `AROUND` directions, each with the rotations about the one that fits it best. Steps to far
    baselines are their angles from t.

    Parameters
    ----------
    model : Model
        Of one relative pose, with its ``views``, and whether it is ``planar``.
    state : State
        Its rotation and baseline, t.
    lowest : float
        χ² and all else that counts there.
    covariance : (p, p) array
        Second moments of steps to baselines nearby.
    """
    ways, size = _directions_around(model.planar), model.size
    flat = 1 if model.planar else 2
    turning = np.array([0, *range(1 + flat, size)])
    many, around = model.repeated(len(ways)), (np.repeat(state[0], len(ways), axis=0), ways)
    signs = np.zeros((2 * len(turning), size))
    signs[np.arange(2 * len(turning)), np.tile(turning, 2)] = np.repeat([1.0, -1.0], len(turning))
    for _ in range(TURNS):
        beside, moved = many.moved_by(around, np.tile(DELTA * signs, (len(ways), 1)))
        values = beside.residuals(moved).reshape(len(ways), 2, len(turning), -1)
        jacobian = (values[:, 0] - values[:, 1]) / (2.0 * DELTA)
        normal = regularise_normal(jacobian @ jacobian.swapaxes(-1, -2))
        step = np.zeros((len(ways), size))
        side = jacobian @ many.residuals(around)[..., None]
        step[:, turning] = -np.linalg.solve(normal, side)[..., 0]
        around = many.moved(around, np.clip(step, -LARGEST, LARGEST))
    cost = sum_of_squares(many.residuals(around)) + 2.0 * (many.hidden(around) + many.widths(around)) - lowest
    steps = _steps_between(model, state, around, turning)
    distance2 = (steps * np.linalg.solve(covariance, steps.T).T).sum(axis=1)
    far = np.flatnonzero((cost < NEGLIGIBLE) & (distance2 > 4.0 + size) & (distance2 > np.maximum(cost, 0.0)))
    if not len(far):
        return covariance
    area = (2.0 * math.pi if model.planar else 4.0 * math.pi) / len(ways)
    log = -0.5 * cost[far] - 0.5 * np.linalg.slogdet(normal[far])[1] + math.log(area)
    near = 0.5 * flat * math.log(2.0 * math.pi) + 0.5 * np.linalg.slogdet(covariance)[1]
    weight = np.exp(log - near)
    share = weight / (1.0 + weight.sum())
    moments = (1.0 - share.sum()) * covariance + steps[far].T @ (share[:, None] * steps[far])
    moments[np.ix_(turning, turning)] += np.einsum("k,kab->ab", share, np.linalg.inv(normal[far]))
    return np.asarray(moments if np.all(np.isfinite(moments)) else covariance)


def _directions_around(planar: bool) -> Floats:
    """Directions (`AROUND`, 3), each of about the same area, or of the same angle across y."""
    count = np.arange(AROUND) + 0.5
    angle = (2.0 / AROUND if planar else 3.0 - math.sqrt(5.0)) * math.pi * count
    height = np.zeros(AROUND) if planar else 1.0 - 2.0 * count / AROUND
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], axis=1)


def _steps_between(model: Any, state: State, others: State, turning: Any) -> Floats:
    """Steps (S, p) from a pose to others, those of the baseline by its angle."""
    turn, moves = model.directions(state[1])
    steps = np.zeros((len(others[1]), model.size))
    steps[:, turning] = rotation_vector(others[0] @ state[0][0].T) @ turn[turning].T
    along = others[1] @ moves[0].T
    sine = np.linalg.norm(along, axis=1, keepdims=True)
    angle = np.arctan2(sine, (others[1] @ state[1][0])[:, None])
    return np.asarray(steps + along * angle / np.maximum(sine, 1e-9))
