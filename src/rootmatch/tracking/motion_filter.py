"""A Kalman filter of a pose and its velocity: predictions for the next frame, with their covariance."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import one_rotation_matrix, one_rotation_vector
from rootmatch.explain.near_symmetries import body_radius
from rootmatch.options import Options, option
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import about_point

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MotionOptions(Options):
    """Options for how fast a body may move and change its motion; their effect is measured in benchmarks/tracking.py.

    Lengths are in units of the body's root mean square radius: for a headset with 0.1 m, 100 radii/s² are 10 m/s².
    """

    angular_acceleration: float = option(30.0, above=0.0)
    """Standard deviation of the angular acceleration on each axis, rad/s²: that of a quickly turned head."""
    acceleration: float = option(100.0, above=0.0)
    """Standard deviation of the acceleration on each axis, in radii/s²."""
    angular_velocity: float = option(4.0, above=0.0)
    """Standard deviation of an unknown angular velocity on each axis, rad/s."""
    velocity: float = option(15.0, above=0.0)
    """Standard deviation of an unknown velocity on each axis, in radii/s."""
    memory: float = option(0.1, above=0.0, most=1.0)
    """Weight of the last frame in the estimate of how large the accelerations are. A round value."""
    least_scale: float = option(0.5, above=0.0)
    """Least factor on the accelerations, however good the predictions: a real acceleration lasts for many frames, and
    white noise that adds up as fast is larger. With 0.1, two of 36 flights drifted away from poses that few points
    showed, one with seven frames in a row matched and wrong (benchmarks/tracking.py, seeds from 1000, 2000 and
    3000)."""
    most_scale: float = option(3.0, above=0.0)
    """Largest factor on them. A round value."""


DEFAULT_MOTION = MotionOptions()


class MotionFilter:
    """Pose and velocity of one body with constant velocity but for random accelerations.

    Velocities are those of the body's centre, in the camera frame. Errors are from the left, as those of `Pose`.

    Parameters
    ----------
    source : (n, 3) array
        The body's points.
    pose : Pose
        With a covariance.
    time : float
        Of the pose, seconds.
    options : MotionOptions
    """

    def __init__(self, source: Floats, pose: Pose, time: float, options: MotionOptions = DEFAULT_MOTION) -> None:
        self.centre = source.mean(axis=0)
        self.radius = body_radius(source)
        self.options, self.time, self.scale = options, time, 1.0
        self.R, self.t, covariance = self._centred(pose)
        self.velocity = np.zeros(6)
        self.P = np.zeros((12, 12))
        self.P[:6, :6] = covariance
        unknown = np.repeat([options.angular_velocity, options.velocity * self.radius], 3)
        self.P[6:, 6:] = np.diag(unknown**2)
        self._ahead: tuple[float, Floats, Floats, Floats] | None = None

    def copy(self) -> MotionFilter:
        """An independent copy."""
        return deepcopy(self)

    def turned(self, R: Floats, t: Floats) -> MotionFilter:
        """A filter with the same motion, for the body after a motion x' = R x + t of its points."""
        other = self.copy()
        other.R = self.R @ R
        other.t = self.t + self.R @ (R @ self.centre + t - self.centre)
        other._ahead = None
        return other

    def predicted(self, time: float) -> Pose:
        """The pose at a later time."""
        R, t, P = self._at(time)
        return self._given(R, t, P[:6, :6])

    def update(self, pose: Pose, time: float, weight: float = 1.0) -> None:
        """Take in a pose that was fitted with the prediction for this time as its prior and therefore includes it.

        Parameters
        ----------
        pose : Pose
        time : float
        weight : float
            Probability that the detections belong to the body; otherwise the prediction holds. The update has the mean
            and covariance of both together (probabilistic data association, Bar-Shalom and Tse 1975).
        """
        R, t, P = self._at(time)
        before = (R, t, self.velocity, P)
        self.R, self.t, covariance = self._centred(pose)
        step = np.concatenate([one_rotation_vector(self.R @ R.T), self.t - t])
        prior = P[:6, :6]
        inverse = np.linalg.inv(prior)
        gain = P[6:, :6] @ inverse
        self.velocity = self.velocity + gain @ step
        self.P[:6, :6] = covariance
        self.P[6:, :6] = gain @ covariance
        self.P[:6, 6:] = self.P[6:, :6].T
        rest = P[6:, 6:] - gain @ (prior - covariance) @ gain.T
        self.P[6:, 6:] = 0.5 * (rest + rest.T)
        self.time, self._ahead = time, None
        # expected size of a step: the part of the prior's covariance that the detections removed
        expected = max(6.0 - float(np.trace(covariance @ inverse)), 0.1)
        ratio = min(float(step @ inverse @ step) / expected, 10.0)
        options = self.options
        scale = self.scale * math.sqrt(1.0 + weight * options.memory * (ratio - 1.0))
        self.scale = min(max(scale, options.least_scale), options.most_scale)
        if weight < 1.0:
            self._mixed(weight, before, step)

    def widen(self, pose: Pose, probability: float) -> None:
        """Widen the covariance to allow for another pose with some probability."""
        R, t, _ = self._centred(pose)
        away = np.concatenate([one_rotation_vector(R @ self.R.T), t - self.t])
        self.P[:6, :6] += probability * (1.0 - probability) * np.outer(away, away)

    def _mixed(self, weight: float, before: tuple[Floats, Floats, Floats, Floats], step: Floats) -> None:
        """Weight the update since ``before`` by a probability: the first two moments of both together."""
        R, t, velocity, P = before
        change = np.concatenate([step, self.velocity - velocity])
        self.R = one_rotation_matrix(weight * step[:3]) @ R
        self.t = t + weight * step[3:]
        self.velocity = velocity + weight * change[6:]
        self.P = (1.0 - weight) * P + weight * self.P + weight * (1.0 - weight) * np.outer(change, change)

    def _at(self, time: float) -> tuple[Floats, Floats, Floats]:
        """Pose and covariance at a time, kept because an update needs them again."""
        if self._ahead is None or self._ahead[0] != time:
            self._ahead = (time, *self._ahead_by(time - self.time))
        return self._ahead[1:]

    def _ahead_by(self, dt: float) -> tuple[Floats, Floats, Floats]:
        turn = one_rotation_matrix(self.velocity[:3] * dt)
        F = np.eye(12)
        F[:3, :3] = turn
        F[:6, 6:] = dt * np.eye(6)
        size = np.repeat([self.options.angular_acceleration, self.options.acceleration * self.radius], 3)
        variance = (self.scale * size) ** 2
        P = F @ self.P @ F.T
        diagonal = np.arange(6)
        P[diagonal, diagonal] += 0.25 * dt**4 * variance
        P[diagonal, diagonal + 6] += 0.5 * dt**3 * variance
        P[diagonal + 6, diagonal] += 0.5 * dt**3 * variance
        P[diagonal + 6, diagonal + 6] += dt**2 * variance
        return turn @ self.R, self.t + self.velocity[3:] * dt, P

    def _centred(self, pose: Pose) -> tuple[Floats, Floats, Floats]:
        """Rotation, position of the centre, and their covariance."""
        assert pose.covariance is not None
        return (pose.R, *about_point(pose.R, pose.t, pose.covariance, self.centre))

    def _given(self, R: Floats, t: Floats, covariance: Floats) -> Pose:
        """The pose of the body's own frame."""
        t, covariance = about_point(R, t, covariance, -self.centre)
        return Pose.unchecked(R.copy(), t, 0.5 * (covariance + covariance.T))
