"""Camera poses of whole assignments between points in space and their image (Gauss-Newton).

One pose for each assignment, all side by side, with its covariance and evidence. The noise is that of pixels, and a
measured vertical is a prior on two more parameters. That is done for tens of assignments a match, in NumPy for any
camera, and compiled for one without a lens (`pinhole_fit`). Groups of several motions are fitted by the thousand and
need χ² alone: `rootmatch.problems.up2p.group_fit` does that compiled, with isotropic bearings and the tilt as part of
their noise. All start from the same linear equations of an upright camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross_matrix, rotation_from_vector
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.pinhole import Camera
from rootmatch.problems.pose_fit.base import SETTLED, STEPS, Fit, Floats, invertible
from rootmatch.problems.pose_fit.initial_poses import poses_of_triples, triples, upright_start

TRIED = 2
"""How many poses of a minimal set are refined: near a plane, two of them nearly coincide. Not tuned."""
CUT = 100.0
"""Squared deviation at which a point stops counting when those poses are compared. Not tuned: (10 σ)²."""


@dataclass(frozen=True, eq=False)
class Upright:
    """A camera whose vertical is known: rotations of world and camera onto y, and the vertical's σ in radians."""

    world: Floats
    camera: Floats
    noise: float


@dataclass(frozen=True, eq=False)
class AbsoluteFit(Fit):
    """Camera poses of K assignments; see `Fit`. Detections are pixels."""

    target: Floats
    variance: Floats
    """(n',) of each coordinate."""
    predicted: Floats
    """(K, n, 2)."""
    jacobian: Floats
    """(K, n, 2, p) of the predictions by the pose."""
    covariance: Floats
    """(K, p, p) of the pose."""
    positions: Floats
    """(K, n, 3) in the camera frame."""
    rotation: Floats
    """(K, 3, 3)."""
    translation: Floats
    """(K, 3), of the points' centre in units of their root mean square distance from it."""
    seen: NDArray[np.bool_]
    """(K, n) whether the camera sees those positions."""


def absolute_fit(
    source: Floats,
    target: Floats,
    sigma: Floats,
    camera: CameraModel,
    assignments: NDArray[np.int64],
    upright: Upright | None,
) -> AbsoluteFit:
    """Fit of each assignment.

    Parameters
    ----------
    source : (n, 3) array
    target : (n', 2) array
    sigma : (n',) array
        Standard deviation of a pixel coordinate.
    camera : CameraModel
    assignments : (K, n) int64 array
        −1 where unmatched; at least four matches in each, three where the vertical is known.
    upright : Upright, optional
        The pose then has four parameters; two more, with the vertical as a prior, where that is not exact.
    """
    points = source - source.sum(axis=0) / len(source)
    points = points / np.sqrt((points**2).sum() / points.size)
    if isinstance(camera, Camera) and camera.lens is None:
        return _pinhole_fit(points, target, sigma, camera=camera, assignments=assignments, upright=upright)
    return lens_fit(points, target, sigma, camera=camera, assignments=assignments, upright=upright)


