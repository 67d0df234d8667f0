"""Motions between matched points, many at once, and how well they suit all points (NumPy)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.problems.points import PointClouds, pairwise_squared_distances

WIDE = 8.0
"""Deviation in σ within which a point counts for the motion of a triple, whose own error it covers too."""


class Motions(NamedTuple):
    """H motions x' = A x + t, A = scale · R."""

    linear: Floats
    """(H, k, k)."""
    shift: Floats
    """(H, k)."""
    scale: Floats
    """(H,)."""

    def take(self, which: NDArray[np.integer] | slice) -> Motions:
        """A subset of these motions."""
        return Motions(self.linear[which], self.shift[which], self.scale[which])

    def squares(self, clouds: PointClouds) -> tuple[Floats, Floats]:
        """Squared distances (H, n, n') of targets from moved source points, and variances of a coordinate of these."""
        moved = clouds.source @ self.linear.swapaxes(-1, -2) + self.shift[:, None]
        variance = (self.scale**2)[:, None, None] * clouds.source_variance[:, None] + clouds.target_variance
        return pairwise_squared_distances(moved, clouds.target), variance

    def explained(self, clouds: PointClouds, gate: float, allowed: Bools | None) -> Integers:
        """How many points (H,) of the set with fewer of them are within a gate in σ of one of the other set."""
        centre = clouds.target.mean(axis=0)
        moved = clouds.source @ self.linear.swapaxes(-1, -2) + (self.shift - centre)[:, None]
        seen = clouds.target - centre
        # the gate less the squared distance, half of it, is one product: |x|² + |y|² − 2 x·y and both variances
        own = 0.5 * (gate**2 * (self.scale**2)[:, None] * clouds.source_variance - (moved**2).sum(axis=-1))
        other = 0.5 * (gate**2 * clouds.target_variance - (seen**2).sum(axis=-1))
        first = np.concatenate([moved, own[..., None], np.ones((*own.shape, 1))], axis=-1)
        second = np.concatenate([seen, np.ones((len(seen), 1)), other[:, None]], axis=-1)
        close = first @ second.T >= 0.0
        if allowed is not None:
            close &= allowed
        return np.asarray(np.minimum(close.any(axis=2).sum(axis=1), close.any(axis=1).sum(axis=1)))


def concatenate_motions(parts: Sequence[Motions]) -> Motions:
    """Several motions as one."""
    return Motions._make(np.concatenate(each) for each in zip(*parts, strict=True))


def fit_motions(source: Floats, target: Floats, scaled: bool, mirror: bool, weight: Floats | None = None) -> Motions:
    """Least-squares motions of points (H, m, k) onto points (H, m, k), with weights (H, m) if any (Umeyama 1991)."""
    share = np.full(source.shape[:2], 1.0 / source.shape[1])
    if weight is not None:
        share = weight / weight.sum(axis=1, keepdims=True)
    centre, centre2 = (np.einsum("hm,hmk->hk", share, points) for points in (source, target))
    first, second = source - centre[:, None], target - centre2[:, None]
    u, values, vt = np.linalg.svd(np.einsum("hmi,hmj->hij", second * share[..., None], first))
    signs = np.ones(values.shape)
    if not mirror:
        signs[:, -1] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = (u * signs[:, None]) @ vt
    scale = np.ones(len(source))
    if scaled:
        spread = np.einsum("hm,hmk->h", share, first**2)
        scale = (values * signs).sum(axis=1) / np.maximum(spread, 1e-300)
    linear = scale[:, None, None] * rotation
    return Motions(linear, centre2 - np.einsum("hij,hj->hi", linear, centre), scale)
