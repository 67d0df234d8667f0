"""A Kalman filter of a pose and its motion: predictions for the next frame, with their covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rootmatch.algebra.rotation import one_rotation_matrix, one_rotation_vector
from rootmatch.arrays import Floats, cache_by_identity
from rootmatch.options import Options, option
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import body_radius, pose_about_point
from rootmatch.problems.pose_fit.shared_errors import SharedErrors, SharedPose, remaining_prediction_error
from rootmatch.tracking.in_plane import motion_in_space, points_in_space, pose_in_plane, pose_in_space
from rootmatch.tracking.motion_kernels import move_ahead, take_pose

State = tuple[Floats, Floats, Floats, Floats]
"""Rotation, position of the centre, velocity with acceleration (12,), and the covariance (p + 12, p + 12) of all, with
the p rows of a pose's covariance first."""


@dataclass(frozen=True)
class MotionOptions(Options):
    """Options for how fast a body may move and change its motion; their effect is measured in benchmarks/tracking.py.

    Lengths are in units of the body's root mean square radius: for a headset with 0.1 m, 100 radii/s² are 10 m/s².
    Below a map of 5 m that is far too much: state what the camera can do.

    Parameters
    ----------
    angular_acceleration, acceleration : float
        Standard deviation on each axis, rad/s², that of a quickly turned head; and radii/s².
    angular_velocity, velocity : float
        Standard deviation on each axis of a velocity that is not known yet, rad/s and radii/s.
    persistence : float
        Seconds for which an acceleration lasts: its correlation time (Singer 1970). With independent ones in each
        frame, predictions from few points were too certain: one of 16 flights followed a wrong pose for 24 frames
        (benchmarks/tracking.py, seeds from 1000 and 1010), with 0.1 none did. Other values were not tried.
    memory : float
        Degrees of freedom over which the estimate of how large the accelerations are is replaced: a frame counts for as
        many as its detections remove from the prediction's covariance, five at 60 Hz and one at 1000. A round value.
    min_scale, max_scale : float
        Bounds of that size, relative to the stated one, however good the predictions: a real acceleration lasts for
        many frames, and white noise that adds up as fast is larger. With a least of 0.1, two of 36 flights drifted away
        from poses that few points showed, one with seven frames in a row matched and wrong (benchmarks/tracking.py,
        seeds from 1000, 2000 and 3000). The largest is a round value, which
        `Match.advice` tells where it is reached.
    scale_drift : float
        Of `Similarity`: standard deviation of what the logarithm of the scale changes by in a second, a random walk.
        The unit of a measurement, or the size of a model, is constant; a round value that allows for .6 % in an hour.
    """

    angular_acceleration: float = option(30.0, above=0.0)
    acceleration: float = option(100.0, above=0.0)
    angular_velocity: float = option(4.0, above=0.0)
    velocity: float = option(15.0, above=0.0)
    persistence: float = option(0.1, above=0.0)
    memory: float = option(50.0, minimum=6.0)
    min_scale: float = option(0.5, above=0.0)
    max_scale: float = option(3.0, above=0.0)
    scale_drift: float = option(1e-4, minimum=0.0)


ALIKE = 1.0 + 2.0 * math.cos(0.2)
"""Trace of the rotation between two poses above which they are one. A round value."""
DEFAULT_MOTION = MotionOptions()
MAX_SURPRISE = 10.0
"""Square of a step over the expected one above which it counts as no larger. A round value."""


def transition(time: float, persistence: float) -> tuple[Floats, Floats]:
    """Transition (3, 3) of position, velocity and acceleration over a time, and the covariance that is added.

    The acceleration has unit variance and the correlation e^(−t/τ) (Singer 1970).
    """
    x = time / persistence
    e = math.exp(-x)
    e2 = e * e
    v, p = persistence, persistence**2  # units of velocity and position, by that of acceleration
    a = p * p * (1.0 - e2 + 2.0 * x + 2.0 * x**3 / 3.0 - 2.0 * x * x - 4.0 * x * e)
    b = p * v * (e2 + 1.0 - 2.0 * e + 2.0 * x * e - 2.0 * x + x * x)
    c, d, f = p * (1.0 - e2 - 2.0 * x * e), v * v * (4.0 * e - 3.0 - e2 + 2.0 * x), v * (e2 + 1.0 - 2.0 * e)
    F = np.array([[1.0, time, p * (e + x - 1.0)], [0.0, 1.0, v * (1.0 - e)], [0.0, 0.0, e]])
    return F, np.array([[a, b, c], [b, d, f], [c, f, 1.0 - e2]])


