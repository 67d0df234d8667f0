"""What is known of a pose beforehand, in part: the rotation, the position, or which way is down."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.algebra.rotation import (
    angle_count,
    cross_matrix,
    one_rotation_matrix,
    one_rotation_vector,
    rotation_vector,
)
from rootmatch.arrays import Floats
from rootmatch.cameras.vertical import unit_direction, warn_of_degrees
from rootmatch.errors import InputError
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_checks import check_numbers, check_rotation
from rootmatch.problems.pose_fit.shared_errors import SharedPose

MIN_TILT = 1e-5
"""Standard deviation, in radians, of a vertical that is called exact."""
WIDEST = 1.0
"""Largest standard deviation of an angle, in radians: degrees were meant beyond. A round value. Of a rotation, that of
its best known axis: an inertial sensor may know nothing of another."""

SAME = 1e-6
"""Difference up to which two unit vectors of a file are the same: files are rounded. A round value."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PosePrior:
    """What is known of a body's pose x' = R x + t before its image is seen; nothing is assumed about the rest.

    An inertial sensor measures the vertical, or a rotation; a magnetic or acoustic one a position. They can be given in
    any combination, and are taken to be independent of each other. For two point sets in a plane, R is (2, 2) and t
    (2,).

    Parameters
    ----------
    rotation : ((3, 3) array, σ), optional
        R, and its standard deviation in radians: of a rotation about each axis of the camera frame, one number, three,
        or a covariance (3, 3).
    position : ((3,) array, σ), optional
        t, the origin of the points in the camera frame, and its standard deviation in the unit of the points: one
        number, three, or a covariance (3, 3). For an axis of which nothing is known, give the size of the space.
    vertical : ((3,) array, (3,) array, σ), optional
        The same direction, say down, in the frame of the points and in that of the camera, of any length, and its
        standard deviation in radians on each of two axes.

    Raises
    ------
    InputError
        If nothing is given, R is no rotation, a number is not finite, or a standard deviation is negative, or of an
        angle beyond 1 radian.
    """

    rotation: tuple[ArrayLike, ArrayLike] | None = None
    position: tuple[ArrayLike, ArrayLike] | None = None
    vertical: tuple[ArrayLike, ArrayLike, float] | None = None

    def __post_init__(self) -> None:
        if self.rotation is None and self.position is None and self.vertical is None:
            raise InputError("prior: nothing is known; give rotation=, position= or vertical=, or leave the prior out")
        if self.rotation is not None:
            R, sigma = _check_parts("rotation", self.rotation, 2, "(R, σ)")
            R = check_rotation(R, mirrored=False)
            covariance = _covariance("rotation", sigma, angle_count(len(R)))
            each = np.sqrt(np.diag(covariance))
            _check_angle("rotation", float(each.max() if each.max() > np.pi else each.min()))
            self.__dict__.update(rotation=(R, covariance))
        if self.position is not None:
            place, sigma = _check_parts("position", self.position, 2, "(t, σ)")
            t = check_numbers(place, "position", "3 numbers")
            if t.size not in (2, 3):
                raise InputError(f"prior: position of shape {t.shape} given, (3,) expected, or (2,) in a plane")
            self.__dict__.update(position=(t.ravel(), _covariance("position", sigma, t.size)))
        if self.vertical is not None:
            source, camera, tilt = _check_parts(
                "vertical", self.vertical, 3, "(in the points' frame, in the camera's, σ)"
            )
            first, second = (unit_direction(np.ravel(one), "prior: vertical") for one in (source, camera))
            sigma = check_numbers(tilt, "vertical", "a number")
            if sigma.shape != () or sigma < 0.0:
                raise InputError(f"prior: vertical: σ {sigma} given; give one number of radians, not negative")
            _check_angle("vertical", float(sigma))
            self.__dict__.update(vertical=(first, second, float(sigma)))
        parts = [one for one in (self.rotation, self.position, self.vertical) if one is not None]
        if len({len(one[0]) for one in parts}) > 1:  # type: ignore[arg-type]
            raise InputError("prior: some of it is in a plane and some in space; a plane has no vertical")

    def __repr__(self) -> str:
        """The arguments, σ as it was given."""
        parts = [
            f"{name}={_format_value(getattr(self, name))}" for name in ("rotation", "position") if getattr(self, name)
        ]
        if self.vertical is not None:
            source, camera, sigma = self.vertical
            parts.append(f"vertical=({np.asarray(source).tolist()}, {np.asarray(camera).tolist()}, {sigma:.6g})")
        return f"PosePrior({', '.join(parts)})"

    @property
    def turn(self) -> tuple[Floats, Floats] | None:
        """The rotation (3, 3) and its covariance (3, 3), the vertical in it; None if it is not known."""
        if self.rotation is None:
            return None
        R, covariance = (np.asarray(part, np.float64) for part in self.rotation)
        if self.vertical is None:
            return R, covariance
        both = np.eye(6)
        both[:3, :3] = covariance
        pose = update_with_vertical(Pose.unchecked(R, np.zeros(3), both), *self.vertical)  # type: ignore[arg-type]
        assert pose.covariance is not None
        return pose.R, pose.covariance[:3, :3]

    @property
    def place(self) -> tuple[Floats, Floats] | None:
        """The position (3,) and its covariance (3, 3); None if it is not known."""
        return self.position  # type: ignore[return-value]

    @property
    def down(self) -> tuple[Floats, Floats, float] | None:
        """A direction in the frame of the points, in the camera's, and its σ: the vertical, or one of the rotation."""
        if self.vertical is not None or self.turn is None:
            return self.vertical  # type: ignore[return-value]
        R, covariance = self.turn
        return R[1], np.array([0.0, 1.0, 0.0]), float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))

    @property
    def pose(self) -> Pose | None:
        """The whole pose with its covariance, if rotation and position are known."""
        turn, place = self.turn, self.place
        if turn is None or place is None:
            return None
        angles = len(turn[1])
        covariance = np.zeros((angles + len(place[0]),) * 2)
        covariance[:angles, :angles], covariance[angles:, angles:] = turn[1], place[1]
        return Pose.unchecked(turn[0], place[0], covariance)

    @classmethod
    def unchecked(cls, rotation: Any = None, position: Any = None, vertical: Any = None) -> PosePrior:
        """Of values that another prior or problem has checked, σ of rotation and position as covariances."""
        one = object.__new__(cls)
        one.__dict__.update(rotation=rotation, position=position, vertical=vertical)
        return one

    def towards(self, other: PosePrior, share: float) -> PosePrior | None:
        """What both tell, at a time between this one (share 0) and the other (1) or a little beyond; None if nothing.

        σ is that of the nearer.
        """
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("rotation", "position", "vertical")]
        told: list[Any] = [None if None in pair else pair for pair in pairs]
        rotation, position, vertical = told
        k = int(share > 0.5)
        if rotation is not None:
            (first, _), (second, _) = rotation
            rotation = one_rotation_matrix(share * one_rotation_vector(second @ first.T)) @ first, rotation[k][1]
        if position is not None:
            position = position[0][0] + share * (position[1][0] - position[0][0]), position[k][1]
        if vertical is not None:
            (world, first, _), (same, second, _) = vertical
            between = unit_direction(first + share * (second - first), "prior: vertical")
            vertical = (world, between, vertical[k][2]) if np.allclose(world, same, atol=SAME) else None
        nothing = rotation is None and position is None and vertical is None
        return None if nothing else PosePrior.unchecked(rotation, position, vertical)

    def with_prediction(self, pose: Pose) -> Pose:
        """A predicted pose and this together, to first order: what a tracker predicts and a sensor measures."""
        if self.rotation is not None:
            R, covariance = (np.asarray(part, np.float64) for part in self.rotation)
            off = turn_vectors((R @ pose.R.T)[None])[0]
            pose = kalman_update(pose, np.eye(len(off), len(off) + len(R)), off, covariance)
        if self.position is not None:
            t, covariance = (np.asarray(part, np.float64) for part in self.position)
            angles = angle_count(len(t))
            pose = kalman_update(pose, np.eye(len(t), angles + len(t), angles), t - pose.t, covariance)
        return pose if self.vertical is None else update_with_vertical(pose, *self.vertical)  # type: ignore[arg-type]


