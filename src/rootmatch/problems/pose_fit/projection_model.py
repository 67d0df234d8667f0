"""Deviations of detections from the projections of their points, and how they change with the pose of the camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from rootmatch.algebra.rotation import cross_matrix, rotation_from_vector
from rootmatch.arrays import Floats
from rootmatch.cameras.base import CameraModel
from rootmatch.problems.pose_fit.descent import State
from rootmatch.problems.pose_fit.prior_residuals import Prior, Upright


@dataclass(frozen=True, eq=False)
class ProjectionModel:
    """B poses of a camera; see `rootmatch.problems.pose_fit.descent.Model`. States: (R, t)."""

    points: Floats
    """(B, n, 3)."""
    image: Floats
    """(B, n, 2), or unit rays (B, n, 3)."""
    weight: Floats
    """(B, n): 1 / σ, 0 for none."""
    camera: CameraModel
    axes: Floats
    """(a, 3) axes in the camera frame, about which the camera may rotate."""
    upright: Upright | None = None
    """A noisy vertical."""
    prior: Prior | None = None
    white: Floats | None = None
    """(B, n, C k, C k) in the place of 1 / σ, where points are not exact, seen in C images; see `whitening`."""

    def residuals(self, state: State) -> Floats:
        """See `Model`."""
        rotation, translation = state
        positions = self.points @ rotation.swapaxes(-1, -2) + translation[:, None]
        used = self.weight > 0.0
        possible = np.asarray(np.isfinite(positions).all(axis=-1))
        positions = np.where(possible[..., None], positions, 1.0)
        off = np.where(
            used[..., None], self._whiten((self.camera.project(positions) - self.image)[..., None])[..., 0], 0.0
        )
        off[~((self.camera.sees(positions) & possible) | ~used).all(axis=1)] = np.inf
        parts = [off.reshape(len(off), -1)]
        if self.upright is not None:
            parts.append(self.upright.residuals(rotation))
        if self.prior is not None:
            parts.append(self.prior.residuals(rotation, translation))
        return np.concatenate(parts, axis=1)

    def jacobian(self, state: State) -> Floats:
        """See `Model`."""
        rotation, translation = state
        rotated = self.points @ rotation.swapaxes(-1, -2)
        by_position = self._whiten(self.camera.jacobian(rotated + translation[:, None]))
        by_rotation = -by_position @ (cross_matrix(rotated) @ self.axes.T)
        both = np.concatenate([by_rotation, by_position], axis=-1)
        parts = [np.where(self.weight[..., None, None] > 0.0, both, 0.0).reshape(len(rotation), -1, both.shape[-1])]
        if self.upright is not None:
            parts.append(self.upright.jacobian(rotation, self.axes))
        if self.prior is not None:
            parts.append(self.prior.jacobian(rotation, self.axes))
        return np.concatenate(parts, axis=1)

    def repeated(self, times: int) -> Self:
        """Each of the fits so many times, one after another."""
        points, image, weight = (np.repeat(part, times, axis=0) for part in (self.points, self.image, self.weight))
        white = None if self.white is None else np.repeat(self.white, times, axis=0)
        return replace(self, points=points, image=image, weight=weight, white=white)

    def _whiten(self, rows: Floats) -> Floats:
        """Rows (B, n, k, q) in units of the noise."""
        if self.white is None:
            return np.asarray(rows * self.weight[..., None, None])
        images = rows.shape[1] // self.white.shape[1]
        # a row that is not used may hold anything
        known = np.where((self.weight > 0.0)[..., None, None], rows, 0.0)
        return ungroup_sightings(self.white @ group_by_point(known, images), images)

    def moved(self, state: State, step: Floats) -> State:
        """See `Model`."""
        angles = len(self.axes)
        return rotation_from_vector(step[:, :angles] @ self.axes) @ state[0], state[1] + step[:, angles:]


def whitening(
    camera: CameraModel, points: Floats, covariance: Floats | None, own: Floats, state: State, images: int = 1
) -> Floats:
    """Inverse Cholesky factors (B, n, C k, C k) of the covariances of detections about their points' projections.

    That is S + J Σ Jᵀ, S that of a detection and J the derivative by the position of a point that is uncertain by Σ, in
    all C images at once.

    Parameters
    ----------
    camera : CameraModel
        With detections of k numbers.
    points, covariance : (B, C n, 3) and (B, C n, 3, 3) arrays
        Model points with their Σ, or their sightings image by image; None for Σ if points are exact.
    own : (B, C n, k, k) array
        S of the detections, 0 for none.
    state : State
        The poses at which J is taken.
    images : int
        C.
    """
    rotation, translation = state
    with np.errstate(all="ignore"):
        by_point = camera.jacobian(points @ rotation.swapaxes(-1, -2) + translation[:, None]) @ rotation[:, None]
    used = own[..., 0, 0] > 0.0
    usable = np.isfinite(by_point).all(axis=(-1, -2)) & used
    own = np.where(used[..., None, None], own, np.eye(own.shape[-1]))
    spread = shared_spread(np.where(usable[..., None, None], by_point, 0.0), covariance, own, images)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(spread)))


def group_by_point(rows: Floats, images: int) -> Floats:
    """What sightings (…, C n, k, q) have, which are ordered image by image, point by point: (…, n, C k, q)."""
    *some, count, k, q = rows.shape
    parts = rows.reshape(*some, images, count // images, k, q)
    return parts.swapaxes(-4, -3).reshape(*some, count // images, images * k, q)


def ungroup_sightings(rows: Floats, images: int) -> Floats:
    """The inverse of `group_by_point`."""
    *some, count, size, q = rows.shape
    parts = rows.reshape(*some, count, images, size // images, q)
    return parts.swapaxes(-4, -3).reshape(*some, images * count, size // images, q)


def shared_spread(by_point: Floats, covariance: Floats | None, own: Floats, images: int) -> Floats:
    """Covariances (…, n, C k, C k) of the sightings of each point: J Σ Jᵀ with the J of all of them, and their own.

    Parameters
    ----------
    by_point : (…, C n, k, 3) array
        Derivatives J of the sightings by their points; zero where a point is not matched.
    covariance : (…, C n, 3, 3) array or None
        Σ of the points, the same for all sightings of one; None if they are exact.
    own : (…, C n, k, k) array
        Covariances of the detections.
    images : int
        C.
    """
    rows, k = group_by_point(by_point, images), by_point.shape[-2]
    count, size = rows.shape[-3:-1]
    spread = np.zeros((*rows.shape[:-1], size))
    if covariance is not None:
        spread += rows @ covariance[..., :count, :, :] @ rows.swapaxes(-1, -2)
    for image in range(images):
        some = slice(image * k, (image + 1) * k)
        spread[..., some, some] += own[..., image * count : (image + 1) * count, :, :]
    return spread
