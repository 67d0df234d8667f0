"""Deviations of detections from the projections of their points, and how they change with the pose of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.algebra.rotation import cross_matrix, rotation_from_vector
from rootmatch.cameras.base import CameraModel
from rootmatch.problems.pose_fit.absolute import Upright
from rootmatch.problems.pose_fit.descent import Floats, State
from rootmatch.problems.pose_fit.prior import Prior


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

    def residuals(self, state: State) -> Floats:
        """See `Model`."""
        rotation, translation = state
        positions = self.points @ rotation.swapaxes(-1, -2) + translation[:, None]
        used = self.weight > 0.0
        possible = np.asarray(np.isfinite(positions).all(axis=-1))
        positions = np.where(possible[..., None], positions, 1.0)
        off = np.where(used[..., None], (self.camera.project(positions) - self.image) * self.weight[..., None], 0.0)
        off[~((self.camera.sees(positions) & possible) | ~used).all(axis=1)] = np.inf
        parts = [off.reshape(len(off), -1)]
        if self.upright is not None:
            parts.append(_tilts(self.upright, rotation) / self.upright.noise)
        if self.prior is not None:
            parts.append(self.prior.residuals(rotation, translation))
        return np.concatenate(parts, axis=1)

    def jacobian(self, state: State) -> Floats:
        """See `Model`."""
        rotation, translation = state
        rotated = self.points @ rotation.swapaxes(-1, -2)
        by_position = self.camera.jacobian(rotated + translation[:, None]) * self.weight[..., None, None]
        by_rotation = -by_position @ (cross_matrix(rotated) @ self.axes.T)
        size, both = len(rotation), np.concatenate([by_rotation, by_position], axis=-1)
        parts = [np.where(self.weight[..., None, None] > 0.0, both, 0.0).reshape(size, -1, both.shape[-1])]
        if self.upright is not None:
            down = rotation @ self.upright.world[1]
            rows = [np.cross(down, self.upright.camera[2]), np.cross(self.upright.camera[0], down)]
            tilt = np.stack(rows, axis=1) @ self.axes.T / self.upright.noise
            parts.append(np.concatenate([tilt, np.zeros((size, 2, 3))], axis=-1))
        if self.prior is not None:
            parts.append(self.prior.jacobian(rotation, self.axes))
        return np.concatenate(parts, axis=1)

    def moved(self, state: State, step: Floats) -> State:
        """See `Model`."""
        angles = len(self.axes)
        return rotation_from_vector(step[:, :angles] @ self.axes) @ state[0], state[1] + step[:, angles:]


def _tilts(upright: Upright, rotation: Floats) -> Floats:
    """Angles (B, 2) between the vertical as measured and as rotated into the camera, about two axes."""
    down = rotation @ upright.world[1] @ upright.camera.T
    return np.stack([down[:, 2], -down[:, 0]], axis=1)
