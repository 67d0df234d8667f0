"""`Pose`: a rigid motion or similarity with its covariance, as a match yields it and as a caller may give one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.problems.gate import GATE

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
    chi2, freedom : float, int, optional
        χ² of the fit and its degrees of freedom.
    rms : float, optional
        Root mean square of ``residuals``, in pixels, or in the unit of the target where that is points in space.
    rms_sigma : float, optional
        √(χ² / freedom): about 1 where the given σ is right. NaN where no degree of freedom is left.
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

    @property
    def quaternion(self) -> Floats:
        """The rotation in space as a unit quaternion (x, y, z, w), w ≥ 0: the order of TUM's trajectories."""
        from scipy.spatial.transform import Rotation  # slow to import, rarely needed

        if self.mirrored:
            raise InputError("pose: a reflection has no quaternion; write it as a matrix, to JSON")
        return np.asarray(Rotation.from_matrix(self.R).as_quat(canonical=True))

    def apply(self, points: ArrayLike) -> Floats:
        """Points (…, k) of the source frame in the target frame: scale · R x + t."""
        return np.asarray(self.scale * np.asarray(points, dtype=float) @ self.R.T + self.t)


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
