"""Blobs: points of a body whose images are too close for the detector are one detection.

In each pose the points that it shows are joined if their images are nearer to each other than the detector resolves,
and if others lie between them (single linkage, as touching spots of light are joined). The first point of a blob stands
for it; the others are as good as hidden, so that nothing counts against a pose for not showing them.

A blob is detected at the mean of those of its m points that are lit, each with a probability q. That mean is taken to
be normal: about Σ q p / Σ q, with the variance (1 − q̄) Σ q ‖p − mean‖² / ((m − 1) Σ q) in each coordinate. Where all
points are lit equally, that is a tenth more than the variance of the mixture. Where it is detected also tells which of
its points is lit, and where that point alone would have been detected.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.pose import Pose

if TYPE_CHECKING:
    from rootmatch.model.detection_model import DetectionModel

ENTRIES = 2_000_000
"""Distances that are computed at once: some tens of megabytes."""


def find_blobs(pixels: Floats, shown: Bools, resolution: float) -> Integers | None:
    """The first point of the blob that each point is part of, in each of K images.

    Parameters
    ----------
    pixels : (K, n, 2) array
        Images of the points.
    shown : (K, n) bool array
        Which of them the image may show; the others are blobs by themselves.
    resolution : float
        Distance below which two images are joined, in the unit of the pixels.

    Returns
    -------
    (K, n) int64 array or None
        None if every blob is a single point.
    """
    count, n = shown.shape
    out, several = np.tile(np.arange(n), (count, 1)), False
    step = max(ENTRIES // max(n * n, 1), 1)
    for first in range(0, count, step):
        part = slice(first, first + step)
        offset = pixels[part, :, None] - pixels[part, None]
        near = (offset**2).sum(axis=-1) < resolution**2
        near &= shown[part, :, None] & shown[part, None]
        (rows,) = np.nonzero(near.sum(axis=(1, 2)) > shown[part].sum(axis=1))
        if len(rows):
            several = True
            out[first + rows] = _connected_components(near[rows])
    return out if several else None


def _connected_components(near: Bools) -> Integers:
    """The lowest index that each point (K, n) is linked with, by links (K, n, n), over others where need be."""
    count, n = near.shape[:2]
    label = np.tile(np.arange(n), (count, 1))
    while True:
        lowest = np.minimum(label, np.where(near, label[:, None], n).min(axis=2))
        lowest = np.take_along_axis(lowest, lowest, axis=1)  # what the lowest is linked with by now
        if np.array_equal(lowest, label):
            return label
        label = lowest


def average_blobs(blob: Integers, values: Floats, lit: Floats) -> Floats:
    """Values (K, n, …) of points, each replaced by the mean over its blob (K, n), weighted by ``lit`` (K, n) > 0."""
    weight = lit.reshape(*lit.shape, *[1] * (values.ndim - 2))
    mean = _sum_over_blobs(blob, weight * values) / _sum_over_blobs(blob, weight)
    alone = (np.bincount(_flat_labels(blob), minlength=blob.size)[_flat_labels(blob)] == 1).reshape(weight.shape)
    return np.asarray(np.where(alone, values, mean))


def blob_variance_of(blob: Integers, pixels: Floats, lit: Floats) -> Floats:
    """Variance (K, n) of each coordinate of a blob about its mean, by which of its points are lit."""
    off = ((pixels - average_blobs(blob, pixels, lit)) ** 2).sum(axis=-1)
    total = _sum_over_blobs(blob, lit)
    dark = _sum_over_blobs(blob, lit * (1.0 - lit)) / total
    others = np.maximum(_sum_over_blobs(blob, np.ones_like(lit)) - 1.0, 1.0)
    return np.asarray(dark * _sum_over_blobs(blob, lit * off) / (others * total))


def assign_blobs(assignments: Integers, blob: Integers) -> Integers:
    """Assignments (K, n) in which the first point of a blob (K, n) has the detection of any of its points.

    If several of its points have one, that of the first of them stays.
    """
    own = blob == np.arange(assignments.shape[1])
    out = np.where(own, assignments, -1)
    for k, i in zip(*np.nonzero((assignments >= 0) & ~own), strict=True):
        if out[k, blob[k, i]] < 0:
            out[k, blob[k, i]] = assignments[k, i]
    return out


def lit_probabilities(pixels: Floats, lit: Floats, detection: Floats, variance: float) -> Floats:
    """Chance (m,) that each point of a blob is lit, by where the blob is detected.

    ``pixels`` (m, 2): images of the points; ``lit`` (m,): chance of each without that; ``detection`` (2,) has so much
    ``variance`` on each axis. One of them is lit alone, or all: the chance of some is counted as that of all.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        odds = lit / (1.0 - np.minimum(lit, 0.999))
    none = np.prod(1.0 - np.minimum(lit, 0.999))
    alone = odds * none
    weight = np.array([*alone, max(1.0 - none - float(alone.sum()), 0.0)])
    places = np.vstack([pixels, (lit[:, None] * pixels).sum(axis=0) / lit.sum()])
    deviation = -0.5 * ((places - detection) ** 2).sum(axis=1) / variance
    weight = weight * np.exp(deviation - deviation.max())
    weight /= weight.sum()
    return np.asarray(weight[:-1] + weight[-1])


