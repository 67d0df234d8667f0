"""Relative poses of whole assignments between two images with a common direction (Gauss-Newton)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross_matrix, rotation_about_y
from rootmatch.cameras.base import CameraModel
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.base import SETTLED, STEPS, Fit, Floats, invertible
from rootmatch.problems.pose_fit.relative_steps import ALONG, DELTA

ANGLES = 90
"""Rotations about the common direction that are tried, 4° apart. Not tuned."""
STARTS = 3
"""The best of them, from which an assignment is fitted. Not tuned."""
FITS_PER_THREAD = 16
"""Fits that are worth waking a thread for, some milliseconds. Changes no result."""
LOG_GAMMA = np.vectorize(math.lgamma, otypes=[float])


@dataclass(frozen=True, eq=False)
class Views:
    """Two images and their noise, in frames whose y is the common direction.

    Attributes
    ----------
    first, second : (n, 3) and (n', 3) arrays
        Rays of any length: of a pinhole, the third coordinate of the camera frame is 1.
    first_axes, second_axes : (n, 3, 2) and (n', 3, 2) arrays
        How such a ray moves with a pixel of its image.
    first_sigma, second_sigma : (n,) and (n',) arrays
        Pixels.
    tilt : float
        Standard deviation in radians of the one direction against the other, on each of two axes; 0 for none.
    focal : float
        Of the second image, in pixels.
    """

    first: Floats
    second: Floats
    first_axes: Floats
    second_axes: Floats
    first_sigma: Floats
    second_sigma: Floats
    tilt: float
    focal: float

    @classmethod
    def of(
        cls, points: PointSets, cameras: tuple[CameraModel, CameraModel], rotations: tuple[Floats, Floats], tilt: float
    ) -> Views:
        """Views of pixels, each rotated so that the common direction is y."""
        rays, axes = [], []
        for pixels, camera, rotation in zip((points.source, points.target), cameras, rotations, strict=True):
            ray, own_axes = camera.axes(pixels)
            rays.append(ray @ rotation.T)
            axes.append(rotation @ own_axes)
        return cls(
            first=rays[0],
            second=rays[1],
            first_axes=axes[0],
            second_axes=axes[1],
            first_sigma=points.source_noise,
            second_sigma=points.target_noise,
            tilt=tilt,
            focal=cameras[1].focal,
        )

    @property
    def arrays(self) -> tuple[Any, ...]:
        """Input of compiled fits: rays, their axes, σ and the focal length."""
        numbers = self.first, self.second, self.first_axes, self.second_axes, self.first_sigma, self.second_sigma
        return *(np.ascontiguousarray(array, np.float64) for array in numbers), float(self.focal)

    def deviations(self, essential: Floats, i: NDArray[np.int64], k: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Epipolar deviations in σ, and σ across the line in the second image in pixels, of pairs (…, m) of indices.

        ``essential`` (…, 3, 3); first-order (Sampson) variance of both pixels.
        """
        first, second = self.first[i], self.second[k]
        line = (essential[..., None, :, :] @ first[..., None])[..., 0]
        value = (second * line).sum(axis=-1)
        by_second = ((line[..., None, :] @ self.second_axes[k])[..., 0, :] ** 2).sum(axis=-1)
        back = (second[..., None, :] @ essential[..., None, :, :])[..., 0, :]
        by_first = ((back[..., None, :] @ self.first_axes[i])[..., 0, :] ** 2).sum(axis=-1)
        variance = by_second * self.second_sigma[k] ** 2 + by_first * self.first_sigma[i] ** 2
        deviation = np.sqrt(np.maximum(variance, 1e-300))
        return value / deviation, deviation / np.sqrt(np.maximum(by_second, 1e-300))

    def from_lines(self, essential: Floats, i: NDArray[np.int64], k: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Vectors (m, 2) in pixels to detections from their epipolar lines, and σ of their lengths, both ends noisy."""
        deviation, width = self.deviations(essential, i, k)
        slope = (essential @ self.first[i][..., None])[..., 0][..., None, :] @ self.second_axes[k]
        direction = slope[..., 0, :] / np.maximum(np.linalg.norm(slope[..., 0, :], axis=-1, keepdims=True), 1e-300)
        return (deviation * width)[..., None] * direction, width

    def parallax(self, rotation: Floats, translation: Floats, i: NDArray[np.int64], k: NDArray[np.int64]) -> Floats:
        """How far detections (…, m) lie along their epipolar lines from where points at infinity are seen, in pixels.

        Positive towards the epipole: in front of both cameras, for this sign of the translation.
        """
        far = (rotation[..., None, :, :] @ self.first[i][..., None])[..., 0]
        far = far / np.linalg.norm(far, axis=-1, keepdims=True)
        towards = translation[..., None, :] - (far * translation[..., None, :]).sum(axis=-1, keepdims=True) * far
        towards = towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-300)
        second = self.second[k]
        return np.asarray(self.focal * np.arctan2((second * towards).sum(axis=-1), (second * far).sum(axis=-1)))


@dataclass(frozen=True, eq=False)
class RelativeFit(Fit):
    """Relative poses of K assignments; see `Fit`. Detections count by the distance from the epipolar line and along it.

    Points of one scene have parallaxes of one order: they are taken to be normal, on the side of the points that lie
    in front of the cameras, with a scale of which nothing is known. With m of squared sum Q their density is
    ½ (2 / √π)ᵐ Γ(m / 2) Q^(−m / 2). This is part of what the pose is fitted to.
    """

    doubt: ClassVar[float] = 2.0
    """Factor by which log-odds are too large, as Laplace's method is rough here; see docs/architecture.md."""
    views: Views
    assignments: NDArray[np.int64]
    pose: Floats
    """(K, p): rotation, two angles of the translation from `base`, and two tilts where the direction is noisy."""
    base: Floats
    """(K, 3, 3): translation, and two directions orthogonal to it."""
    covariance: Floats
    sign: Floats
    """(K,) of the translation."""

    def of_pose(self, k: int, density: Floats) -> float:
        """Logarithm of the prior density of assignment k's pose, which the evidence lacks.

        Rotation and direction of translation are uniform, parallaxes 0.001 to 1 image. ``density`` (n',): detections
        per pixel² about each; the prior does not depend on it.
        """
        laplace = 0.5 * self.pose.shape[1] * np.log(2.0 * np.pi)
        tilt = np.log(2.0 * np.pi * self.views.tilt**2) if self.views.tilt > 0.0 else 0.0
        return float(laplace - np.log(8.0 * np.pi**2) - np.log(np.log(1e3)) - tilt)

    def densities(self, k: int, inflation: float = 1.0) -> Floats:
        """Logarithm of the predictive density per pixel² of each detection as the image of each point, (n, n').

        The prediction is that of the other points of assignment k: a point's own match is left out. ``inflation``:
        factor on all variances.
        """
        views, assignment = self.views, self.assignments[k]
        n, n_target = len(views.first), len(views.second)
        i, j = np.divmod(np.arange(n * n_target), n_target)
        poses = np.concatenate([self.pose[k][None], _moved(self.pose[k])])
        deviation, width = views.deviations(_essential(poses, self.base[k][None]), i, j)
        value = deviation[0].reshape(n, n_target)
        slope = ((deviation[1:] - deviation[0]) / DELTA).T.reshape(n, n_target, -1)
        covariance = self.covariance[k]
        matched = np.flatnonzero(assignment >= 0)
        own, own_slope = value[matched, assignment[matched]], slope[matched, assignment[matched]]
        hat = np.einsum("mp,pq,mq->m", own_slope, covariance, own_slope)
        # without its own match: the pose moves, and is less certain
        spread = np.repeat(covariance[None], n, axis=0)
        along, rest = own_slope @ covariance, 1.0 / np.maximum(1.0 - hat, 1e-9)
        spread[matched] += rest[:, None, None] * along[:, :, None] * along[:, None, :]
        moved = np.zeros((n, covariance.shape[0]))
        moved[matched] = rest[:, None] * along * own[:, None]
        value = value + np.einsum("nkp,np->nk", slope, moved)
        variance = 1.0 + np.einsum("nkp,npq,nkq->nk", slope, spread, slope)
        width = width[0].reshape(n, n_target)
        log = np.log(2.0 * np.pi * inflation * variance * width**2)
        along = self.sign[k] * views.parallax(
            _rotation(self.pose[k]), _translation(self.pose[k], self.base[k]), i, j
        ).reshape(n, n_target)
        size, behind = _sized(along, width)
        others = np.zeros(n)
        others[matched] = size[matched, assignment[matched]] ** 2
        total = (others.sum() - others)[:, None]
        count = np.maximum((assignment >= 0).sum() - (assignment >= 0), 1)[:, None]
        position = _parallax_density(total + size**2, count + 1) - _parallax_density(total, count) - behind
        return np.asarray(position - 0.5 * (value**2 / (variance * inflation) + log))


def relative_fit(views: Views, assignments: NDArray[np.int64]) -> RelativeFit:
    """Fit of each assignment (K, n), −1 where unmatched; at least four matches in each."""
    from rootmatch.jit.threads import in_threads, threads_worth  # compiled code, which not every import needs
    from rootmatch.problems.pose_fit.relative_descent import fit_assignments, scratch_of

    assignments = np.ascontiguousarray(assignments, np.int64)
    count, n = assignments.shape
    prior = np.zeros(3) if views.tilt == 0.0 else np.array([0.0, 0.0, 0.0, views.tilt**-2.0, views.tilt**-2.0])
    p = len(prior)
    pose, base = np.empty((count, STARTS, p)), np.empty((count, STARTS, 3, 3))
    objective, chi2 = np.empty((count, STARTS)), np.empty(count)
    normal, widths, sides = np.empty((count, STARTS, p, p)), np.empty((count, STARTS)), np.empty((count, STARTS, 2))
    arrays = views.arrays

    def work(first: int, last: int) -> None:
        fit_assignments(
            arrays, prior, assignments, first, last, STEPS, SETTLED, pose, base, objective, chi2, normal, widths, sides,
            *scratch_of(n, p, ANGLES),
        )  # fmt: skip

    in_threads(work, count, threads_worth(count // FITS_PER_THREAD))
    matched = (assignments >= 0).sum(axis=1)
    # a pose that the points do not determine still lies within a radian
    normal = invertible(normal.reshape(-1, p, p) + np.eye(p)).reshape(count, STARTS, p, p)
    lowest = objective - (2.0 * LOG_GAMMA(0.5 * matched) + 2.0 * matched * np.log(2.0 / np.sqrt(np.pi)))[:, None]
    logarithms = widths + (0.5 * np.log(2.0 * np.pi) * matched)[:, None]
    evidence = -0.5 * (lowest + np.linalg.slogdet(normal)[1]) - logarithms - sides.min(axis=2)
    rows, pick = np.arange(count), evidence.argmax(axis=1)
    return RelativeFit(
        chi2=chi2,
        dof=matched - 3,
        evidence=np.asarray(evidence[rows, pick], dtype=np.float64),
        views=views,
        assignments=assignments,
        pose=pose[rows, pick],
        base=base[rows, pick],
        covariance=np.asarray(np.linalg.inv(normal[rows, pick]), dtype=np.float64),
        sign=np.where(sides[..., 0] <= sides[..., 1], 1.0, -1.0)[rows, pick],
    )


def _parallax_density(squares: Floats, count: NDArray[np.int64]) -> Floats:
    """Logarithm of the density of some parallaxes with a sum of squares, their scale unknown."""
    half = 0.5 * count
    return np.asarray(LOG_GAMMA(half) + count * np.log(2.0 / np.sqrt(np.pi)) - half * np.log(squares))


def _sized(along: Floats, width: Floats) -> tuple[Floats, Floats]:
    """Sizes of parallaxes, not below their noise, and minus the log probability of those behind a camera."""
    noise = ALONG * width
    return np.hypot(along, noise), 0.5 * (np.minimum(along, 0.0) / noise) ** 2


def behind(views: Views, k: NDArray[np.int64], used: NDArray[np.bool_], pose: tuple[Floats, Floats]) -> Floats:
    """Minus the log probability (B,) that detections k (B, n) lie before both cameras of poses (R, t)."""
    essential = cross_matrix(pose[1]) @ pose[0]
    i = np.arange(k.shape[1])
    along = views.parallax(pose[0], pose[1], i, k)
    return np.asarray(np.where(used, _sized(along, views.deviations(essential, i, k)[1])[1], 0.0).sum(axis=1))


def _moved(pose: Floats) -> Floats:
    """A pose (p,) with each entry moved by `DELTA`, (p, p)."""
    return np.asarray(pose + DELTA * np.eye(len(pose)))


def _rotation(pose: Floats) -> Floats:
    """Rotations (…, 3, 3) of poses (…, p)."""
    rotation = rotation_about_y(np.cos(pose[..., 0]), np.sin(pose[..., 0]))
    if pose.shape[-1] == 3:
        return rotation
    tilt = np.zeros((*pose.shape[:-1], 3))
    tilt[..., 0], tilt[..., 2] = pose[..., 3], pose[..., 4]
    return np.asarray((np.eye(3) + cross_matrix(tilt)) @ rotation)


def _translation(pose: Floats, base: Floats) -> Floats:
    """Unit translations (…, 3) of poses (…, p)."""
    translation = base[..., 0, :] + pose[..., 1, None] * base[..., 1, :] + pose[..., 2, None] * base[..., 2, :]
    return np.asarray(translation / np.linalg.norm(translation, axis=-1, keepdims=True))


def _essential(pose: Floats, base: Floats) -> Floats:
    """Essential matrices (…, 3, 3) of poses (…, p)."""
    return np.asarray(cross_matrix(_translation(pose, base)) @ _rotation(pose))
