"""Mean and covariance of a pose, over the changes of its assignment and along what its detections hardly determine.

A frame may leave open which of two points a detection is of. A filter that is told the pose of one of them predicts
that one, so that the next frame is certain of it: it gets the mean of both (joint probabilistic data association,
Fortmann, Bar-Shalom and Scheffe 1983).

A fit ends where the residuals are least; its covariance is that of a linear image, and knows nothing of which points
can be seen. Where few points are seen both are wrong by degrees in some directions, and a filter that is told so in
frame after frame drifts away, sure of it. There the posterior is evaluated at some poses on a line, and averaged.

Points that are seen face the camera. That others are not seen tells nothing here: what hides them hides them in the
next frame too, and taken as new in each frame it made a controller's rotation certain to 5 degrees where it was wrong
by 20 (benchmarks/flights.py, rig, seed 1105).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.algebra.rotation import one_rotation_matrix
from rootmatch.arrays import Floats, Integers
from rootmatch.frozen import amend
from rootmatch.model.compiled.averaging import average_weak_directions
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.errors_in_common import errors_in_common
from rootmatch.model.modes import Modes
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.shared_errors import SharedPose

WEAK = 0.02
"""Standard deviation in radians, or over the distance, from which a direction is averaged over. A round value."""
PLACES = np.linspace(-3.0, 3.0, 7)
"""Poses on the line, in standard deviations of the fit. A round value."""
MINIMUM = 0.25
"""Least variance along the line, over that of the fit: the poses on it are no closer. By construction."""


def average_pose(model: DetectionModel, modes: Modes, k: int) -> Pose:
    """The pose of one of some modes, averaged over its changes, then along its weak directions, one after another.

    Of the points as they were given, with its covariance, and with the errors that it has by those of the points.
    """
    R, position, covariance = _average_over_changes(modes, k)
    a, b, c, *of_place = covariance.diagonal().tolist()
    # no eigenvalue is larger than the sum of all
    if a + b + c + sum(of_place) / max(float(position @ position), 1e-300) >= WEAK**2:
        about = np.array(R[None], float), np.array(position[None], float), np.array(covariance, float)
        scene = _scene_of_scalar_noise(model, modes.assignments[k], about[:2])
        prior, row = model.prior.for_kernels, np.array(modes.assignments[k][None], np.int64)
        if scene is not None and prior is not None:
            average_weak_directions(row, WEAK, PLACES, scene, prior, MINIMUM, about)
            R, position, covariance = about[0][0], about[1][0], about[2]
    pose = model.pose_of_origin(R, position, 0.5 * (covariance + covariance.T))
    shared = errors_in_common(model, modes.assignments[k], pose)
    return pose if shared is None else SharedPose.of(pose, shared)


def _average_over_changes(modes: Modes, k: int) -> tuple[Floats, Floats, Floats]:
    """Rotation, position and covariance of a mode over all changes of its assignment, the first two moments of all."""
    R, position, covariance = modes.rotation[k], modes.position[k], modes.covariance[k]
    _, values, steps = modes.near[k]
    weight = np.exp(np.minimum(values - modes.log_odds[k], 0.0))
    whole = 1.0 + float(weight.sum())
    if 1.0 - 1.0 / whole < WRONG_MODEL:
        return R, position, covariance
    weight /= whole
    mean = weight @ steps
    spread = (weight[:, None] * steps).T @ steps - np.outer(mean, mean)
    return one_rotation_matrix(mean[:3]) @ R, position + mean[3:], covariance + spread


def _scene_of_scalar_noise(model: DetectionModel, assignment: Integers, pose: tuple[Floats, Floats]) -> Any:
    """What the kernel takes, with one σ for each match: of its detection, point and blob about a pose, on both axes.

    ``pose``: (1, 3, 3) and (1, 3). None where cameras share the error of a point, which no σ of each tells, and where a
    caller's own camera has no kernels.
    """
    if not model.has_covariances and not model.resolution:
        return model.scene_for_kernels
    at, (used,) = model.linearise_about(*pose), (assignment >= 0).nonzero()
    spread = model.assigned_covariances(at, np.maximum(assignment, 0)[None])[0, used]
    if model.source_covariance is not None:
        if ((assignment >= 0).reshape(max(len(model.images), 1), -1).sum(axis=0) > 1).any():
            return None
        by_point = (at.by_position @ at.rotation[:, None])[0, used]
        spread = spread + by_point @ model.source_covariance[used] @ by_point.swapaxes(1, 2)
    sigma = np.array(model.sigma, float)
    sigma[assignment[used]] = np.sqrt(0.5 * np.trace(spread, axis1=1, axis2=2))
    alone = {"sigma": sigma, "source_covariance": None, "target_covariance": None, "resolution": 0.0}
    return amend(model, "image_for_kernels", "scene_for_kernels", **alone).scene_for_kernels
