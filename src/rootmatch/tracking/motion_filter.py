"""A Kalman filter of a pose and its motion: predictions for the next frame, with their covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from rootmatch.arrays import Floats, cache_by_identity
from rootmatch.options import Options, option
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import body_radius, pose_about_point
from rootmatch.problems.pose_fit.shared_errors import SharedErrors, SharedPose
from rootmatch.tracking.in_plane import motion_in_space, points_in_space, pose_in_plane, pose_in_space
from rootmatch.tracking.motion_kernels import move_ahead, take_pose

State = tuple[Floats, Floats, Floats, Floats]
"""Rotation, position of the centre, velocity with acceleration (12,), and the covariance (p + 12, p + 12) of all, with
the p rows of a pose's covariance first."""
Levels = tuple[Floats, Floats, Floats]
"""Of each level of accelerations the covariance (J, p + 12, p + 12), the mean (J, p + 12) from that of all, and the
share (J,)."""
Forecast = tuple[State, Levels, SharedErrors | None]


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
    min_scale, max_scale : float
        Least and largest level of the accelerations, relative to the stated one, which is their root mean square over
        all times; they change level as often as they change. With a least of 0.1, two of 36 flights drifted away from
        poses that few points showed, one with seven frames in a row matched and wrong (benchmarks/tracking.py, seeds
        from 1000, 2000 and 3000). With a largest of 10 one of eight cameras that shake by .7° in each frame lost the
        body, with 5 and 7 none; `Match.advice` says where half of it is reached.
    scale_drift : float
        Of `Similarity`: standard deviation of what the logarithm of the scale changes by in a second, a random walk.
        The unit of a measurement, or the size of a model, is constant; a round value that allows for .6 % in an hour.
    """

    angular_acceleration: float = option(30.0, above=0.0)
    acceleration: float = option(100.0, above=0.0)
    angular_velocity: float = option(4.0, above=0.0)
    velocity: float = option(15.0, above=0.0)
    persistence: float = option(0.1, above=0.0)
    min_scale: float = option(0.5, above=0.0, maximum=1.0)
    max_scale: float = option(7.0, minimum=1.0)
    scale_drift: float = option(1e-4, minimum=0.0)


Tails = tuple[float, float]
"""Degrees of freedom of a prediction's tails, and whether what a fit leaves open counts in them, 1, or not, 0."""
NO_TAILS = math.inf, 0.0
ALIKE = 1.0 + 2.0 * math.cos(0.2)
"""Trace of the rotation between two poses above which they are one. A round value."""
DEFAULT_MOTION = MotionOptions()