def update_with_vertical(prior: Pose, world: Floats, camera: Floats, noise: float) -> Pose:
    """A prediction and a measured vertical together.

    Parameters
    ----------
    prior : Pose
    world, camera : (3,) arrays
        The vertical in the frame of the points and in that of the camera, of any length.
    noise : float
        Standard deviation of the second on each of two axes, in radians.
    """
    down = prior.R @ (world / np.linalg.norm(world))
    jacobian = np.concatenate([-cross_matrix(down), np.zeros((3, 3))], axis=1)
    off = camera / np.linalg.norm(camera) - down
    return kalman_update(prior, jacobian, off, max(noise, MIN_TILT) ** 2 * np.eye(3))


def kalman_update(prior: Pose, jacobian: Floats, off: Floats, noise: Floats) -> Pose:
    """A pose after a Kalman update with a measurement off by (k,), of covariance (k, k).

    ``jacobian`` (k, p): by the first p rows of the pose's covariance. A scale changes in its logarithm.
    """
    assert prior.covariance is not None
    size = jacobian.shape[1]
    gain = prior.covariance[:, :size] @ jacobian.T
    total = jacobian @ gain[:size] + noise
    kalman = gain @ _pseudo_inverse(total)
    step, kept = kalman @ off, np.eye(len(prior.covariance))
    kept[:, :size] -= kalman @ jacobian
    # Joseph's form: what is measured exactly leaves no negative variance
    covariance = kept @ prior.covariance @ kept.T + kalman @ noise @ kalman.T
    angles = angle_count(len(prior.t))
    turn, shift, longer = np.split(step, [angles, angles + len(prior.t)])
    scale = prior.scale * math.exp(float(longer.sum()) / prior.scale)
    one = Pose.unchecked(_turn_matrix(turn) @ prior.R, prior.t + shift, 0.5 * (covariance + covariance.T), scale)
    return SharedPose.of(one, prior.shared.moved(kept)) if isinstance(prior, SharedPose) else one


