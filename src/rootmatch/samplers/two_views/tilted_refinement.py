"""Refinement of relative poses on all points where the common direction was measured: its two tilts are free.

A minimal set takes the direction for exact, so its pose fits no better than the direction is known. Here the tilts have
their prior, and what a pose's error adds to the noise shrinks, from that of the direction to the share of the bearings'
own noise with which `rootmatch.samplers.two_views.pose_refinement` ends. Expectation maximisation, as there.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple, Self

import numpy as np

from rootmatch.algebra.directions import tangent_bases
from rootmatch.algebra.rotation import cross, rotation_about_y, rotation_from_vector
from rootmatch.arrays import Floats
from rootmatch.problems.points import TwoViews
from rootmatch.samplers.two_views.likelihood import BEHIND2, BLUNT, NORMALISED, SUPPORT
from rootmatch.samplers.two_views.pose_refinement import DAMPING, LEAST_SHARE

SHRINKS = 4.0
"""Factor between what a pose's error adds in one step and in the next."""
LONGEST_STEP = 1.0
"""Radians, and logarithm of the scale. As of the refinement with an exact direction."""

DIMENSIONS = 6
"""Rotation about the direction, two tilts, two directions across the baseline, scale."""


class Tilted(NamedTuple):
    """K relative poses whose common direction is not exact."""

    turn: Floats
    """(K,) rotation about y, radians."""
    tilt: Floats
    """(K, 2) turns about x and z after that."""
    translation: Floats
    """(K, 3) unit baselines."""
    level: Floats
    """(K,) logarithm of the scale of the inverse distances."""

    @property
    def rotation(self) -> Floats:
        """(K, 3, 3)."""
        return np.asarray(_tilts(self.tilt) @ rotation_about_y(np.cos(self.turn), np.sin(self.turn)))

    @classmethod
    def of_sets(cls, poses: Floats, tilt: Floats) -> Self:
        """Poses (K, FIELDS) of minimal sets that took tilts (K, 2), as by `turned_views`."""
        translation = (_tilts(tilt) @ poses[:, 2:5, None])[..., 0]
        return cls(np.arctan2(poses[:, 1], poses[:, 0]), tilt, translation, np.log(poses[:, 5]))


def turned_views(views: TwoViews, tilt: Floats) -> TwoViews:
    """Views whose common direction is tilted (2,), with bearings of the second one as if it were not."""
    return views._replace(target=np.ascontiguousarray(_tilts(tilt[None])[0].T @ views.target))


def refine_tilted(
    views: TwoViews,
    judge: tuple[Floats, Floats],
    at: Tilted,
    *,
    tilt2: float,
    blurs: tuple[float, float],
    breadth2: float,
) -> tuple[Floats, Floats]:
    """Likelihood ratios (K, n, n') of all pairs at poses, refined with tilts of variance ``tilt2``, and those (K, 2).

    ``views``: bearings with their own noise alone; ``judge``: 1 over densities of clutter (n',), and possible pairs;
    ``blurs``: variance that a pose's error adds at first, and in the end.
    """
    first, last = blurs
    steps = math.ceil(math.log(first / last) / math.log(SHRINKS))
    for blur in (*np.geomspace(first, last, steps + 1), last):
        at = _step(views, judge, at, tilt2=tilt2, blur=blur, breadth2=breadth2)
    return _ratios(views, judge, last, at)[0], at.tilt


def _ratios(views: TwoViews, judge: tuple[Floats, Floats], blur: float, at: Tilted) -> tuple[Floats, Floats]:
    """Likelihood ratios (K, n, n') of all pairs as of `likelihood.likelihood_ratio`, and bearings u (K, n, 3)."""
    own = views.source_variance[:, None] + views.target_variance
    t, p = at.translation[:, None], views.target
    u = np.asarray(views.source.T @ at.rotation.swapaxes(-1, -2))
    k = _dot(u, t)[..., None]
    sine2 = np.maximum(1.0 - k * k, 1e-12)
    e = (cross(t, u) / np.sqrt(sine2)) @ p
    parallax, ahead = (t - k * u) @ p, (u - k * t) @ p
    noise = own * sine2
    weight = 1.0 / (own + blur)
    g = np.maximum(1.0 - e * e * weight / SUPPORT, 0.0) ** 4
    g *= judge[1] * ((ahead > 0.0) & ((parallax > 0.0) | (parallax * parallax < BEHIND2 * noise)))
    rows = np.nonzero(g)
    ratios = np.zeros_like(g)
    inverse = np.exp(-at.level)[rows[0]]
    pair, point = rows[1:], rows[:2]
    a2 = ahead[rows] ** 2
    r2 = (parallax[rows] ** 2 + noise[rows]) / a2 * inverse**2
    h = 4.0 * r2 * np.sqrt(r2) * inverse * sine2[*point, 0] ** 1.5 / ((1.0 + r2 * r2) ** 2 * a2)
    h = h / (1.0 + BLUNT * h * np.sqrt(own[pair]))
    ratios[rows] = g[rows] * np.sqrt(weight[pair]) * h * NORMALISED * judge[0][rows[2]]
    return ratios, u


