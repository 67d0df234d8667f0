"""Which point of a blob its detection is, and where that point alone would have been detected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.model.blobs import lit_probabilities
from rootmatch.model.detection_model import DetectionModel
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.pose import Pose


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
