"""What the errors that frames have in common, of a body's points and of a calibration, do to a fitted pose."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.rotation import turn_jacobian
from rootmatch.arrays import Integers
from rootmatch.cameras.calibration_errors import calibration_jacobian
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import match_covariances
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.projection_model import group_by_point
from rootmatch.problems.pose_fit.shared_errors import SharedErrors


def errors_in_common(model: DetectionModel, assignment: Integers, fit: Pose) -> SharedErrors | None:
    """Errors of a fitted pose by those of the calibration and of the n points; None if all of these are exact.

    They are in units of their deviations, those of the calibration first. ``fit``: of an assignment (n,), or (C n,) of
    the sightings of C cameras, with the covariance of the fit.
    """
    if model.source_covariance is None and model.calibration_noise is None:
        return None
    assert fit.covariance is not None
    at, images = model.linearise_about(*model.centred(fit.R[None], fit.t[None])), max(len(model.images), 1)
    used, image = (assignment >= 0)[None], np.maximum(assignment, 0)[None]
    (by_point,), (spread,) = match_covariances(model, at, used, image)
    by_pose = at.jacobian[0] * used[0, :, None, None]
    by_pose[..., :3] += by_pose[..., 3:] @ turn_jacobian(fit.R @ model.centre)  # about the points' own origin
    rows, parts = group_by_point(by_pose, images), list[SharedErrors]()
    if model.calibration_noise is not None:
        seen, gain = used[0] & at.seen[0], fit.covariance @ np.linalg.solve(spread, rows).swapaxes(1, 2)
        by_errors = calibration_jacobian(model.camera, model.points @ fit.R.T + fit.t)
        by_errors = np.where(seen[:, None, None], by_errors, 0.0)
        taken = np.where(used[0], np.minimum(model.calibration_noise, model.sigma)[image[0]], 0.0)
        noise = group_by_point(np.repeat(taken[:, None, None], 2, axis=1), images)
        # the fit took each detection to be off by itself, by as much as that may be
        counted, changed = gain * noise.swapaxes(1, 2), gain @ group_by_point(by_errors, images)
        parts.append(SharedErrors(changed.sum(axis=0), (counted @ counted.swapaxes(1, 2)).sum(axis=0)))
    if model.source_covariance is not None:
        by_points = rows, group_by_point(by_point, images)
        covariance = model.source_covariance[: len(spread)]
        parts.append(SharedErrors.of_points(fit.covariance, by_points, spread, covariance))
    each = np.concatenate([one.each for one in parts], axis=1)
    return SharedErrors(each, np.sum([one.counted for one in parts], axis=0))