@lru_cache(maxsize=16)
def acceleration_levels(minimum: float, maximum: float) -> tuple[Floats, Floats]:
    """Variances (3,) of accelerations over the stated one, from least to largest, and how often each is.

    Each is as much rarer than the one before as makes the stated one their mean.
    """
    variances = np.array([minimum**2, minimum * maximum, maximum**2])
    c, b, a = variances - 1.0
    rarer = 1.0 if a <= 0.0 else (math.sqrt(max(b * b - 4.0 * a * c, 0.0)) - b) / (2.0 * a)
    shares = np.array([1.0, rarer, rarer * rarer])
    return variances, shares / shares.sum()


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
        self.options, self.time = options, time
        self.R, self.t, covariance = self._centred_state(pose)
        self.motion = np.zeros(12)
        size = self.rows = len(covariance)
        self.P = np.zeros((size + 12, size + 12))
        self.P[:size, :size] = covariance
        speeds = self._along_axes(options.angular_velocity, options.velocity * self.radius)
        self.P[size:, size:] = np.diag([*speeds, *self._along_axes(*self._accelerations)]) ** 2
        variances, shares = acceleration_levels(options.min_scale, options.max_scale)
        each = np.tile(self.P, (len(shares), 1, 1))
        each[:, -6:, -6:] *= variances[:, None, None]
        self.levels: Levels = each, np.zeros(each.shape[:2]), shares
        self.shared: SharedErrors | None = None
        """Of the rows of ``P``; None if the errors of all poses are independent."""
        if isinstance(pose, SharedPose):
            self._share(None, pose, np.eye(size + 12, size), np.zeros((size + 12, size)))
        self._ahead: tuple[float, Forecast] | None = None

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
            each, apart, shares = self.levels
            other.levels = np.array([self.shared.whole(one) for one in each]), apart, shares
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
        (R, t, _, P), _, shared = self._forecast(time)
        pose = self._to_own_frame(R, t, P[: self.rows, : self.rows])
        if shared is not None:
            pose = SharedPose.of(pose, shared.moved(np.eye(self.rows, len(P))).about(-self.scale * R @ self.centre))
        return pose_in_plane(pose) if self.flat else pose

    def update(self, pose: Pose, time: float, weight: float = 1.0, *, tails: Tails = NO_TAILS) -> None:
        """Take in a pose that was fitted with the prediction for this time as its prior and therefore includes it.

        What the detections alone tell of the pose is what the fit has beside its prediction. It says how probable each
        level of accelerations is, and updates each (interacting multiple models, Blom and Bar-Shalom 1988).

        ``weight``: probability that the detections belong to the body; otherwise the prediction holds. The update has
        the mean and covariance of both together (probabilistic data association, Bar-Shalom and Tse 1975).
        ``tails``: by which the prediction counted less in the fit.
        """
        before, levels, shared = self._forecast(time)
        pose = pose_in_space(pose, self.radius) if self.flat else pose
        about = *self._centred_state(pose), pose.scale
        state, self.levels = _empty_state(self.P.shape, levels[1].shape)
        self.R, self.t, self.motion, self.P = state
        change = np.empty((len(self.P), self.rows)), np.empty((len(self.P), self.rows))
        rule, out = (weight, *tails), (state, self.levels, *change)
        self.scale = take_pose((before, levels, self.scale), about, rule, out)
        if isinstance(pose, SharedPose):
            self._share(shared, pose, *change)
        self.time, self._ahead = time, None
        if self.rows == 6 and self._is_among(self.centre - self.R.T @ self.t - self.middle):
            self._go_with(-self.R.T @ self.t)

    @property
    def factor(self) -> float:
        """Root mean square of the accelerations of the last time, relative to the stated one."""
        variances, _ = acceleration_levels(self.options.min_scale, self.options.max_scale)
        return math.sqrt(float(variances @ self.levels[2]))

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
        each, apart, shares = self.levels
        self.levels = change @ each @ change.T, apart @ change.T, shares
        if self.shared is not None:
            self.shared = self.shared.moved(change)

    def _middle(self, R: Floats, t: Floats) -> Floats:
        """Position of the body's centre in a state."""
        return np.asarray(t + self.scale * R @ (self.middle - self.centre))

    def _share(self, before: SharedErrors | None, pose: SharedPose, gain: Floats, lost: Floats) -> None:
        """Take in the shared errors of a pose.

        ``gain``, ``lost`` (p + 12, p): what the state changes by with the pose, and by how much less with the errors of
        its prediction, ``before``.
        """
        self.shared = pose.shared.about(pose.scale * pose.R @ self.centre).moved(gain)
        if before is not None:
            kept = np.eye(len(gain))
            kept[:, : self.rows] -= lost
            self.shared = before.moved(kept).plus(self.shared)

    def _at(self, time: float) -> State:
        """Pose and covariance at a time."""
        return self._forecast(time)[0]

    def _forecast(self, time: float) -> Forecast:
        """State, levels and shared errors at a time, kept as an update asks for them once more."""
        if self._ahead is None or self._ahead[0] != time:
            self._ahead = time, self._advance_by(time - self.time)
        return self._ahead[1]

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

    def _advance_by(self, dt: float) -> Forecast:
        """State, levels and shared errors after a time."""
        angular, linear = self._accelerations
        variances, usual = acceleration_levels(self.options.min_scale, self.options.max_scale)
        state, levels = _empty_state(self.P.shape, self.levels[1].shape)
        pushed = np.array(self._along_axes(angular**2, linear**2)), (self.options.scale_drift * self.scale) ** 2 * dt
        rule = usual, math.exp(-dt / self.options.persistence), variances, *pushed
        before = self.R, self.t, self.motion, self.P
        move_ahead(transition(dt, self.options.persistence), before, self.levels, rule, (state, levels))
        return state, levels, self._shared_errors_by(dt, state[0])

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


def _empty_state(shape: tuple[int, ...], means: tuple[int, ...]) -> tuple[State, Levels]:
    """Arrays for a state with a covariance of a shape, and for levels with means of another."""
    state = np.empty((3, 3)), np.empty(3), np.empty(12), np.empty(shape)
    return state, (np.empty((*means, means[1])), np.empty(means), np.empty(means[0]))


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