def lens_fit(
    points: Floats,
    target: Floats,
    sigma: Floats,
    camera: CameraModel,
    assignments: NDArray[np.int64],
    upright: Upright | None,
) -> AbsoluteFit:
    """The fit for any camera, of points about their centre in units of their root mean square distance."""
    used = assignments >= 0
    image = target[np.maximum(assignments, 0)]
    weight = np.where(used, 1.0 / sigma[np.maximum(assignments, 0)], 0.0)
    rays = camera.bearings(target)[np.maximum(assignments, 0)]
    count = len(assignments)
    axes, prior = np.eye(3), np.zeros(6)
    if upright is not None:
        rotation, translation = upright_start(points @ upright.world.T, rays @ upright.camera.T, weight)
        rotation, translation = upright.camera.T @ rotation @ upright.world, translation @ upright.camera
        axes = upright.camera[[1, 0, 2]]
        if upright.noise > 0.0:
            prior[1:3] = upright.noise**-2.0
        else:
            axes, prior = axes[:1], prior[:4]
    else:
        # the matched points alone, side by side: most of an object may be unmatched
        most = int(used.sum(axis=1).max(initial=0))
        packed = np.argsort(~used, axis=1, kind="stable")[:, :most]
        every_point, every_image, every_weight = points, image, weight
        points, image = points[packed], np.take_along_axis(image, packed[..., None], axis=1)
        weight, used = np.take_along_axis(weight, packed, axis=1), np.take_along_axis(used, packed, axis=1)
        rays = np.take_along_axis(rays, packed[..., None], axis=1)
        chosen = triples(image, used)
        every = np.arange(count)[:, None, None]
        rotation, translation = poses_of_triples(
            points[every, chosen].reshape(-1, 3, 3), rays[every, chosen].reshape(-1, 3, 3)
        )
        rotation, translation = rotation.reshape(count, -1, 3, 3), translation.reshape(count, -1, 3)
        with np.errstate(all="ignore"):
            positions = points[:, None] @ rotation.swapaxes(-1, -2) + translation[:, :, None]
            squared = (((camera.project(positions) - image[:, None]) * weight[:, None, :, None]) ** 2).sum(axis=-1)
            behind = (~camera.sees(positions) & used[:, None]).any(axis=-1)
            total = np.where(behind, np.inf, np.minimum(squared, CUT).sum(axis=-1))
        best = np.argsort(np.where(np.isnan(total), np.inf, total), axis=1, kind="stable")[:, :TRIED]
        rotation, translation = (
            rotation[every[:, 0], best].reshape(-1, 3, 3),
            translation[every[:, 0], best].reshape(-1, 3),
        )
        points = np.repeat(points, TRIED, axis=0)
        image, weight = np.repeat(image, TRIED, axis=0), np.repeat(weight, TRIED, axis=0)
    descent = _Descent(points=points, image=image, weight=weight, camera=camera, axes=axes, prior=prior)
    rotation, translation, chi2 = descent.run(rotation, translation)
    if upright is None:
        pick = np.arange(count) * TRIED + chi2.reshape(count, TRIED).argmin(axis=1)
        rotation, translation, chi2 = rotation[pick], translation[pick], chi2[pick]
        descent = _Descent(
            points=every_point, image=every_image, weight=every_weight, camera=camera, axes=axes, prior=prior
        )
        used = assignments >= 0
    with np.errstate(all="ignore"):
        positions, predicted, _ = descent.predict(rotation, translation)
        jacobian = descent.jacobian(positions, translation)
        jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
        normal = invertible(descent.normal(jacobian))
        seen = camera.sees(positions)
    covariance: Floats = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    variance = sigma**2
    logarithms = np.where(used, np.log(2.0 * np.pi * variance[np.maximum(assignments, 0)]), 0.0).sum(axis=1)
    evidence: Floats = -0.5 * (chi2 + np.linalg.slogdet(normal)[1]) - logarithms
    dof: NDArray[np.int64] = 2 * used.sum(axis=1) - (6 if upright is None else 4)
    return AbsoluteFit(
        chi2=chi2,
        dof=dof,
        evidence=evidence,
        target=target,
        variance=variance,
        predicted=predicted,
        jacobian=jacobian,
        covariance=covariance,
        positions=positions,
        rotation=rotation,
        translation=translation,
        seen=seen,
    )


def _pinhole_fit(
    points: Floats,
    target: Floats,
    sigma: Floats,
    camera: Camera,
    assignments: NDArray[np.int64],
    upright: Upright | None,
) -> AbsoluteFit:
    """A fit in a camera without a lens, compiled."""
    from rootmatch.problems.pose_fit.pinhole_fit import Vertical, fitted_poses  # takes Numba

    rays, axes, prior = camera.bearings(target), np.eye(3), np.zeros(6)
    vertical: Vertical | None = None
    if upright is not None:
        axes = upright.camera[[1, 0, 2]]
        vertical = Vertical(points @ upright.world.T, rays @ upright.camera.T, upright.world, upright.camera)
        if upright.noise > 0.0:
            prior[1:3] = upright.noise**-2.0
        else:
            axes, prior = axes[:1], prior[:4]
    found = fitted_poses(
        np.ascontiguousarray(points), rays, np.ascontiguousarray(target), 1.0 / sigma, np.array(camera.numbers),
        axes=axes, prior=prior, vertical=vertical, assignments=np.ascontiguousarray(assignments),
    )  # fmt: skip
    return AbsoluteFit(
        chi2=found.chi2,
        dof=found.dof,
        evidence=found.evidence,
        target=target,
        variance=sigma**2,
        predicted=found.predicted,
        jacobian=found.jacobian,
        covariance=found.covariance,
        positions=found.positions,
        rotation=found.rotation,
        translation=found.translation,
        seen=found.seen,
    )