def _flat_labels(blob: Integers) -> Integers:
    """Place of each point's blob among all points of all poses."""
    return np.asarray((np.arange(len(blob))[:, None] * blob.shape[1] + blob).ravel(), np.int64)


def _sum_over_blobs(blob: Integers, values: Floats) -> Floats:
    """Values (K, n, …) of points, each replaced by the sum over its blob."""
    flat, place = values.reshape(blob.size, -1), _flat_labels(blob)
    total = np.zeros_like(flat)
    np.add.at(total, place, flat)
    return np.asarray(total[place].reshape(values.shape))


def likeliest_lit_points(
    model: DetectionModel, assignment: Integers, pose: tuple[Floats, Floats]
) -> tuple[Integers, Floats] | None:
    """The point of each blob that is most probably lit, by where the blob is detected; None if all are resolved.

    Parameters
    ----------
    model : DetectionModel
    assignment : (n,) int64 array
        In which the first point of each blob has the detection; −1 for none.
    pose : (3, 3) and (3,) arrays
        Rotation, and position of the body's centre.

    Returns
    -------
    (n,) int64 and (n,) float64 arrays
        That point for the first point of each detected blob, and the probability that it is lit; every other point
        itself, and 1.
    """
    at = model.linearise_about(pose[0][None], pose[1][None]) if model.resolution > 0.0 else None
    if at is None or at.blob is None:
        return None
    surest, chance = np.arange(len(assignment)), np.ones(len(assignment))
    alone = replace(model, resolution=0.0)
    points = alone.linearise_about(at.rotation, at.position)
    lit = model.lit(alone.visibility(points, np.zeros(1)))[0]
    for first in np.flatnonzero(assignment >= 0).tolist():
        part = np.flatnonzero(at.blob[0] == first)
        if len(part) > 1:
            detection = assignment[first]
            variance = float(model.sigma[detection]) ** 2
            each = lit_probabilities(points.pixels[0, part], lit[part], model.target[detection], variance)
            surest[first], chance[first] = part[int(each.argmax())], each.max()
    return surest, chance


def swap_to_likeliest(assignment: Integers, values: Floats, surest: Integers) -> tuple[Integers, Floats]:
    """An assignment (n,) and values (n,) in which the surest point of a blob and its first one change places."""
    order = np.arange(len(assignment))
    moved = np.flatnonzero(surest != order)
    order[moved], order[surest[moved]] = surest[moved], moved
    return assignment[order], values[order]


def resolve_blobs(model: DetectionModel, points: PointSets, assignment: Integers, pose: Pose) -> PointSets:
    """Points of an image in which each point of a blob is detected by itself, as far from its image as the blob was.

    ``assignment`` (n,): in which a blob is one detection; ``pose``: that of the blobs.
    """
    R, position = model.centred(pose.R[None], pose.t[None])
    at = model.linearise_about(R, position) if model.resolution > 0.0 else None
    if at is None or at.blob is None or at.blob_variance is None:
        return points
    alone = replace(model, resolution=0.0).linearise_about(R, position).pixels[0]
    (matched,) = np.nonzero((assignment >= 0) & (at.blob_variance[0] > 0.0))
    detections, target, noise = assignment[matched], points.target.copy(), points.target_noise.copy()
    target[detections] += alone[matched] - at.pixels[0, matched]
    noise[detections] = np.sqrt(noise[detections] ** 2 + at.blob_variance[0, matched])
    own = None if points.target_covariance is None else points.target_covariance.copy()
    if own is not None:
        own[detections] += at.blob_variance[0, matched, None, None] * np.eye(2)
    return replace(points, target=target, target_noise=noise, target_covariance=own)
