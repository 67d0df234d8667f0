"""Relative poses of whole assignments between two images with a common direction (Gauss-Newton, NumPy)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.directions import tangent_bases
from rootmatch.algebra.rotation import cross_matrix, rotation_about_y
from rootmatch.cameras.base import CameraModel
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.base import SETTLED, STEPS, Fit, Floats, invertible

ANGLES = 90
"""Rotations about the common direction that are tried, 4° apart. Not tuned."""
STARTS = 3
"""The best of them, from which an assignment is fitted. Not tuned."""
CUT = 25.0
"""Squared deviation at which a point stops counting when they are compared. Not tuned: (5 σ)²."""
ALONG = 2.0
"""Noise of a position along the line over that across it, as the rotation's own noise adds to it. Not tuned."""
LOG_GAMMA = np.vectorize(math.lgamma, otypes=[float])
DELTA = 1e-6
"""Step of numerical derivatives, in radians: far above rounding, far below any noise. Not tuned."""


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
    """See `Fit`; a detection counts by its distance from the epipolar line and by its position along it.

    Points of one scene have parallaxes of one order: they are taken to be normal, on the side of the points that lie
    in front of the cameras, with a scale of which nothing is known. With m of squared sum Q their density is
    ½ (2 / √π)ᵐ Γ(m / 2) Q^(−m / 2). This is part of what the pose is fitted to.
    """

    doubt: ClassVar[float] = 2.0
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
        """See `Fit.of_pose`: uniform rotation and direction of translation, parallaxes of 0.001 to 1 image."""
        laplace = 0.5 * self.pose.shape[1] * np.log(2.0 * np.pi)
        tilt = np.log(2.0 * np.pi * self.views.tilt**2) if self.views.tilt > 0.0 else 0.0
        return float(laplace - np.log(8.0 * np.pi**2) - np.log(np.log(1e3)) - tilt)

    def densities(self, k: int, inflation: float = 1.0) -> Floats:
        """See `Fit.densities`."""
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
    count = len(assignments)
    used, k = assignments >= 0, np.maximum(assignments, 0)
    angle, translation = _starts(views, np.arange(assignments.shape[1]), k, used)
    base = np.stack([translation, *tangent_bases(translation)], axis=1)
    k, used = np.repeat(k, STARTS, axis=0), np.repeat(used, STARTS, axis=0)
    start = np.zeros((len(angle), 3 if views.tilt == 0.0 else 5))
    start[:, 0] = angle
    # χ² is the least of the deviations alone, the evidence's pose that of both
    descent = _Descent(views, np.tile(k, (2, 1)), np.tile(used, (2, 1)), np.tile(base, (2, 1, 1)), len(start))
    both = descent.run(np.tile(start, (2, 1)))
    pose = both[: len(start)]
    squared = descent.squares(*descent.residuals(both), both)[0].reshape(2, count, STARTS)
    descent = _Descent(views, k, used, base, len(start))
    _, along, width = descent.residuals(pose)
    # a pose that the points do not determine still lies within a radian
    normal = invertible(descent.equations(pose)[0] + np.eye(pose.shape[1]))
    logarithms = np.where(used, np.log(np.sqrt(2.0 * np.pi) * width), 0.0).sum(axis=1)
    sides = np.array([_sized(sign * along, width)[1].sum(axis=1) for sign in (1.0, -1.0)])
    lowest = descent.objective(pose)
    evidence = -0.5 * (lowest + np.linalg.slogdet(normal)[1]) - logarithms - sides.min(axis=0)
    pick = np.arange(count) * STARTS + evidence.reshape(count, STARTS).argmax(axis=1)
    return RelativeFit(
        chi2=squared.min(axis=(0, 2)),
        freedom=used[pick].sum(axis=1) - 3,
        evidence=np.asarray(evidence[pick], dtype=np.float64),
        views=views,
        assignments=assignments,
        pose=pose[pick],
        base=base[pick],
        covariance=np.asarray(np.linalg.inv(normal[pick]), dtype=np.float64),
        sign=np.where(sides[0] <= sides[1], 1.0, -1.0)[pick],
    )