def turn_vectors(rotation: Floats) -> Floats:
    """Rotation vectors (K, 3) of matrices (K, 3, 3), or the angle (K, 1) of those of a plane."""
    if rotation.shape[-1] == 3:
        return rotation_vector(rotation)
    return np.arctan2(rotation[:, 1, 0] - rotation[:, 0, 1], rotation[:, 0, 0] + rotation[:, 1, 1])[:, None]


def _turn_matrix(vector: Floats) -> Floats:
    """The rotation of a vector (3,), or of an angle (1,) in a plane."""
    if len(vector) == 3:
        return one_rotation_matrix(vector)
    cosine, sine = math.cos(vector[0]), math.sin(vector[0])
    return np.array([[cosine, -sine], [sine, cosine]])


def _pseudo_inverse(matrix: Floats) -> Floats:
    """As `numpy.linalg.pinv` of a symmetric matrix, in a third of the time: a tracker asks in every frame."""
    values, axes = np.linalg.eigh(matrix)
    size = np.abs(values)
    told = size > 1e-15 * size.max()
    return np.asarray((axes[:, told] / values[told]) @ axes[:, told].T)


def _check_parts(name: str, given: Any, count: int, expected: str) -> tuple[Any, ...]:
    if not isinstance(given, tuple | list) or len(given) != count:
        raise InputError(f"prior: {name}: give {expected}")
    return tuple(given)


def _check_angle(name: str, sigma: float) -> None:
    if sigma > WIDEST:
        raise InputError(
            f"prior: {name}: σ of {sigma:g} radians given, {np.degrees(sigma):.0f}°; give radians up to {WIDEST:g}, "
            "such as np.radians(2.0) for 2°"
        )
    warn_of_degrees(f"prior: {name}", sigma, stacklevel=5)


def _format_value(part: tuple[ArrayLike, ArrayLike]) -> str:
    """A value with its σ as text: one number, three, or the covariance."""
    value, covariance = (np.asarray(one, np.float64) for one in part)
    each = np.sqrt(np.diag(covariance))
    sigma: Any = covariance.tolist()
    if np.array_equal(covariance, np.diag(np.diag(covariance))):
        sigma = float(f"{each[0]:.6g}") if (each == each[0]).all() else [float(f"{one:.6g}") for one in each]
    return f"({value.tolist()}, {sigma})"


def _covariance(name: str, sigma: Any, size: int) -> Floats:
    """A covariance (k, k) of one number, k, or itself."""
    wide = "π" if name == "rotation" else "the size of the space"
    shapes = f"one number, {size}, or a covariance ({size}, {size})"
    expected = f"σ as {shapes.replace(' 3,', ' three,')}; of an axis of which nothing is known, {wide}"
    array = check_numbers(sigma, name, expected)
    if array.shape not in ((), (size,), (size, size)):
        raise InputError(
            f"prior: {name}: σ of shape {array.shape} given; one number, {size}, or ({size}, {size}) expected"
        )
    if array.ndim < 2:
        if (array < 0.0).any():
            raise InputError(f"prior: {name}: σ {array.min():g} given; a standard deviation is not negative")
        return np.eye(size) * array**2
    if not np.allclose(array, array.T) or np.linalg.eigvalsh(array).min() < -1e-9 * np.abs(array).max():
        raise InputError(f"prior: {name}: the covariance is not symmetric, or has a negative eigenvalue")
    return 0.5 * (array + array.T)
