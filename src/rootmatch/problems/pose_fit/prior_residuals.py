"""What a fit takes into account beside the detections: a predicted pose with its covariance, a known vertical."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.algebra.rotation import (
    arc_motion,
    cross_matrix,
    left_turn_jacobian,
    one_rotation_vector,
    rotation_about_y,
    rotation_vector,
)
from rootmatch.arrays import Floats
from rootmatch.errors import InputError
from rootmatch.problems.pose_fit.pose import Pose


@dataclass(frozen=True, eq=False)
class Prior:
    """A predicted pose, in the frame and unit of a fit, as a Gaussian about a pose near which the fit ends."""

    rotation: Floats
    translation: Floats
    root: Floats
    """(6, 6): its product with the errors (ω, τ) has unit covariance."""
    offset: Floats
    """(6,): errors of that pose, in units of their σ."""

    @classmethod
    def of(cls, pose: Pose, centre: Floats, unit: float, near: Pose) -> Prior:
        """The prior for points from which ``centre`` was subtracted and which were divided by ``unit``.

        ``near``: the pose about which it is taken, with axes that turn with the body.
        """
        if pose.covariance is None or pose.R.shape != (3, 3):
            raise InputError("prior: a pose in space with a covariance (6, 6) is needed; give Pose(R, t, covariance)")
        # t' = t + R c, so τ' = τ + ω × R c
        change = np.eye(6)
        change[3:, :3] = -cross_matrix(pose.R @ centre)
        place, covariance = pose.t + pose.R @ centre, change @ pose.covariance[:6, :6] @ change.T
        R, t = near.R, near.t + near.R @ centre
        vector, turn = one_rotation_vector(R @ pose.R.T), np.kron(np.eye(2), R @ pose.R.T)
        off = turn @ np.concatenate([vector, arc_motion(vector, t - place)])
        covariance = turn @ covariance @ turn.T
        units = np.repeat([1.0, unit], 3)
        off, covariance = off / units, covariance / np.outer(units, units)
        deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
        values, vectors = np.linalg.eigh(covariance / np.outer(deviation, deviation))
        # what is known exactly is known very well
        root = (vectors / np.sqrt(np.maximum(values, 1e-12))).T / deviation
        return cls(R, t / unit, root, root @ off)

    def residuals(self, rotation: Floats, translation: Floats) -> Floats:
        """Errors (B, 6) of poses in units of the prior's σ."""
        step = np.concatenate([rotation_vector(rotation @ self.rotation.T), translation - self.translation], axis=1)
        return np.asarray(self.offset + step @ self.root.T)

    def jacobian(self, rotation: Floats, axes: Floats) -> Floats:
        """Their derivatives (B, 6, a + 3) by rotations about the axes (a, 3) and by translations."""
        out = np.zeros((len(rotation), 6, len(axes) + 3))
        out[:, :3, : len(axes)] = left_turn_jacobian(rotation_vector(rotation @ self.rotation.T)) @ axes.T
        out[:, 3:, len(axes) :] = np.eye(3)
        return np.asarray(self.root @ out)


@dataclass(frozen=True, eq=False)
class Upright:
    """A camera whose vertical is known: rotations of world and camera onto y, and the vertical's σ in radians."""

    world: Floats
    camera: Floats
    noise: float

    def turned(self, angle: Floats) -> Floats:
        """Rotations (…, 3, 3) in which the vertical is exact, by angles (…) about it."""
        return np.asarray(self.camera.T @ rotation_about_y(np.cos(angle), np.sin(angle)) @ self.world)

    def nearest(self, rotation: Floats) -> Floats:
        """The rotation (3, 3) nearest to another one in which the vertical is exact."""
        turn = self.camera @ rotation @ self.world.T
        return self.turned(np.arctan2(turn[0, 2] - turn[2, 0], turn[0, 0] + turn[2, 2]))

    def residuals(self, rotation: Floats) -> Floats:
        """Angles (B, 2) between the vertical as measured and as rotated into the camera, about two axes, over σ."""
        down = rotation @ self.world[1] @ self.camera.T
        return np.stack([down[:, 2], -down[:, 0]], axis=1) / self.noise

    def jacobian(self, rotation: Floats, axes: Floats) -> Floats:
        """Their derivatives (B, 2, a + 3) by rotations about the axes (a, 3) and by translations."""
        down = rotation @ self.world[1]
        rows = [np.cross(down, self.camera[2]), np.cross(self.camera[0], down)]
        tilt = np.stack(rows, axis=1) @ axes.T / self.noise
        return np.concatenate([tilt, np.zeros((len(rotation), 2, 3))], axis=-1)
