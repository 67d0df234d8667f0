"""Errors that the poses of all frames have in common: of the body's points, which no number of frames averages out.

Each frame's fit weighs its detections as if the errors e of the points were drawn anew: that is right for one frame,
and frames that differ more than they do by noise do not count as much. But what the poses of a sequence have of e adds
up, ε = L e + ε', and only ε' averages out. So L is carried from frame to frame beside the covariance, and with it the
part Y of that covariance which stands for e as if each frame had another one: the covariance of all errors is that
without Y, and with L Lᵀ. (A filter that considers parameters without estimating them, Schmidt 1966, with gains of its
own.) In the body's frame e stays; L follows from each frame's Jacobians, turns with the body, and changes when other
points are seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import turn_jacobian
from rootmatch.arrays import Floats
from rootmatch.problems.pose_fit.pose import Pose

EXACT = 1e-6
"""Smallest variance, relative to others."""


class SharedErrors(NamedTuple):
    """What p parameters have of m errors that all frames share, which are independent and have unit variance.

    Attributes
    ----------
    each : (p, m) float64
        L: errors of the parameters by each of them.
    counted : (p, p) float64
        Y: their part of the parameters' covariance, in which those of each frame are independent.
    """

    each: Floats
    counted: Floats

    @classmethod
    def of(cls, each: Floats) -> SharedErrors:
        """Those of one frame (p, m)."""
        return cls(each, each @ each.T)

    @classmethod
    def of_points(cls, fitted: Floats, rows: tuple[Floats, Floats], spread: Floats, covariance: Floats) -> SharedErrors:
        """Those of a fitted pose by the errors of n points.

        Parameters
        ----------
        fitted : (p, p) array
            Covariance of the fit.
        rows : (n, k, p) and (n, k, 3) arrays
            Derivatives of what is measured of each point by the pose, and by the point; zero for what is not.
        spread : (n, k, k) array
            Covariances of what is measured.
        covariance : (n, 3, 3) array
            Of the points.
        """
        by_pose, by_point = rows
        variances, axes = np.linalg.eigh(covariance)
        roots = axes * np.sqrt(np.maximum(variances, 0.0))[:, None]
        each = by_pose.swapaxes(1, 2) @ np.linalg.solve(spread, by_point @ roots)
        return cls.of(fitted @ each.swapaxes(0, 1).reshape(len(fitted), -1))

    def moved(self, change: Floats) -> SharedErrors:
        """Those of other parameters (q,), which the errors change by a matrix (q, p)."""
        return SharedErrors(change @ self.each, change @ self.counted @ change.T)

    def plus(self, other: SharedErrors) -> SharedErrors:
        """Those of two frames together, of which one may know of the first errors alone."""
        first, second = (np.zeros((len(self.each), max(self.each.shape[1], other.each.shape[1]))) for _ in range(2))
        first[:, : self.each.shape[1]], second[:, : other.each.shape[1]] = self.each, other.each
        return SharedErrors(first + second, self.counted + other.counted)

    def about(self, arm: Floats) -> SharedErrors:
        """Those of a pose with the position of another point, which is (3,) from its own in the target's frame."""
        change = np.eye(len(self.each))
        change[3:6, :3] = turn_jacobian(arm)
        return self.moved(change)

    def whole(self, covariance: Floats) -> Floats:
        """The covariance (p, p) of all errors, by that in which the shared ones of each frame are independent."""
        return np.asarray(subtract_covariance(covariance, self.counted) + self.each @ self.each.T)


@dataclass(frozen=True, eq=False, kw_only=True)
class SharedPose(Pose):
    """A pose with errors that other poses share; for its covariance, they are independent."""

    shared: SharedErrors

    @classmethod
    def of(cls, pose: Pose, shared: SharedErrors) -> SharedPose:
        """A pose with its shared errors."""
        one = cls.__new__(cls)
        one.__dict__.update(pose.__dict__, shared=shared)
        return one


def copy_shared_errors(pose: Pose, other: Pose) -> Pose:
    """A pose with the shared errors of another one, if it has any."""
    return SharedPose.of(pose, other.shared) if isinstance(other, SharedPose) else pose


def with_whole_covariance(pose: Pose) -> Pose:
    """A pose with the covariance of all of its errors."""
    if not isinstance(pose, SharedPose):
        return pose
    assert pose.covariance is not None
    return Pose.unchecked(pose.R, pose.t, pose.shared.whole(pose.covariance), pose.scale)


def fuse_prediction(prior: SharedPose, fit: Pose, own: SharedErrors) -> Pose:
    """A fit with the covariance of all of its errors, those that it shares with the prediction in it counted once.

    ``own``: those of the fit by its own detections.
    """
    assert prior.covariance is not None
    assert fit.covariance is not None
    left = remaining_prediction_error(fit.covariance, prior.covariance)
    return replace(fit, covariance=prior.shared.moved(left).plus(own).whole(fit.covariance))


def remaining_prediction_error(fitted: Floats, predicted: Floats) -> Floats:
    """What a fit leaves (p, p) of the errors of a prediction in it, by the covariances (p, p) of both.

    That is hardly any in a direction in which it is far less certain: a caller said where the body is instead.
    """
    # a sensor may know a part of the pose exactly: then a root of what is nearly that
    size = np.sqrt(np.maximum(np.diagonal(predicted), EXACT**4 * np.abs(predicted).max() + 1e-200))
    values, vectors = np.linalg.eigh(predicted / (size[:, None] * size))
    deviations = np.sqrt(np.maximum(values, EXACT))
    root, inverse = size[:, None] * vectors * deviations, (vectors / deviations).T / size
    values, vectors = np.linalg.eigh(inverse @ fitted @ inverse.T)
    values = np.maximum(values, EXACT)
    return np.asarray(root @ (vectors * np.minimum(values, 1.0 / values)) @ vectors.T @ inverse)


def subtract_covariance(covariance: Floats, part: Floats) -> Floats:
    """A covariance without a part of it, positive definite."""
    size = np.sqrt(np.maximum(np.diagonal(covariance), 1e-200))  # a rotation may be known exactly
    values, vectors = np.linalg.eigh((covariance - part) / (size[:, None] * size))
    return np.asarray((vectors * np.maximum(values, EXACT)) @ vectors.T * (size[:, None] * size))
