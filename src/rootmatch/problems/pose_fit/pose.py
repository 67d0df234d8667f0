"""`Pose`: a rigid motion or similarity with its covariance, as a match yields it and as a caller may give one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.problems.gate import GATE

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

ROUNDED = 1e-3
"""Deviation of RᵀR from the identity that is put down to rounding, as of a matrix in single precision or in a file."""
ASYMMETRIC = 1e-6
"""Relative asymmetry, and negative eigenvalue over the largest, of a covariance that is put down to rounding."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion, or a similarity: x' = scale · R x + t. Unpacks as ``R, t = pose``.

    What x and x' are depends on the problem. Points in space and their image: x in the frame of the points, x' in the
    camera frame (x right, y down, z forward), lengths in the unit of the points. Two images: x in the first camera's
    frame, x' in the second's, t of length 1. Two point sets: x a source point, x' a target point.

    Parameters
    ----------
    R : (k, k) array
        Rotation, k = 3, or 2 for point sets of a plane. With ``Similarity(mirror=True)`` its determinant may be −1.
    t : (k,) array
        Translation.
    covariance : (p, p) array, optional
        Of the errors (ω, τ) of ``R_true = Exp(ω) R``, ``t_true = t + τ``: three rotations in radians about the axes of
        the *target* frame (a perturbation from the left), then three translations in the unit of t. In a plane (one
        angle, two translations). A seventh (fourth) row follows for what else was estimated, ``scale`` or ``focal``.
        What is known exactly, or fixed by convention, has no variance: UP2P with an exact vertical leaves rank 4, two
        images with ∣t∣ = 1 rank 5 at most, so use a pseudo-inverse there; τ is then the part of the error at right
        angles to t (the rest is of second order).
    scale : float
        1 but for `rootmatch.Similarity`.
    focal : float, optional
        Focal length in pixels, where the problem estimates it.
    chi2, dof : float, int, optional
        χ² of the fit and its degrees of freedom.
    rms : float, optional
        Root mean square of ``residuals``, in pixels, or in the unit of the target where that is points in space.
    rms_sigma : float, optional
        √(χ² / dof): about 1 where the given σ is right. NaN where no degree of freedom is left.
    points : (m,) int array, optional
        Indices of the source points that were fitted, ascending.
    predicted : (m, k') array, optional
        Where this pose predicts the target of each; between two images the nearest point of its epipolar line.
    residuals : (m,) array, optional
        Distance of each target from there.
    inliers : (m',) int array, optional
        Those of ``points`` within 3.5 σ of their prediction.
    mirrored : bool
        Whether R is a reflection, as `rootmatch.Similarity` finds with ``mirror=True``; it has no quaternion.

    Raises
    ------
    InputError
        If shapes do not go together, R is no rotation, a number is not finite, or the covariance is not symmetric or
        has a negative eigenvalue.
    """

    R: Floats
    t: Floats
    covariance: Floats | None = None
    scale: float = field(default=1.0, kw_only=True)
    focal: float | None = field(default=None, kw_only=True)
    chi2: float | None = field(default=None, kw_only=True)
    dof: int | None = field(default=None, kw_only=True)
    rms: float | None = field(default=None, kw_only=True)
    rms_sigma: float | None = field(default=None, kw_only=True)
    points: Integers | None = field(default=None, kw_only=True)
    predicted: Floats | None = field(default=None, kw_only=True)
    residuals: Floats | None = field(default=None, kw_only=True)
    inliers: Integers | None = field(default=None, kw_only=True)
    mirrored: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        R = _checked_rotation(self.R, self.mirrored)
        t = _numbers(self.t, "t", f"{len(R)} numbers")
        if t.size != len(R):
            raise InputError(f"pose: t of shape {t.shape} given, ({len(R)},) expected")
        covariance = None if self.covariance is None else _checked_covariance(self.covariance, len(R))
        self.__dict__.update(R=R, t=t.reshape(-1), covariance=covariance)

    @classmethod
    def unchecked(cls, R: Floats, t: Floats, covariance: Floats) -> Pose:
        """A rigid motion whose arrays are known to be right: checks would take a tenth of a tracked frame."""
        pose = cls.__new__(cls)
        pose.__dict__.update(_RIGID, R=R, t=t, covariance=covariance)
        return pose

    def __iter__(self) -> Iterator[Floats]:
        """Rotation and translation."""
        return iter((self.R, self.t))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, covariance: ArrayLike | None = None) -> Pose:
        """The pose of a homogeneous matrix (k + 1, k + 1), as `matrix` gives it.

        Parameters
        ----------
        matrix : (k + 1, k + 1) array
            [[scale · R, t], [0, 1]].
        covariance : (p, p) array, optional
            See `Pose`.

        Raises
        ------
        InputError
            If it is no such matrix, or as `Pose`.
        """
        values = np.asarray(matrix, np.float64)
        if values.shape not in ((3, 3), (4, 4)) or not np.all(np.isfinite(values)):
            raise InputError(f"pose: matrix of shape {values.shape} given; give finite numbers, (4, 4), or (3, 3)")
        k = len(values) - 1
        if not np.allclose(values[k], np.eye(k + 1)[k], rtol=0.0, atol=ROUNDED):
            raise InputError(f"pose: last row {values[k].tolist()} given; that of a rigid motion is 0 … 0 1")
        determinant = float(np.linalg.det(values[:k, :k]))
        scale = abs(determinant) ** (1.0 / k)
        if scale == 0.0:
            raise InputError("pose: a matrix without an inverse given; give a rotation, times a scale if there is one")
        if abs(scale - 1.0) < ROUNDED:
            scale = 1.0
        known = None if covariance is None else np.asarray(covariance, np.float64)
        return cls(values[:k, :k] / scale, values[:k, k], known, scale=scale, mirrored=determinant < 0.0)

    @property
    def matrix(self) -> Floats:
        """The homogeneous matrix (k + 1, k + 1): [[scale · R, t], [0, 1]]."""
        k = len(self.R)
        matrix = np.eye(k + 1)
        matrix[:k, :k], matrix[:k, k] = self.scale * self.R, self.t
        return matrix

    @property
    def quaternion(self) -> Floats:
        """The rotation in space as a unit quaternion (x, y, z, w), w ≥ 0: the order of SciPy, ROS and TUM."""
        return np.asarray(self._rotation("quaternion").as_quat(canonical=True))

    @property
    def rvec(self) -> Floats:
        """The rotation in space as a rotation vector (3,), radians: OpenCV's ``rvec``."""
        return np.asarray(self._rotation("rotation vector").as_rotvec())

    def _rotation(self, name: str) -> Rotation:
        from scipy.spatial.transform import Rotation  # slow to import, rarely needed

        if self.mirrored or len(self.R) != 3:
            kind = "reflection" if self.mirrored else "rotation in a plane"
            raise InputError(f"pose: a {kind} has no {name}; take its matrix")
        return Rotation.from_matrix(self.R)

    def inverse(self) -> Pose:
        """The motion back, from the target's frame to the source's, with its covariance to first order.

        What belongs to a fit, such as ``chi2`` and ``residuals``, is left out.
        """
        back = self.R.T / self.scale
        covariance = None
        if self.covariance is not None:
            k, turns = len(self.R), _turns(len(self.R))
            jacobian = np.eye(len(self.covariance))
            jacobian[:turns, :turns] = -self.R.T if turns == 3 else -1.0
            if self.mirrored:
                jacobian[:turns, :turns] *= -1.0
            jacobian[turns : turns + k, :turns] = back @ _turned(self.t)
            jacobian[turns : turns + k, turns : turns + k] = -back
            if self._scale_is_estimated:
                jacobian[-1, -1] = -1.0 / self.scale**2
                jacobian[turns : turns + k, -1] = back @ self.t / self.scale
            covariance = jacobian @ self.covariance @ jacobian.T
        return Pose(
            self.R.T, -back @ self.t, covariance, scale=1.0 / self.scale, focal=self.focal, mirrored=self.mirrored
        )

    def __matmul__(self, other: Pose) -> Pose:
        """The motion after another one: ``(a @ b).apply(x) == a.apply(b.apply(x))``.

        Errors count to first order and as independent; a pose without a covariance counts as exact. What belongs to a
        fit is left out, and so is a focal length.

        Raises
        ------
        InputError
            If one is a pose in a plane and the other in space.
        """
        if not isinstance(other, Pose):
            return NotImplemented
        if len(self.R) != len(other.R):
            raise InputError("pose: a motion in a plane and one in space do not follow each other")
        moved = self.scale * self.R @ other.t
        covariance = None
        if self.covariance is not None or other.covariance is not None:
            k, turns = len(self.R), _turns(len(self.R))
            size = turns + k + (self._scale_is_estimated or other._scale_is_estimated)
            first, second = np.eye(size), np.eye(size)
            first[turns : turns + k, :turns] = _turned(moved)
            second[:turns, :turns] = self.R if turns == 3 else 1.0
            if self.mirrored:
                second[:turns, :turns] *= -1.0
            second[turns : turns + k, turns : turns + k] = self.scale * self.R
            if size > turns + k:
                first[turns : turns + k, -1] = moved / self.scale
                first[-1, -1], second[-1, -1] = other.scale, self.scale
            parts = [j @ one._rigid_covariance(size) @ j.T for j, one in ((first, self), (second, other))]
            covariance = parts[0] + parts[1]
        return Pose(
            self.R @ other.R,
            moved + self.t,
            covariance,
            scale=self.scale * other.scale,
            mirrored=self.mirrored != other.mirrored,
        )

    @property
    def _scale_is_estimated(self) -> bool:
        """Whether the covariance has a row for the scale."""
        k = len(self.R)
        return self.covariance is not None and self.focal is None and len(self.covariance) > _turns(k) + k

    def _rigid_covariance(self, size: int) -> Floats:
        """The covariance of rotation, translation and, where there is a row for it, scale; zero where unknown."""
        k, out = len(self.R), np.zeros((size, size))
        if self.covariance is not None:
            kept = _turns(k) + k + self._scale_is_estimated
            out[:kept, :kept] = self.covariance[:kept, :kept]
        return out

    def apply(self, points: ArrayLike) -> Floats:
        """Points (…, k) of the source frame in the target frame: scale · R x + t."""
        return np.asarray(self.scale * np.asarray(points, dtype=float) @ self.R.T + self.t)


def _turns(k: int) -> int:
    """Number of angles of a rotation in k dimensions."""
    return 3 if k == 3 else 1


def _turned(x: Floats) -> Floats:
    """Derivative (k, angles) of Exp(ω) x by ω, at ω = 0: ω × x."""
    if len(x) == 2:
        return np.array([[-x[1]], [x[0]]])
    return np.array([[0.0, x[2], -x[1]], [-x[2], 0.0, x[0]], [x[1], -x[0], 0.0]])


_RIGID = {one.name: one.default for one in fields(Pose) if one.default is not MISSING}


def fitted_pose(
    R: Floats,
    t: Floats,
    covariance: Floats,
    *,
    chi2: float,
    dof: int,
    points: Integers,
    predicted: Floats,
    residuals: Floats,
    sigma: Floats,
    scale: float = 1.0,
    focal: float | None = None,
) -> Pose:
    """A pose with what its fit says; ``sigma`` (m,) of each of the residuals on one axis."""
    if np.abs(R.T @ R - np.eye(len(R))).max() > 1e-12:  # hundreds of steps, and wide ones where points say little
        u, _, vt = np.linalg.svd(R)
        R = u @ vt
    return Pose(
        R,
        t,
        _nearest_covariance(covariance),
        scale=scale,
        focal=focal,
        chi2=chi2,
        dof=dof,
        rms=float(np.sqrt((residuals**2).mean())),
        rms_sigma=float(np.sqrt(chi2 / dof)) if dof > 0 else float("nan"),
        points=points,
        predicted=predicted,
        residuals=residuals,
        inliers=points[residuals <= GATE * sigma],
        mirrored=bool(np.linalg.det(R) < 0.0),
    )


def _nearest_covariance(matrix: Floats) -> Floats | None:
    """The covariance nearest to a matrix that is one up to rounding, which is large where points determine little.

    None where they do not determine the pose at all: no number of the covariance can be believed then.
    """
    matrix = 0.5 * (matrix + matrix.T)
    if not np.all(np.isfinite(matrix)):
        return None
    deviation = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    unit = np.outer(deviation, deviation)
    scaled = matrix / np.where(unit > 0.0, unit, 1.0)
    if not np.all(np.isfinite(scaled)):
        return None
    values, vectors = np.linalg.eigh(scaled)
    if values[0] >= 0.0:
        return matrix
    return np.asarray(unit * ((vectors * np.maximum(values, 0.0)) @ vectors.T))


def _numbers(value: ArrayLike, name: str, expected: str) -> Floats:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"pose: {name} is not an array of numbers; give {expected}") from None
    if not np.all(np.isfinite(array)):
        raise InputError(f"pose: {name} holds NaN or infinity; give {expected}")
    return array


def _checked_rotation(value: ArrayLike, mirrored: bool) -> Floats:
    """The rotation, or reflection, nearest to a matrix that is one up to rounding."""
    R = _numbers(value, "R", "a rotation matrix (3, 3)")
    if R.shape not in ((3, 3), (2, 2)):
        raise InputError(f"pose: R of shape {R.shape} given; give a rotation matrix (3, 3), or (2, 2) in a plane")
    off = float(np.abs(R.T @ R - np.eye(len(R))).max())
    if off > ROUNDED or (len(R) == 3 and np.linalg.det(R) < 0.0 and not mirrored):
        why = f"RᵀR is {off:.2g} off the identity" if off > ROUNDED else "its determinant is −1, a reflection"
        raise InputError(f"pose: R is no rotation, {why}; give an orthonormal matrix with determinant 1")
    if off > 1e-12:
        u, _, vt = np.linalg.svd(R)
        R = u @ vt
    return R


def _checked_covariance(value: ArrayLike, dimension: int) -> Floats:
    """A symmetric covariance without negative eigenvalues."""
    size = 6 if dimension == 3 else 3
    covariance = _numbers(value, "covariance", f"a matrix ({size}, {size})")
    if covariance.shape not in ((size, size), (size + 1, size + 1)):
        raise InputError(f"pose: covariance of shape {covariance.shape} given, ({size}, {size}) expected")
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.outer(deviation, deviation)  # angles and lengths have units of their own
    if np.any(np.abs(covariance - covariance.T) > ASYMMETRIC * np.maximum(unit, np.abs(covariance))):
        raise InputError("pose: the covariance is not symmetric; give cov(a, b) = cov(b, a)")
    covariance = 0.5 * (covariance + covariance.T)
    scaled = covariance / np.where(unit > 0.0, unit, 1.0)
    least = float(np.linalg.eigvalsh(scaled)[0])
    if np.any(np.diag(covariance) < 0.0) or least < -ASYMMETRIC:
        raise InputError(
            "pose: the covariance is not positive: it has a negative eigenvalue; give a positive semidefinite one"
        )
    return covariance
