"""The points of a task: validated, with their noise, and as a search between two clouds or two views reads them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.frozen import copy_with, once

Indices = NDArray[np.integer]
SLACK = math.radians(10.0)
"""Added to a view angle where a pose is known from a minimal set alone: the headset of benchmarks/constellations.py at
2.5 m, where three points tell a direction to that. A round value."""


EXACT = 1e-3
"""Least deviation of a coordinate, relative to that of the others. A round value."""
ROWS = 64
"""Rows of a table of distances that are worked out together."""


OF_SOURCE = "source", "source_noise", "normals", "view_cosine", "source_covariance"
OF_TARGET = "target", "target_noise", "target_covariance", "noise_alone"
"""What `PointSets` has of each point of either set."""


@dataclass(frozen=True, eq=False)
class PointSets:
    """Validated points, made by `rootmatch.problems.base.Problem.validated`."""

    source: Floats
    """(n, 3) or (n, 2). Points in space, or pixels of the first image."""
    target: Floats
    """(n', 2) or (n', 3). Pixels, or points in space where the problem matches two sets of those."""
    source_noise: Floats
    target_noise: Floats
    """(n,) and (n',) standard deviation of each coordinate, in the unit of its set. That of an exact source is not
    used. That of detections includes what ``source_covariance`` may add in the image
    (`rootmatch.problems.noise.add_model_noise`); `detection_noise` does not."""
    normals: Floats | None = None
    """(n, 3) outward normals of the source points, zero where unknown."""
    view_cosine: Floats | None = None
    """(n,) least cosine between the normal and the direction to the camera at which each point is visible; None if no
    angle was given: 0, the rim."""
    source_covariance: Floats | None = None
    target_covariance: Floats | None = None
    """(n, k, k) and (n', k, k). Where they say more than the noise: of points in space that are not exact, or of points
    and detections whose noise is not the same on all axes."""
    noise_alone: Floats | None = None
    """(n',) ``target_noise`` without what that adds."""

    @property
    def detection_noise(self) -> Floats:
        """Standard deviations (n',) of the detections alone."""
        return self.target_noise if self.noise_alone is None else self.noise_alone

    @property
    def has_covariances(self) -> bool:
        """Whether covariances say more than the noise, of either set."""
        return self.source_covariance is not None or self.target_covariance is not None

    def covariances_of(self, target: Indices) -> Floats:
        """Covariances (…, k, k) of some (…) detections alone."""
        if self.target_covariance is not None:
            return self.target_covariance[target]
        k = self.target.shape[1]
        return np.asarray(self.detection_noise[target][..., None, None] ** 2 * np.eye(k))

    @property
    def widest_noise(self) -> Floats:
        """Standard deviations (n',) along the widest axis of each detection."""
        if self.target_covariance is None:
            return self.target_noise
        own = np.linalg.eigvalsh(self.target_covariance)[:, -1]
        return np.asarray(np.sqrt(own + self.target_noise**2 - self.detection_noise**2))

    @once
    def shape(self) -> tuple[int, int]:
        """Number of source and target points, (n, n')."""
        return len(self.source), len(self.target)

    def subset(self, source: Indices | None = None, target: Indices | None = None) -> PointSets:
        """A subset of the points, in the order of the indices; None for all, in the same arrays."""
        some = dict[str, Floats]()
        for names, which in (OF_SOURCE, source), (OF_TARGET, target):
            if which is not None:
                some |= {name: one[which] for name in names if (one := getattr(self, name)) is not None}
        return copy_with(self, **some)


class CheckedSource(NamedTuple):
    """Source points that were checked, with what is known of each."""

    points: Floats
    """(n, k)."""
    normals: Floats | None
    """(n, 3)."""
    view_cosine: Floats | None
    """(n,) cosines of the view angles."""


class PointClouds(NamedTuple):
    """Two point sets of one space: points x and x' = scale · R x + t, both noisy."""

    source: Floats
    """(n, k) points, k = 2 or 3."""
    target: Floats
    """(n', k) points."""
    source_variance: Floats
    """(n,) variance of a coordinate."""
    target_variance: Floats
    """(n',) variance of a coordinate."""
    scaled: bool
    """Whether the scale is unknown; 1 otherwise."""
    mirror: bool
    """Whether R may be a reflection: in a plane, where that is asked for."""
    source_covariance: Floats | None = None
    """(n, k, k), if axes differ in noise; the variance of a coordinate is then the mean."""
    target_covariance: Floats | None = None
    """(n', k, k), likewise."""

    @property
    def has_covariances(self) -> bool:
        """Whether axes differ in noise, of either set."""
        return self.source_covariance is not None or self.target_covariance is not None

    @property
    def with_means(self) -> PointClouds:
        """The same with the mean noise of the axes, as searches take it."""
        return self._replace(source_covariance=None, target_covariance=None)

    def off_by(self, width: Floats) -> PointClouds:
        """The same with source points that deviate by so much (n,) more, along each axis."""
        known, more = self.source_covariance, width[:, None, None] ** 2 * np.eye(self.source.shape[1])
        return self._replace(
            source_variance=self.source_variance + width**2,
            source_covariance=None if known is None else known + more,
        )

    def covariances(self, linear: Floats) -> tuple[Floats, Floats]:
        """Covariances (…, n, k, k) of source points, as motions (…, k, k), scale · R, turn them, and of targets.

        An exact coordinate has a millionth of the noise of the others.
        """
        unit = np.eye(self.source.shape[1])
        first, second = (
            variance[:, None, None] * unit if known is None else known
            for known, variance in (
                (self.source_covariance, self.source_variance),
                (self.target_covariance, self.target_variance),
            )
        )
        linear = linear[..., None, :, :]
        return linear @ first @ linear.swapaxes(-1, -2), second + EXACT**2 * self.target_variance[:, None, None] * unit


class TwoViews(NamedTuple):
    """Bearings of two calibrated images, each rotated so that their common direction is y.

    A bearing q of the first and p of the second image of one point fulfil λ' p = λ R(θ) q + b t, with distances
    λ, λ' > 0, a rotation about y and a baseline of length b along the unit vector t.
    """

    source: Floats
    """(3, n) unit bearings of the first image."""
    target: Floats
    """(3, n') unit bearings of the second image."""
    source_variance: Floats
    """(n,) variance of a bearing, radians² on each axis across it; that of the direction is part of it."""
    target_variance: Floats
    """(n',) variance of a bearing on each axis, without that of the direction."""
    planar: bool
    """Whether the baseline is known to be across the common direction."""


def normals_with_cosines(points: PointSets, rotation: Floats | None = None) -> Floats:
    """Normals and least cosines (4, n) for the kernels, the normals rotated if asked; zero where none are known.

    The cosines are those of the view angle and `SLACK`: a minimal set knows the directions of normals that well.
    """
    rows = np.zeros((4, len(points.source)))
    if points.normals is not None:
        length = np.linalg.norm(points.normals, axis=1)
        unit = points.normals / np.where(length > 0.0, length, 1.0)[:, None]
        rows[:3] = (unit if rotation is None else unit @ rotation.T).T
        if points.view_cosine is not None:
            widened = np.minimum(np.arccos(points.view_cosine) + SLACK, np.pi)
            rows[3] = np.where(length > 0.0, np.cos(widened), 0.0)
    return rows


def squared_distances(points: Floats) -> Floats:
    """(n, n) squared distances of points (n, k), each from its own difference, so that close points lose nothing."""
    squared: Floats = np.zeros((len(points), len(points)))
    coordinates = np.ascontiguousarray(points.T)
    for first in range(0, len(points), ROWS):  # some at a time, which stay in the processor's cache
        checkpoint()
        rows = squared[first : first + ROWS]
        for coordinate in coordinates:  # one by one: no array of n × n × k
            difference = coordinate[first : first + ROWS, None] - coordinate
            difference *= difference
            rows += difference
    return squared


def pairwise_squared_distances(points: Floats, others: Floats) -> Floats:
    """(H, n, n') squared distances of points (H, n, k) from others (n', k), quick, about the centre of the others."""
    centre = others.mean(axis=0)
    first, second = points - centre, others - centre
    squared = (first**2).sum(axis=-1)[..., None] - 2.0 * first @ second.T + (second**2).sum(axis=-1)
    return np.asarray(np.maximum(squared, 0.0))


def mutual_nearest(away: Floats, gate: float = np.inf) -> Integers:
    """The column (…, n) of each row of distances (…, n, n'), the nearest of both and within a gate; −1 for none."""
    to = away.argmin(axis=-1)
    mutual = np.take_along_axis(away.argmin(axis=-2), to, axis=-1) == np.arange(away.shape[-2])
    return np.where(mutual & (np.take_along_axis(away, to[..., None], axis=-1)[..., 0] < gate), to, -1)


def distances(points: Floats) -> Floats:
    """(n, n) distances of points (n, k)."""
    squared = squared_distances(points)
    return np.sqrt(squared, out=squared)