class MotionFilter:
    """Filter of pose, velocity and acceleration of one body, with random accelerations that last for a while.

    Velocities are those of the body's centre, in the target's frame. Errors are from the left, as those of `Pose`. A
    scale, where one is estimated, has no velocity. Among points that are all around it, as below a map, it is the
    camera that moves and turns: velocities are those of the points where it is.

    ``source``: the body's points; those of a plane are followed in space, where they stay in it. ``pose``: with a
    covariance, (6, 6), or (7, 7) with the scale; in a plane (3, 3) or (4, 4).
    """

    def __init__(self, source: Floats, pose: Pose, time: float, options: MotionOptions = DEFAULT_MOTION) -> None:
        self.scale, self.flat = pose.scale, len(pose.t) == 2
        self.middle, self.extent, radius = _extents(source)
        self.centre, self.radius = self.middle, self.scale * radius
        pose = pose_in_space(pose, self.radius) if self.flat else pose
        if len(np.asarray(pose.covariance)) == 6 and self._is_among(-pose.R.T @ pose.t - self.middle):
            self.centre = -pose.R.T @ pose.t
        self.options, self.time, self.factor = options, time, 1.0
        self.R, self.t, covariance = self._centred_state(pose)
        self.motion = np.zeros(12)
        size = self.rows = len(covariance)
        self.P = np.zeros((size + 12, size + 12))
        self.P[:size, :size] = covariance
        speeds = self._along_axes(options.angular_velocity, options.velocity * self.radius)
        self.P[size:, size:] = np.diag([*speeds, *self._along_axes(*self._accelerations)]) ** 2
        self.shared: SharedErrors | None = None
        """Of the rows of ``P``; None if the errors of all poses are independent."""
        if isinstance(pose, SharedPose):
            self._share(None, pose, np.eye(size + 12, size), np.eye(size))
        self._ahead: tuple[float, State, SharedErrors | None] | None = None

    def copy(self) -> MotionFilter:
        """An independent copy: no array of a filter is ever written into."""
        other = object.__new__(MotionFilter)
        vars(other).update(vars(self))
        return other

    def turned(self, R: Floats, t: Floats) -> MotionFilter:
        """A filter of the same motion, for the body after a motion x' = R x + t of its points.

        It is that of the same place in the camera frame, which is another one of the body: so both expect the same.
        """
        other, (R, t) = self.copy(), motion_in_space(R, t)
        other.R = _remove_rounding(self.R @ R)
        other.centre, other.middle = R.T @ (self.centre - t), R.T @ (self.middle - t)
        other._ahead = None
        return other

    def of_body(self, R: Floats, t: Floats, source: Floats) -> MotionFilter:
        """A filter with the same motion for another body of points (n, 3), which x' = R x + t takes to this one's."""
        other, (R, t) = self.copy(), motion_in_space(R, t)
        other.middle, other.extent, radius = _extents(source)
        other.centre, other.radius = other.middle, self.scale * radius
        other.R = self.R @ R
        other.t = self.t + self.scale * self.R @ (R @ other.centre + t - self.centre)
        if self.shared is not None:  # its points have errors of their own
            other.P, other.shared = self.shared.whole(self.P), None
        other._ahead = None
        return other

    def is_near(self, pose: Pose, time: float) -> bool:
        """Whether a pose at a time is where the body is expected: no two bodies are so near each other."""
        R, t, _, _ = self._at(time)
        pose = pose_in_space(pose, self.radius) if self.flat else pose
        off = pose.t + pose.scale * pose.R @ self.middle - self._middle(R, t)
        return bool((R * pose.R).sum() > ALIKE) and float(np.linalg.norm(off)) <= self.radius

    def is_in_sight(self, pose: Pose, time: float, centres: Floats | None) -> bool:
        """Whether a pose at a time is where a camera is expected to see the body, however it is turned, near or far.

        ``centres``: (C, 3) of the cameras that see the pose; None in a space, whose points have no line of sight: then,
        whether it is where the body is expected.
        """
        R, t, _, _ = self._at(time)
        pose = pose_in_space(pose, self.radius) if self.flat else pose
        t, middle = self._middle(R, t), pose.t + pose.scale * pose.R @ self.middle
        if centres is None:
            return float(np.linalg.norm(middle - t)) <= self.radius
        off, away = np.cross(middle - centres, t - centres), np.linalg.norm(t - centres, axis=1)
        return bool((np.linalg.norm(off, axis=1) <= self.radius * away).any())

    def predicted(self, time: float) -> Pose:
        """The pose at a later time; a `SharedPose` if its errors are those of earlier frames."""
        R, t, _, P = self._at(time)
        pose, shared = self._to_own_frame(R, t, P[: self.rows, : self.rows]), self._shared_errors_at(time)
        if shared is not None:
            pose = SharedPose.of(pose, shared.moved(np.eye(self.rows, len(P))).about(-self.scale * R @ self.centre))
        return pose_in_plane(pose) if self.flat else pose

    def update(self, pose: Pose, time: float, weight: float = 1.0) -> None:
        """Take in a pose that was fitted with the prediction for this time as its prior and therefore includes it.

        ``weight``: probability that the detections belong to the body; otherwise the prediction holds. The update has
        the mean and covariance of both together (probabilistic data association, Bar-Shalom and Tse 1975).
        """
        R, t, motion, P = before = self._at(time)
        pose = pose_in_space(pose, self.radius) if self.flat else pose
        size, scale, shared = self.rows, self.scale, self._shared_errors_at(time)
        self.R, self.t, covariance = self._centred_state(pose)
        self.scale = pose.scale
        step = np.array([*one_rotation_vector(self.R @ R.T), *(self.t - t), self.scale - scale])[:size]
        self.motion, self.P, inverse, bent = np.empty(12), np.empty(P.shape), np.empty((size, size)), np.empty(P.shape)
        left, squared = take_pose((motion, P), step, covariance, (self.motion, self.P, inverse, bent))
        if isinstance(pose, SharedPose):
            self._share(
                shared,
                pose,
                weight * bent[:, :size] @ inverse,
                remaining_prediction_error(covariance, bent[:size, :size]),
            )
        self.time, self._ahead = time, None
        # expected square of a step: the part of the prior's covariance that the detections removed
        expected, options = max(size - left, 0.0), self.options
        more = min(squared, MAX_SURPRISE * expected) - expected
        factor = self.factor * math.sqrt(1.0 + weight * more / options.memory)
        self.factor = min(max(factor, options.min_scale), options.max_scale)
        if weight < 1.0:
            self.scale = scale + weight * (self.scale - scale)
            self._mix(weight, before, step)
        if size == 6 and self._is_among(self.centre - self.R.T @ self.t - self.middle):
            self._go_with(-self.R.T @ self.t)

    def _is_among(self, offset: Floats) -> bool:
        """Whether a camera at a point of the body's frame, from its centre, has the body's points around it."""
        return math.sqrt(offset @ offset) < self.extent

    def _go_with(self, arm: Floats) -> None:
        """Refer position, velocity and acceleration to another point, ``arm`` from the one so far, in the body."""
        change, arm = np.eye(len(self.P)), self.R @ arm
        x, y, z = arm
        for k in range(0, len(change), 6):
            change[k + 3 : k + 6, k : k + 3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        self.centre, self.t = self.centre + self.R.T @ arm, self.t + arm
        self.motion, self.P, self._ahead = change[6:, 6:] @ self.motion, change @ self.P @ change.T, None
        if self.shared is not None:
            self.shared = self.shared.moved(change)

    def _middle(self, R: Floats, t: Floats) -> Floats:
        """Position of the body's centre in a state."""
        return np.asarray(t + self.scale * R @ (self.middle - self.centre))

    def _mix(self, weight: float, before: State, step: Floats) -> None:
        """Take the update since ``before`` with a probability: first two moments of both together."""
        R, t, motion, P = before
        change = np.concatenate([step, self.motion - motion])
        self.R = one_rotation_matrix(weight * step[:3]) @ R
        self.t = t + weight * step[3:6]
        self.motion = motion + weight * change[self.rows :]
        self.P = (1.0 - weight) * P + weight * self.P + weight * (1.0 - weight) * np.outer(change, change)

    def _share(self, before: SharedErrors | None, pose: SharedPose, gain: Floats, left: Floats) -> None:
        """Take in the shared errors of a pose.

        ``gain`` (p + 12, p): what the state changes by with the pose; ``left`` (p, p): what the fit of the pose leaves
        of the errors of its prediction, ``before``.
        """
        self.shared = pose.shared.about(pose.scale * pose.R @ self.centre).moved(gain)
        if before is not None:
            kept = np.eye(len(gain))
            kept[:, : self.rows] -= gain @ (np.eye(self.rows) - left)
            self.shared = before.moved(kept).plus(self.shared)

    def _at(self, time: float) -> State:
        """Pose and covariance at a time, kept as an update asks for them once more."""
        if self._ahead is None or self._ahead[0] != time:
            state = self._advance_by(time - self.time)
            self._ahead = time, state, self._shared_errors_by(time - self.time, state[0])
        return self._ahead[1]

    def _shared_errors_at(self, time: float) -> SharedErrors | None:
        """Shared errors at a time."""
        self._at(time)
        return None if self._ahead is None else self._ahead[2]

    def _shared_errors_by(self, dt: float, R: Floats) -> SharedErrors | None:
        """Shared errors after a time, at a rotation: they move as all others do."""
        if self.shared is None:
            return None
        move, moving = np.eye(len(self.P)), np.append(np.arange(6), np.arange(self.rows, len(self.P)))
        move[np.ix_(moving, moving)] = np.kron(transition(dt, self.options.persistence)[0], np.eye(6))
        move[:3, :3] = R @ self.R.T
        return self.shared.moved(move)

    @property
    def _accelerations(self) -> tuple[float, float]:
        """Standard deviations of the angular acceleration and of that of the centre, on each axis."""
        return self.options.angular_acceleration, self.options.acceleration * self.radius

    def _along_axes(self, turn: float, shift: float) -> tuple[float, ...]:
        """What the body has of each turn and each shift, three of either; in a plane none of those out of it."""
        return (0.0, 0.0, turn, shift, shift, 0.0) if self.flat else (turn, turn, turn, shift, shift, shift)

    def _advance_by(self, dt: float) -> State:
        angular, linear = self._accelerations
        of_scale = (self.options.scale_drift * self.scale) ** 2 * dt
        variances = np.array([*self._along_axes((self.factor * angular) ** 2, (self.factor * linear) ** 2), of_scale])
        out = np.empty((3, 3)), np.empty(3), np.empty(12), np.empty(self.P.shape)
        state = self.R, self.t, self.motion, self.P, variances
        move_ahead(*transition(dt, self.options.persistence), state, out)
        return out

    def _centred_state(self, pose: Pose) -> tuple[Floats, Floats, Floats]:
        """Rotation, position of the centre, and their covariance."""
        assert pose.covariance is not None
        return (
            np.array(pose.R, order="C"),
            *pose_about_point(pose.R, pose.t, pose.covariance, self.centre, pose.scale),
        )

    def _to_own_frame(self, R: Floats, t: Floats, covariance: Floats) -> Pose:
        """The pose of the body's own frame."""
        t, covariance = pose_about_point(R, t, covariance, -self.centre, self.scale)
        return Pose.unchecked(R.copy(), t, 0.5 * (covariance + covariance.T), self.scale)


@cache_by_identity(64)
def _extents(source: Floats) -> tuple[Floats, float, float]:
    """Centre (3,) of a body's points (n, k), how far the farthest is from it, and their radius."""
    source = points_in_space(source)
    middle = source.mean(axis=0)
    return middle, float(np.linalg.norm(source - middle, axis=1).max()), body_radius(source)


def _remove_rounding(R: Floats) -> Floats:
    """A rotation (3, 3) without what rounding adds, to first order.

    The motion between two poses is told with Rᵀ as the inverse of R, and turns one of them in every frame: an error of
    R would be twice as large in the next one or more, and two poses that are equal would differ within a second.
    """
    return np.asarray(R @ (1.5 * np.eye(3) - 0.5 * R.T @ R))