class _Descent:
    """Damped Gauss-Newton of B poses side by side: rotations about some axes of the camera frame, and translations."""

    def __init__(
        self, points: Floats, image: Floats, weight: Floats, camera: CameraModel, axes: Floats, prior: Floats
    ) -> None:
        self.points, self.image, self.weight = points, image, weight
        self.camera, self.axes, self.prior = camera, axes, prior

    def run(self, rotation: Floats, translation: Floats) -> tuple[Floats, Floats, Floats]:
        """The best poses near the given ones, and their χ²."""
        angles = len(self.axes)
        translation = np.where(np.isfinite(translation), translation, [0.0, 0.0, 5.0])
        tilt = np.zeros((len(rotation), angles + 3))
        damping = np.full(len(rotation), 1e-6)
        diagonal = np.arange(angles + 3)
        with np.errstate(all="ignore"):
            positions, predicted, chi2 = self.predict(rotation, translation, tilt)
            for _ in range(STEPS):
                jacobian = self.jacobian(positions, translation)
                jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
                normal = self.normal(jacobian)
                residual = np.where(self.weight[..., None] > 0.0, predicted - self.image, 0.0)
                residual = np.where(np.isfinite(residual), residual, 0.0) * self.weight[..., None] ** 2
                slope = np.einsum("bnqp,bnq->bp", jacobian, residual) + tilt * self.prior
                normal[:, diagonal, diagonal] *= 1.0 + damping[:, None]
                step = -np.linalg.solve(invertible(normal), slope[..., None])[..., 0]
                new = rotation_from_vector(step[:, :angles] @ self.axes) @ rotation, translation + step[:, angles:]
                new_tilt = tilt + step
                places2, predicted2, chi22 = self.predict(*new, new_tilt)
                better = chi22 <= chi2
                fall = np.where(better & (chi22 < np.inf), chi2 - chi22, 0.0)
                rotation = np.where(better[:, None, None], new[0], rotation)
                translation, tilt = (
                    np.where(better[:, None], new[1], translation),
                    np.where(better[:, None], new_tilt, tilt),
                )
                positions = np.where(better[:, None, None], places2, positions)
                predicted = np.where(better[:, None, None], predicted2, predicted)
                chi2 = np.where(better, chi22, chi2)
                damping = np.where(better, 0.1 * damping, 30.0 * np.maximum(damping, 1e-4))
                if better.all() and not (fall > SETTLED * (1.0 + np.minimum(chi2, 1e300))).any():
                    break
        return rotation, translation, chi2

    def predict(
        self, rotation: Floats, translation: Floats, tilt: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Positions in the camera frame, their pixels, and χ²."""
        positions = self.points @ rotation.swapaxes(-1, -2) + translation[:, None]
        predicted = self.camera.project(positions)
        squared = ((predicted - self.image) ** 2).sum(axis=-1) * self.weight**2
        chi2 = np.where(self.weight > 0.0, squared, 0.0).sum(axis=1)
        if tilt is not None:
            chi2 = chi2 + (tilt**2 * self.prior).sum(axis=1)
        behind = (~self.camera.sees(positions) & (self.weight > 0.0)).any(axis=1)
        return positions, predicted, np.where(behind | ~np.isfinite(chi2), np.inf, chi2)

    def jacobian(self, positions: Floats, translation: Floats) -> Floats:
        """Derivatives (B, n, 2, p) of the pixels by the pose."""
        by_position = self.camera.jacobian(positions)
        by_rotation = -by_position @ (cross_matrix(positions - translation[:, None]) @ self.axes.T)
        return np.concatenate([by_rotation, by_position], axis=-1)

    def normal(self, jacobian: Floats) -> Floats:
        """Normal equations (B, p, p)."""
        weighted = (jacobian * self.weight[..., None, None]).reshape(len(jacobian), -1, jacobian.shape[-1])
        return np.asarray(weighted.swapaxes(-1, -2) @ weighted + np.diag(self.prior))
