"""The calibration of one camera as an image tells it, where it was stated to be inexact.

All detections share the errors of a calibration, and a body that is not flat shows them: a focal length that is off
moves what is far from the middle by what no pose undoes. A first judgement takes them as noise of each detection,
which finds the body but says little of what is at the edges, or of whether its pose fits. What it found tells the
errors within what was stated, and the image is judged again with the camera that has them. The pose that is told is
still that of the camera as it was given, with the covariance of all of its errors.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import cross_matrix, one_rotation_matrix
from rootmatch.arrays import Floats
from rootmatch.cameras.calibration_errors import calibration_jacobian
from rootmatch.cameras.pinhole import Camera
from rootmatch.explain.finding import Finding, mode_pose
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.priors import PRESENT_ODDS, probability
from rootmatch.problems.noise import add_detection_noise
from rootmatch.problems.pose_fit.pose import Pose

SMALL = 0.3
"""Part of the noise that stands for the calibration, over the rest, up to which nothing is gained. A round value; it
bounds time."""
STEPS = 4
"""Of Gauss and Newton, from the pose of the camera as it was given. A round value."""
STATED = 3.0
"""Errors, in their standard deviations, beyond which the calibration is not what was stated. A round value."""


class ImagedCalibration(NamedTuple):
    """A finding, and its task with the camera that fits it."""

    found: Finding
    """By the camera as it was given."""
    task: MatchingTask
    """The camera is exact then."""
    log_cost: float
    """Logarithm of how much less probable what fits then is over all errors, than with those that fit it best."""

    @classmethod
    def of(cls, found: Finding) -> ImagedCalibration | None:
        """That of a finding of one body; None if it tells no more than was stated, or may be one of several poses."""
        task, told, model = found.task, found.posterior, found.model
        camera, noise = getattr(task.problem, "camera", None), task.calibration_noise
        if noise is None or not isinstance(camera, Camera) or task.more_images or told is None or model is None:
            return None
        used, chances = np.flatnonzero(found.assignment >= 0), told.probabilities
        of_used = found.assignment[used]
        alone = add_detection_noise(task.points, -(noise**2))
        small = not (noise[of_used] > SMALL * alone.detection_noise[of_used]).any()
        if small or not chances[found.mode] >= task.options.required_probability * chances.sum():
            return None
        fit = _fit_errors(found, camera, mode_pose(model, told.modes, found.mode))
        if fit is None or not (np.abs(fit[0]) < STATED).all():
            return None
        errors, covariance = fit
        # exact: by n matches, what is left of its errors is as 1 / √(2 n) of the noise
        known = replace(_with_errors(camera, errors), focal_noise=0.0, centre_noise=0.0)
        exact = replace(task, problem=replace(task.problem, camera=known), points=alone, calibration_noise=None)  # type: ignore[type-var]
        cost = 0.5 * float(errors @ errors - np.linalg.slogdet(covariance)[1])
        return cls(found, exact, cost)

    def better(self, again: Finding) -> Finding:
        """What is told: the second judgement, as a finding by the camera that was given, if it explains more."""
        first, own = self.found, again.log_odds
        if own is None or first.log_odds is None or own - self.log_cost < first.log_odds:
            return first
        odds = PRESENT_ODDS + own
        left = probability(odds - self.log_cost) / probability(odds)
        told = again.with_facts(present=left * (again.facts.present or 0.0)).scale_probability(left)
        return copy_with(told, task=first.task, model=first.model, log_odds=own - self.log_cost)


def _with_errors(camera: Camera, errors: Floats) -> Camera:
    """A camera with errors (m,) of `calibration_jacobian`."""
    zoom, centre = 1.0, np.zeros(2)
    if camera.focal_noise:
        zoom += float(errors[0]) * camera.focal_noise / camera.focal
    if camera.centre_noise:
        centre = errors[-2:] * camera.centre_noise
    x, y = centre.tolist()
    return replace(camera, fx=zoom * camera.fx, fy=zoom * camera.fy, cx=camera.cx + x, cy=camera.cy + y)


def _fit_errors(found: Finding, given: Camera, start: Pose) -> tuple[Floats, Floats] | None:
    """Errors (m,) that fit a finding with a pose of their own, and their covariance (m, m); None if no pose does.

    In units of their standard deviations, about none.
    """
    task, used = found.task, np.flatnonzero(found.assignment >= 0)
    points, target = task.points, found.assignment[used]
    assert task.calibration_noise is not None
    own = points.covariances_of(target) - task.calibration_noise[target, None, None] ** 2 * np.eye(2)
    source, pixels = points.source[used], points.target[target]
    middle = source.mean(axis=0)
    centred, R, t, errors = source - middle, start.R, start.t + start.R @ middle, np.zeros(0)
    for step in range(STEPS):
        camera = given if not step else _with_errors(given, errors)
        turned = centred @ R.T
        by_point, by_errors = camera.jacobian(turned + t), calibration_jacobian(camera, turned + t)
        errors = errors if step else np.zeros(by_errors.shape[-1])
        spread = own
        if points.source_covariance is not None:
            spread = own + by_point @ R @ points.source_covariance[used] @ (by_point @ R).swapaxes(1, 2)
        rows = np.concatenate([-by_point @ cross_matrix(turned), by_point, by_errors], axis=-1)
        offset = (pixels - camera.project(turned + t))[..., None]
        if not (np.isfinite(rows).all() and np.isfinite(offset).all()):
            return None
        white = np.linalg.solve(np.linalg.cholesky(spread), np.concatenate([rows, offset], axis=-1)).reshape(
            -1, rows.shape[-1] + 1
        )
        precision, gradient = white[:, :-1].T @ white[:, :-1], white[:, :-1].T @ white[:, -1]
        precision[6:, 6:] += np.eye(len(errors))
        gradient[6:] -= errors
        precision[range(6), range(6)] *= 1.0 + 1e-9  # where points are on a line
        covariance = np.linalg.inv(precision)
        change = covariance @ gradient
        R, t, errors = one_rotation_matrix(change[:3]) @ R, t + change[3:6], errors + change[6:]
    return errors, covariance[6:, 6:]
