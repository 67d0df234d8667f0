"""`Pose`: a rigid motion or similarity with its covariance, as a match yields it and as a caller may give one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, field, fields
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.algebra.rotation import angle_count, turn_jacobian
from rootmatch.arrays import Floats, Integers, as_floats
from rootmatch.cameras.pinhole import check_rows
from rootmatch.errors import InputError, quote_value
from rootmatch.problems.pose_fit.pose_checks import (
    AXES,
    ROUNDED,
    check_covariance,
    check_numbers,
    check_rotation,
    nearest_covariance,
    quaternion_to_rotation,
)
from rootmatch.problems.pose_fit.registration_error import RegistrationError, registration_error

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion, or a similarity: x' = scale · R x + t. Unpacks as ``R, t = pose``.

    The frames of x and x' depend on the problem. For points in space and their image, x is in the frame of the points
    and x' in the camera frame (x right, y down, z forward), with lengths in the unit of the points. For two images, x
    is in the first camera's frame and x' in the second's, and t has length 1. For two point sets, x is a source point
    and x' a target point.

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
        √(χ² / dof): about 1 where the given σ is right. NaN if no degree of freedom is left.
    points : (m,) int array, optional
        Indices of the source points that were fitted, ascending.
    predicted : (m, k') array, optional
        Where this pose predicts the target of each point; between two images, the nearest point of its epipolar line.
    residuals : (m,) array, optional
        Distance of each target from there.
    inliers : (m',) int array, optional
        Those of ``points`` within 3.5 σ of their prediction.
    mirrored : bool
        Whether R is a reflection, as `rootmatch.Similarity` finds with ``mirror=True``; it has no quaternion.

    Raises
    ------
    InputError
        If the shapes do not fit together, R is not a rotation, a number is not finite, the scale is not positive, or
        the covariance is not symmetric or has a negative eigenvalue.
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
    points: Integers | None = field(default=None, repr=False, kw_only=True)
    predicted: Floats | None = field(default=None, repr=False, kw_only=True)
    residuals: Floats | None = field(default=None, repr=False, kw_only=True)
    inliers: Integers | None = field(default=None, repr=False, kw_only=True)
    mirrored: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        R = check_rotation(self.R, self.mirrored)
        t = check_numbers(self.t, "t", f"{len(R)} numbers")
        if t.size != len(R):
            raise InputError(f"pose: t of shape {t.shape} given, ({len(R)},) expected")
        covariance = None if self.covariance is None else check_covariance(self.covariance, len(R))
        if not (isinstance(self.scale, int | float | np.number) and 0.0 < self.scale < math.inf):
            raise InputError(f"pose: scale {quote_value(self.scale)} given; give a positive number")
        self.__dict__.update(R=R, t=t.reshape(-1), covariance=covariance)

    @classmethod
    def unchecked(cls, R: Floats, t: Floats, covariance: Floats, scale: float = 1.0) -> Pose:
        """A motion whose arrays are known to be right: checks would take a tenth of a tracked frame."""
        pose = cls.__new__(cls)
        pose.__dict__.update(_OPTIONAL, R=R, t=t, covariance=covariance, scale=scale)
        return pose

    def __iter__(self) -> Iterator[Floats]:
        """Rotation and translation."""
        return iter((self.R, self.t))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, covariance: ArrayLike | None = None) -> Pose:
        """The pose of a homogeneous matrix (k + 1, k + 1), as `matrix` gives it.

        Raises
        ------
        InputError
            If it is not such a matrix, or as `Pose`.
        """
        values = as_floats(matrix, "pose", "a matrix (4, 4), or (3, 3)")
        if values.shape not in ((3, 3), (4, 4)) or not np.all(np.isfinite(values)):
            raise InputError(f"pose: matrix of shape {values.shape} given; give finite numbers, (4, 4), or (3, 3)")
        k = len(values) - 1
        if not np.allclose(values[k], np.eye(k + 1)[k], rtol=0.0, atol=ROUNDED):
            raise InputError(f"pose: last row {values[k].tolist()} given; that of a rigid motion is 0 … 0 1")
        determinant = float(np.linalg.det(values[:k, :k]))
        if determinant == 0.0:
            raise InputError("pose: a singular matrix given; give a rotation, times a scale if there is one")
        scale = abs(determinant) ** (1.0 / k)
        scale = 1.0 if abs(scale - 1.0) < ROUNDED else scale
        known = None if covariance is None else as_floats(covariance, "pose", "a covariance")
        return cls(values[:k, :k] / scale, values[:k, k], known, scale=scale, mirrored=determinant < 0.0)

    @classmethod
    def from_rvec(cls, rvec: ArrayLike, t: ArrayLike, covariance: ArrayLike | None = None) -> Pose:
        """The pose of a rotation vector (3,), radians, and a translation, as ``cv2.solvePnP`` returns them.

        Raises
        ------
        InputError
            As `Pose`.
        """
        from scipy.spatial.transform import Rotation  # slow to import, rarely needed

        turn = check_numbers(rvec, "rvec", "3 numbers")
        if turn.size != 3:
            raise InputError(f"pose: rvec of shape {turn.shape} given, (3,) expected")
        return cls(Rotation.from_rotvec(turn.reshape(3)).as_matrix(), t, covariance)  # type: ignore[arg-type]

    @classmethod
    def from_quaternion(
        cls, quaternion: ArrayLike, t: ArrayLike, covariance: ArrayLike | None = None, *, order: Literal["xyzw", "wxyz"]
    ) -> Pose:
        """The pose of a unit quaternion (4,) and a translation.

        Parameters
        ----------
        quaternion, t, covariance : arrays
        order : {"xyzw", "wxyz"}
            The number that comes first: x for SciPy, ROS, OpenXR and TUM, w for COLMAP and Eigen's constructor. There
            is no default, because the wrong order is a rotation too.

        Raises
        ------
        InputError
            If the order is neither, the length is not 1, or as `Pose`.
        """
        return cls(quaternion_to_rotation(quaternion, order), t, covariance)  # type: ignore[arg-type]

    @property
    def matrix(self) -> Floats:
        """The homogeneous matrix (k + 1, k + 1): [[scale · R, t], [0, 1]]."""
        matrix = np.eye(len(self.R) + 1)
        matrix[:-1, :-1], matrix[:-1, -1] = self.scale * self.R, self.t
        return matrix

    @property
    def quaternion(self) -> Floats:
        """The rotation in space as a unit quaternion (x, y, z, w), w ≥ 0: the order of SciPy, ROS, OpenXR and TUM."""
        return np.asarray(self._rotation("quaternion").as_quat(canonical=True))

    @property
    def quaternion_wxyz(self) -> Floats:
        """The rotation in space as a unit quaternion (w, x, y, z): the order of COLMAP and Eigen's constructor."""
        return np.roll(self.quaternion, 1)

    @property
    def rvec(self) -> Floats:
        """The rotation in space as a rotation vector (3,), radians: OpenCV's ``rvec``."""
        return np.asarray(self._rotation("rotation vector").as_rotvec())

    def _rotation(self, name: str) -> Rotation:
        from scipy.spatial.transform import Rotation  # slow to import, rarely needed

        if self.mirrored or len(self.R) != 3:
            kind = "reflection" if self.mirrored else "rotation in a plane"
            raise InputError(f"pose: a {kind} has no {name}; use its matrix")
        return Rotation.from_matrix(self.R)

    def inverse(self) -> Pose:
        """The inverse motion, from the target's frame to the source's, with its covariance to first order.

        Attributes of a fit, such as ``chi2`` and ``residuals``, are left out.
        """
        back = self.R.T / self.scale
        covariance = None
        if self.covariance is not None:
            k, turns = len(self.R), angle_count(len(self.R))
            jacobian = np.eye(len(self.covariance))
            jacobian[:turns, :turns] = (1.0 if self.mirrored else -1.0) * (self.R.T if turns == 3 else 1.0)
            jacobian[turns : turns + k, :turns] = back @ turn_jacobian(self.t)
            jacobian[turns : turns + k, turns : turns + k] = -back
            if self._scale_is_estimated:
                jacobian[-1, -1] = -1.0 / self.scale**2
                jacobian[turns : turns + k, -1] = back @ self.t / self.scale
            covariance = nearest_covariance(jacobian @ self.covariance @ jacobian.T)  # a remote origin rounds it
        return Pose(
            self.R.T, -back @ self.t, covariance, scale=1.0 / self.scale, focal=self.focal, mirrored=self.mirrored
        )

    __array_ufunc__ = None  # a matrix before @ leaves the answer to the pose

    def __matmul__(self, other: Pose) -> Pose:
        """The motion after another one: ``(a @ b).transform(x) == a.transform(b.transform(x))``.

        Errors count to first order and as independent; a pose without a covariance counts as exact. What belongs to a
        fit is left out, and so is a focal length.

        Raises
        ------
        InputError
            If the other one is no pose, or one is in a plane and the other in space.
        """
        if not isinstance(other, Pose):
            remedy = "give a Pose, of a matrix Pose.from_matrix, and move points with transform"
            raise InputError(f"pose: composed with {type(other).__name__}; {remedy}")
        if len(self.R) != len(other.R):
            raise InputError("pose: a motion in a plane and one in space cannot be composed")
        moved = self.scale * self.R @ other.t
        covariance = None
        if self.covariance is not None or other.covariance is not None:
            k, turns = len(self.R), angle_count(len(self.R))
            size = turns + k + (self._scale_is_estimated or other._scale_is_estimated)
            first, second = np.eye(size), np.eye(size)
            first[turns : turns + k, :turns] = turn_jacobian(moved)
            second[:turns, :turns] = self.R if turns == 3 else 1.0
            if self.mirrored:
                second[:turns, :turns] *= -1.0
            second[turns : turns + k, turns : turns + k] = self.scale * self.R
            if size > turns + k:
                first[turns : turns + k, -1] = moved / self.scale
                first[-1, -1], second[-1, -1] = other.scale, self.scale
            parts = [j @ one._rigid_covariance(size) @ j.T for j, one in ((first, self), (second, other))]
            covariance = nearest_covariance(parts[0] + parts[1])
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
        return self.covariance is not None and self.focal is None and len(self.covariance) > angle_count(k) + k

    def _rigid_covariance(self, size: int) -> Floats:
        """The covariance of rotation, translation and, where there is a row for it, scale; zero where unknown."""
        k, out = len(self.R), np.zeros((size, size))
        if self.covariance is not None:
            kept = angle_count(k) + k + self._scale_is_estimated
            out[:kept, :kept] = self.covariance[:kept, :kept]
        return out

    def transform(self, points: ArrayLike) -> Floats:
        """Points (…, k) of the source frame in the target frame: scale · R x + t; points of NaN stay NaN.

        Raises
        ------
        InputError
            If the points do not have k coordinates.
        """
        return np.asarray(self.scale * check_rows(points, len(self.R), "pose", "points") @ self.R.T + self.t)

    def in_axes(self, axes: Literal["opencv", "opengl", "openxr", "ros"]) -> Pose:
        """The pose with the camera axes of another library; the covariance is converted too.

        Parameters
        ----------
        axes : {"opencv", "opengl", "openxr", "ros"}
            x right, y down, z forward (this library's own); x right, y up, z backward; x forward, y left, z up.

        Raises
        ------
        InputError
            For other axes, and for a pose in a plane.
        """
        if not isinstance(axes, str) or axes not in AXES:
            raise InputError(f"pose: axes {quote_value(axes)} given; give one of {', '.join(AXES)}")
        return Pose(AXES[axes], np.zeros(3)) @ self

    def tre(self, points: ArrayLike) -> RegistrationError:
        """Target registration error: the expected error of this pose at points (…, k) of the source frame.

        It holds for points that took no part in the fit, to first order, and follows from the covariance; `fre` is the
        error of the fiducials themselves.

        Raises
        ------
        InputError
            If the pose has no covariance, or the points do not have k coordinates.
        """
        return registration_error(self.R, self.scale, self.covariance, points)

    @property
    def fre(self) -> float:
        """Fiducial registration error of two point sets: root mean square distance of fitted points, after the fit.

        It says little about `tre`: fewer fiducials fit better but register worse.

        Raises
        ------
        InputError
            If the pose was not fitted to two point sets: in an image there is ``rms``, in pixels.
        """
        size = 0 if self.covariance is None else len(self.covariance)
        count = 0 if self.points is None else len(self.points)
        if (
            self.rms is None or self.dof is None or self.dof + size != len(self.R) * count
        ):  # images have two coordinates
            raise InputError("pose: FRE is only for a pose fitted to two point sets; use rms, which is in pixels")
        return self.rms


_OPTIONAL = {one.name: one.default for one in fields(Pose) if one.default is not MISSING}