class _Descent:
    """Damped Gauss-Newton of B poses (B, p) side by side, their matches k (B, n) where `used`.

    The first `both` of them are fitted to deviations and parallaxes, the others to deviations alone.
    """

    def __init__(self, views: Views, k: NDArray[np.int64], used: NDArray[np.bool_], base: Floats, both: int) -> None:
        self.views, self.k, self.used, self.base = views, k, used, base
        self.share = np.where(np.arange(len(k)) < both, 1.0, 0.0)
        self.prior = np.zeros(3 if views.tilt == 0.0 else 5)
        if views.tilt > 0.0:
            self.prior[3:] = views.tilt**-2.0

    def residuals(self, pose: Floats, times: int = 1) -> tuple[Floats, Floats, Floats]:
        """Deviations, parallaxes (0 where unmatched), and σ across the lines; `times` poses for each."""
        every = np.repeat(np.arange(len(self.k)), times)
        base, k, used = self.base[every], self.k[every], self.used[every]
        i = np.arange(k.shape[1])
        deviation, width = self.views.deviations(_essential(pose, base), i, k)
        along = self.views.parallax(_rotation(pose), _translation(pose, base), i, k)
        return np.where(used, deviation, 0.0), np.where(used, along, 0.0), width

    def squares(self, value: Floats, along: Floats, width: Floats, pose: Floats) -> tuple[Floats, Floats]:
        """χ², and the sum of squared parallaxes."""
        sizes = np.where(self.used, _sized(along, width)[0] ** 2, 0.0).sum(axis=1)
        return (value**2).sum(axis=1) + (pose**2 * self.prior).sum(axis=1), sizes

    def objective(self, pose: Floats) -> Floats:
        """What is least at the fit: χ², and the parallaxes' part."""
        chi2, sizes = self.squares(*self.residuals(pose), pose)
        return np.asarray(chi2 - 2.0 * self.share * _parallax_density(sizes, self.used.sum(axis=1)))

    def equations(self, pose: Floats) -> tuple[Floats, Floats]:
        """Normal equations and their right side; the parallaxes are weighted by their present scale."""
        count, size = pose.shape
        value, along, width = self.residuals(pose)
        moved = np.repeat(pose, size, axis=0) + np.tile(DELTA * np.eye(size), (count, 1))
        new, new_along, _ = self.residuals(moved, size)
        slope = (new.reshape(count, size, -1) - value[:, None]) / DELTA
        across = (new_along.reshape(count, size, -1) - along[:, None]) / DELTA
        sizes = self.squares(value, along, width, pose)[1]
        weight = (self.share * self.used.sum(axis=1) / sizes)[:, None, None]
        normal = slope @ slope.swapaxes(-1, -2) + weight * across @ across.swapaxes(-1, -2) + np.diag(self.prior)
        side = (slope @ value[..., None] + weight * across @ along[..., None])[..., 0] + pose * self.prior
        return normal, side

    def run(self, pose: Floats) -> Floats:
        """Poses at the bottom."""
        lowest = self.objective(pose)
        damping = np.full(len(pose), 1e-4)
        diagonal = np.arange(pose.shape[1])
        for _ in range(STEPS):
            normal, side = self.equations(pose)
            normal[:, diagonal, diagonal] *= 1.0 + damping[:, None]
            moved = pose - np.linalg.solve(invertible(normal), side[..., None])[..., 0]
            reached = self.objective(moved)
            better = reached <= lowest
            gained = np.where(better, lowest - reached, 0.0)
            pose, lowest = np.where(better[:, None], moved, pose), np.where(better, reached, lowest)
            damping = np.where(better, 0.1 * damping, 30.0 * damping)
            if better.all() and not (gained > SETTLED).any():
                break
        return pose


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


def _starts(views: Views, i: NDArray[np.int64], k: NDArray[np.int64], used: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Rotations (K STARTS,) and translations (K STARTS, 3) of the least deviation, of a grid of rotations."""
    angle = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    rotation = rotation_about_y(np.cos(angle), np.sin(angle))
    rotated = views.first @ rotation.swapaxes(-1, -2)
    # t · (R q × q') = 0
    rows = np.cross(rotated[None], views.second[k][:, None]) * used[:, None, :, None]
    translation = np.linalg.eigh(rows.swapaxes(-1, -2) @ rows)[1][..., 0]
    essential = cross_matrix(translation) @ rotation
    deviation, _ = views.deviations(essential, i, k[:, None])
    total = np.where(used[:, None], np.minimum(deviation**2, CUT), 0.0).sum(axis=-1)
    lowest = (total <= np.roll(total, 1, axis=1)) & (total <= np.roll(total, -1, axis=1))
    best = np.argsort(np.where(lowest, total, np.inf), axis=1, kind="stable")[:, :STARTS]
    return angle[best].ravel(), translation[np.arange(len(k))[:, None], best].reshape(-1, 3)


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
