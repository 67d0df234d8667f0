"""Alignment of densities: poses from a grid of rotations, climbing a likelihood of the image whose blur shrinks.

Detections are a Poisson process: clutter, and a Gaussian about the image of each point. That needs no pairs, so it
works where the prediction of a minimal set is vaguer than the detections are dense and no count of inliers tells poses
apart. Each step is one of expectation maximisation, as in Coherent Point Drift (Myronenko and Song, 2010): a point is
drawn to the mean of its detections. A wide blur leads from far away, the last one is the noise itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import spread_rotations
from rootmatch.arrays import Floats
from rootmatch.jit.threads import run_in_pieces
from rootmatch.samplers.densities.descent_kernels import ascend


class Level(NamedTuple):
    """One blur of the image, from coarse to fine."""

    blur: float
    """Standard deviation, in units of the root mean square distance of the body's detections from their centre."""
    steps: int
    kept: int
    """Poses that go on to the next level."""
    points: int
    """Most points that are projected."""


LEVELS = (
    Level(0.23, 4, 1500, 150),
    Level(0.16, 4, 600, 300),
    Level(0.09, 6, 200, 1000),
    Level(0.045, 6, 60, 1000),
    Level(0.0, 6, 20, 1000),
)
"""All 72 scenes of `rootmatch benchmark blind`, *surface*, seeds 1000-1011, are right with these; not tuned further."""
ROTATIONS = 4600
"""Rotations of the grid, some 15 degrees apart."""
MIN_POSES, POSES_CELLS = 8, 20_000_000
"""Poses that climb on every level at least, and those that do at most, times the cells of the image: a second or two. A
body that is 230 times as large as the noise has three million cells, and 60 poses of it took 15 s. Round values."""
FALSE = 0.05
"""Least share of the detections that is clutter."""
CELLS = 1.2
"""Cells of the image for one standard deviation of the blur."""
SPREAD = 3.0
"""Standard deviations of the body's detections that the image extends to."""
ROUNDS = 40
"""Of expectation maximisation, for the body's place in the image."""


@dataclass(frozen=True, eq=False)
class Blob:
    """Where in the image the body is, as a Gaussian among uniform clutter."""

    mean: Floats
    """(2,)."""
    covariance: Floats
    """(2, 2)."""
    area: float
    """Of the smallest rectangle of all detections."""

    @classmethod
    def of(cls, detections: Floats, sigma: float, expected: int) -> Blob:
        """The blob of so many of the detections (n', 2), two or more, whose standard deviation is ``sigma``."""
        share, noise = min(expected / len(detections), 1.0), sigma**2 * np.eye(2)
        area = float(np.prod(np.ptp(detections, axis=0) + sigma))
        mean, covariance = np.median(detections, axis=0), np.cov(detections.T) + noise
        for _ in range(ROUNDS if share < 1.0 else 1):
            away = detections - mean
            squared = np.einsum("ij,jk,ik->i", away, np.linalg.inv(covariance), away)
            density = share * np.exp(-0.5 * squared) / (2.0 * math.pi * math.sqrt(np.linalg.det(covariance)))
            own = density / (density + (1.0 - share) / area) if share < 1.0 else np.ones(len(detections))
            mean = own @ detections / own.sum()
            away = detections - mean
            covariance = (away.T * own) @ away / own.sum() + noise
        return cls(mean, covariance, area)


class Aligned(NamedTuple):
    """K poses, the most likely first."""

    rotation: Floats
    """(K, 3, 3)."""
    position: Floats
    """(K, 3) of the body's centre in the camera frame."""


def align_densities(points: Floats, detections: Floats, sigma: float, *, rng: np.random.Generator) -> Aligned:
    """Poses at which the projected points are as dense as the detections.

    Parameters
    ----------
    points : (n, 3) array
        From the centre of the body.
    detections : (n', 2) array
        In units of the focal length.
    sigma : float
        Their standard deviation.
    rng : numpy.random.Generator
        Tells which points are projected where not all are.

    Raises
    ------
    OutOfTime
        If the deadline in force passes.
    """
    points = rng.permutation(points)
    blob = Blob.of(detections, sigma, len(points))
    found = _starts(points, blob)
    size = math.sqrt(0.5 * float(np.trace(blob.covariance)))
    false = max(len(detections) - len(points), FALSE * len(detections)) / blob.area
    for level in LEVELS:
        blur = math.hypot(level.blur * size, sigma)
        found = _climb_level(points, detections, found, blob, blur=blur, false=false, level=level)
        found = _distinct_poses(found, level.kept, math.radians(max(20.0 * level.blur, 0.5)))
    return found