def _step(
    views: TwoViews, judge: tuple[Floats, Floats], at: Tilted, *, tilt2: float, blur: float, breadth2: float
) -> Tilted:
    """Poses moved once, by pairs with their shares of the ratios, as `pose_refinement.refinement_step` does."""
    ratios, every = _ratios(views, judge, blur, at)
    shares = ratios / (1.0 + ratios.sum(axis=2, keepdims=True) + ratios.sum(axis=1, keepdims=True) - ratios)
    poses, points, detections = np.nonzero(shares >= LEAST_SHARE)
    share = shares[poses, points, detections]
    own = views.source_variance[points] + views.target_variance[detections]
    u, p, t = every[poses, points], views.target.T[detections], at.translation[poses]
    bases = np.stack(tangent_bases(at.translation), axis=1)
    k, pu, pt = _dot(t, u), _dot(p, u), _dot(p, t)
    sine2 = np.maximum(1.0 - k * k, 1e-12)
    parallax, ahead = pt - k * pu, np.maximum(pu - k * pt, 1e-12)
    noise = own * sine2
    root = parallax**2 + noise
    by_parallax, by_ahead = parallax / root, 1.0 / ahead
    e = _dot(cross(t, u), p) / np.sqrt(sine2)
    z = 0.5 * np.log(root) - np.log(ahead) - at.level[poses]
    rows = np.zeros((2, len(poses), DIMENSIONS + 1))  # and the deviations
    for axis, place in enumerate((1, 0, 2)):  # about y first
        turned = cross(np.eye(3)[place], u)
        dk, dpu = _dot(t, turned), _dot(p, turned)
        rows[0, :, axis] = _dot(t, cross(turned, p)) / np.sqrt(sine2)
        rows[1, :, axis] = by_parallax * (-dk * pu - k * dpu) - by_ahead * (dpu - dk * pt)
    product = cross(u, p)
    for d in range(2):
        move = bases[poses, d]
        f, g = _dot(move, u), _dot(move, p)
        rows[0, :, 3 + d] = _dot(move, product) / np.sqrt(sine2)
        rows[1, :, 3 + d] = by_parallax * (g - f * pu) - by_ahead * (-f * pt - k * g)
    rows[1, :, -2] = -1.0
    rows[..., -1] = e, z
    rows *= np.sqrt(share / np.stack([own + blur, breadth2 + noise * by_parallax**2]))[..., None]
    ends = np.searchsorted(poses, np.arange(len(at.turn) + 1))
    parts = [rows[:, a:b].reshape(-1, DIMENSIONS + 1) for a, b in itertools.pairwise(ends)]
    squares = np.stack([part.T @ part for part in parts])
    normal, side = squares[:, :-1, :-1], squares[:, :-1, -1]
    normal[:, [1, 2], [1, 2]] += 1.0 / tilt2
    side[:, 1:3] += at.tilt / tilt2
    normal += np.eye(DIMENSIONS) * (DAMPING * normal + 1e-300)
    step = np.linalg.solve(normal, -side[..., None])[..., 0]
    largest = np.abs(step).max(axis=1, keepdims=True)
    step = np.where(largest < 1e6, step / np.maximum(largest / LONGEST_STEP, 1.0), 0.0)
    moved = at.translation + (step[:, 3:-1, None] * bases).sum(axis=1)
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    return Tilted(at.turn + step[:, 0], at.tilt + step[:, 1:3], moved, at.level + step[:, -1])


def _tilts(tilt: Floats) -> Floats:
    """Rotations (K, 3, 3) by tilts (K, 2)."""
    return np.asarray(rotation_from_vector(np.stack([tilt[:, 0], np.zeros(len(tilt)), tilt[:, 1]], axis=1)))


def _dot(first: Floats, second: Floats) -> Floats:
    """Products (…,) of vectors (…, 3)."""
    return np.asarray(np.einsum("...i,...i->...", first, second))
