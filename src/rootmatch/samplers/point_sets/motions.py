"""Motions between matched points, many at once, and how well they suit all points (NumPy)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats
from rootmatch.problems.points import PointClouds, pairwise_squared_distances
from rootmatch.samplers.point_sets.kernels import fill_triangle_motions

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


def fit_triangles(source: Floats, target: Floats, scaled: bool, mirror: bool) -> Motions:
    """The same of triangles (H, 3, k), whose planes tell it without a decomposition, unless it may be a reflection."""
    if mirror:
        return fit_motions(source, target, scaled, mirror)
    count, dimension = len(source), source.shape[2]
    linear, shift, scale = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty(count)
    fill_triangle_motions(in_space(source), in_space(target), scaled, dimension == 2, (linear, shift, scale))
    return Motions(linear[:, :dimension, :dimension], shift[:, :dimension], scale)


def in_space(values: Floats) -> Floats:
    """Points (n, k), or linear maps (H, k, k), with a third coordinate that is 0, contiguous."""
    if values.shape[-1] == 3:
        return np.ascontiguousarray(values)
    whole = np.zeros((*(3 if size == 2 and axis else size for axis, size in enumerate(values.shape)),))
    whole[tuple(slice(size) for size in values.shape)] = values
    return whole