def _starts(points: Floats, blob: Blob) -> Aligned:
    """Poses of the grid at which mean and spread of the image are those of the blob."""
    rotation = np.ascontiguousarray(spread_rotations(ROTATIONS))
    flat = rotation[:, :2] @ (points.T @ points / len(points)) @ rotation[:, :2].swapaxes(1, 2)
    depth = np.sqrt(np.trace(flat, axis1=1, axis2=2) / np.trace(blob.covariance))
    ray = np.append(blob.mean, 1.0)
    # the grid is one of rotations as seen along the line of sight
    along, axis = ray / np.linalg.norm(ray), np.array([0.0, 0.0, 1.0])
    half = (along + axis) / np.linalg.norm(along + axis)
    onto = (2.0 * np.outer(half, half) - np.eye(3)) @ (2.0 * np.outer(axis, axis) - np.eye(3))
    return Aligned(onto @ rotation, depth[:, None] * ray)


def _climb_level(
    points: Floats, detections: Floats, starts: Aligned, blob: Blob, *, blur: float, false: float, level: Level
) -> Aligned:
    """Poses after the steps of one level, the most likely first."""
    cell, some = blur / CELLS, np.ascontiguousarray(points[: level.points])
    half = SPREAD * np.sqrt(np.diag(blob.covariance))
    origin = blob.mean - half
    w, h = np.ceil(2.0 * half / cell).astype(int) + 2
    image = histogram(detections, origin, cell, (h, w))
    deviation = math.sqrt(CELLS**2 - 1.0 / 3.0)  # to share points among cells is a blur itself, as are they
    reach = math.ceil(3.0 * deviation)
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    maximum = max(POSES_CELLS // image.size, MIN_POSES)
    rotation, position = starts.rotation[:maximum].copy(), starts.position[:maximum].copy()
    likelihood = np.empty(len(rotation))

    def climb(first: int, last: int) -> None:
        own = slice(first, last)
        ascend(
            some, rotation[own], position[own], image, origin, cell, taps / taps.sum(), deviation**2,
            false * cell**2 * len(some) / len(points), level.steps, likelihood[own],
        )  # fmt: skip

    run_in_pieces(climb, len(rotation))
    order = np.argsort(-likelihood, kind="stable")
    order = order[np.isfinite(likelihood[order]) & (position[order, 2] > 0.0)]
    return Aligned(rotation[order], position[order])


def histogram(detections: Floats, origin: Floats, cell: float, shape: tuple[int, int]) -> Floats:
    """Detections (n', 2) per cell of an image (h, w), each shared among the four cells about it."""
    place = (detections - origin) / cell
    corner = np.floor(place).astype(np.int64)
    inside = np.all((corner >= 0) & (corner < np.array(shape[::-1]) - 1), axis=1)
    corner, part, image = corner[inside], (place - corner)[inside], np.zeros(shape)
    for a in (0, 1):
        for b in (0, 1):
            share = np.abs(1 - a - part[:, 0]) * np.abs(1 - b - part[:, 1])
            np.add.at(image, (corner[:, 1] + b, corner[:, 0] + a), share)
    return image


def _distinct_poses(found: Aligned, maximum: int, angle: float) -> Aligned:
    """The first poses whose rotations differ by more than an angle in radians; the rest are met again anyway."""
    kept: list[int] = []
    nearest = 1.0 + 2.0 * math.cos(angle)  # trace of their relative rotation
    flat = found.rotation.reshape(-1, 9)
    for k in range(len(flat)):
        if len(kept) == maximum:
            break
        if not kept or float((flat[kept] @ flat[k]).max()) <= nearest:
            kept.append(k)
    return Aligned(*(part[kept] for part in found))
