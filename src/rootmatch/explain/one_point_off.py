"""Poses that allow for one point that is off, as a marker that was displaced, or that is half hidden.

The covariance of a fit is that of the stated noise. If one point is off, it takes the pose along by more than that. So
the covariance that is told is that of a mixture: no point is off, or any one of them, by an error of some sizes, each
with the evidence that the fit gives it, to first order.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import turn_jacobian
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.explain.finding import Finding
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.image_alike import ERRORS
from rootmatch.model.priors import INEXACT, NOISE_FREEDOM
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_checks import nearest_covariance
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.problems.pose_fit.shared_noise import by_points, shared_spread


class FittedPoints(NamedTuple):
    """What is measured of n points about a pose of p parameters, k numbers of each."""

    by_pose: Floats
    """Derivatives (n, k, p)."""
    by_point: Floats
    """Derivatives (n, k, d) by the point."""
    spread: Floats
    """Covariances (n, k, k)."""
    offsets: Floats
    """(n, k), measured less predicted."""

    @property
    def counts(self) -> Integers:
        """How many numbers (n,) are measured of each."""
        return np.asarray(self.by_pose.any(axis=2).sum(axis=1))


def allowing_for_one_off(found: Finding, pose: Pose) -> Pose:
    """A pose that was fitted to the matches of a finding, with a covariance that allows for one point that is off."""
    if pose.covariance is None:
        return pose
    model, k = found.model, len(pose.R)
    if found.task.problem.point_clouds(found.task.points) is not None:
        points, freedom = _in_space(found, pose), NOISE_FREEDOM
    elif model is not None and not model.resolution and k == 3 and model.shape[0] == len(found.assignment):
        points, freedom = _in_images(found, model, pose), model.noise_freedom
    else:
        return pose
    if points.by_pose.shape[2] != len(pose.covariance):  # a scale, or a focal length
        return pose
    sizes = ERRORS * body_radius(found.task.points.source)
    dof = int(points.counts.sum()) - len(pose.covariance) if pose.dof is None else pose.dof
    # where the others fit any pose, nothing tells that a point is off
    testable = points.counts < dof
    if not testable.any():
        return pose
    covariance = covariance_if_off(points, pose.covariance, (sizes, testable), (freedom, dof))
    return replace(pose, covariance=nearest_covariance(covariance))


def covariance_if_off(
    points: FittedPoints, covariance: Floats, of: tuple[Floats, Bools], known: tuple[float, int]
) -> Floats:
    """Mean square error (p, p) of a fit if one of its points may be off.

    Parameters
    ----------
    points : FittedPoints
    covariance : (p, p) array
        Of the fit, if none is.
    of : tuple
        Standard deviations (W,) of a coordinate of a point that is off, each as probable as the others, and which
        points (n,) may be.
    known : tuple
        Residuals by which the scale of the noise is known, and degrees of freedom of the fit.
    """
    (by_pose, by_point, spread, offsets), (sizes, which), (freedom, dof) = points, of, known
    inverse = np.linalg.inv(spread)
    squared = float(np.einsum("ni,nij,nj->", offsets, inverse, offsets))
    # with τ² more of a point's coordinates, the inverse of its spread loses G Gᵀ
    half = inverse @ by_point
    own, count = by_point.swapaxes(1, 2) @ half, by_point.shape[2]
    wide = np.eye(count) + sizes[:, None, None, None] ** 2 * own  # (W, n, d, d)
    root = np.linalg.inv(np.linalg.cholesky(wide))
    loss = sizes[:, None, None, None] * (half @ root.swapaxes(-1, -2)).swapaxes(-1, -2)  # Gᵀ
    rows = loss @ by_pose
    told = (loss @ offsets[..., None])[..., 0]
    across = rows @ covariance
    values, axes = np.linalg.eigh(np.eye(count) - across @ rows.swapaxes(-1, -2))
    # of a covariance by these rows alone; it may have been made larger since
    values = np.maximum(values, 1.0 / np.linalg.eigvalsh(wide)[..., -1:])
    back = (axes / values[..., None, :]) @ axes.swapaxes(-1, -2)
    shift = (back @ told[..., None])[..., 0]
    left = np.maximum(squared - (told * shift).sum(axis=-1), 0.0)
    log_odds = math.log(INEXACT / len(sizes)) - math.log1p(-INEXACT) - 0.5 * np.linalg.slogdet(wide)[1]
    log_odds = log_odds - 0.5 * np.log(values).sum(axis=-1)
    log_odds += 0.5 * (freedom + dof) * (math.log(freedom + squared) - np.log(freedom + left))
    log_odds = np.where(which, log_odds, -np.inf)
    weights = np.exp(log_odds - np.logaddexp(0.0, np.logaddexp.reduce(log_odds, axis=None)))
    more = weights[..., None, None] * (back + shift[..., None] * shift[..., None, :])
    return np.asarray(covariance + np.einsum("wnip,wnij,wnjq->pq", across, more, across))


def _in_images(found: Finding, model: DetectionModel, pose: Pose) -> FittedPoints:
    """The sightings of matched points, those of one point together."""
    used, image = found.assignment >= 0, np.maximum(found.assignment, 0)
    at, images = model.linearised(*model.centred(pose.R[None], pose.t[None])), max(len(model.images), 1)
    each = used[:, None, None]
    by_pose, by_point = at.jacobian[0] * each, at.by_position[0] @ pose.R * each
    by_pose[..., :3] += by_pose[..., 3:] @ turn_jacobian(pose.R @ model.centre)  # about the points' own origin
    own = np.where(each, model.own_covariances(at, image[None])[0], np.eye(2))
    offsets = np.where(used[:, None], model.target[image] - at.pixels[0], 0.0)
    spread = shared_spread(by_point, model.source_covariance, own, images)
    rows = (by_points(one, images) for one in (by_pose, by_point, offsets[..., None]))
    pose_rows, point_rows, off = rows
    seen = used.reshape(images, -1).any(axis=0)
    # images without a sighting of a point have no offset and no derivatives
    return FittedPoints(pose_rows[seen], point_rows[seen], spread[seen], off[seen, :, 0])


def _in_space(found: Finding, pose: Pose) -> FittedPoints:
    """Matched points of two sets."""
    clouds = found.task.problem.point_clouds(found.task.points)
    assert clouds is not None
    own = np.flatnonzero(found.assignment >= 0) if pose.points is None else pose.points
    image, linear = found.assignment[own], pose.scale * pose.R
    turned, k = clouds.source[own] @ linear.T, len(pose.R)
    turns = np.array([np.reshape(turn_jacobian(one), (k, -1)) for one in turned])
    first, second = clouds.covariances(linear)
    shifts, points = (np.tile(one, (len(own), 1, 1)) for one in (np.eye(k), linear))
    spread = first[own] + second[image]
    return FittedPoints(np.concatenate([turns, shifts], axis=2), points, spread, clouds.target[image] - turned - pose.t)
