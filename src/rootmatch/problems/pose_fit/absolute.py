"""Answers between points in space and their image, each fitted by its best camera pose (Gauss-Newton, NumPy)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.cameras.pinhole import Camera
from rootmatch.problems.pose_fit.base import SETTLED, STEPS, Fit, Floats, crossed, invertible, turned
from rootmatch.problems.pose_fit.initial_poses import poses_of_triples, triples, upright_start

TRIED = 2
"""Of the poses of minimal sets, those that are refined: near a plane two of them come near each other."""
CUT = 100.0
"""Squared deviation beyond which all points count alike when those poses are compared."""


@dataclass(frozen=True, eq=False)
class Upright:
    """A camera whose vertical is known: rotations of world and camera onto y, and the vertical's σ in radians."""

    world: Floats
    camera: Floats
    noise: float


@dataclass(frozen=True, eq=False)
class AbsoluteFit(Fit):
    """See `Fit`; positions are pixels."""

    target: Floats
    variance: Floats
    """(n',) of each coordinate."""
    answers: NDArray[np.int64]
    predicted: Floats
    """(K, n, 2)."""
    jacobian: Floats
    """(K, n, 2, p) of the predictions by the pose."""
    covariance: Floats
    """(K, p, p) of the pose."""
    places: Floats
    """(K, n, 3) in the camera frame."""
    rotation: Floats
    """(K, 3, 3)."""

    def densities(self, k: int, inflation: float = 1.0) -> Floats:
        """See `Fit.densities`."""
        answer, jacobian = self.answers[k], self.jacobian[k]
        matched = answer >= 0
        image = np.maximum(answer, 0)
        spread = jacobian @ self.covariance[k] @ jacobian.transpose(0, 2, 1)
        unit = np.eye(2)
        # without its own match a prediction moves away from it, and is less sure, by the hat matrix
        hat = np.where(matched[:, None, None], spread / self.variance[image][:, None, None], 0.0)
        away = np.linalg.inv((1.0 + 1e-9) * unit - hat)
        residual = self.target[image] - self.predicted[k]
        left_out = self.target[image] - (away @ residual[..., None])[..., 0]
        predicted = np.where(matched[:, None], left_out, self.predicted[k])
        spread = np.where(matched[:, None, None], away @ spread, spread)
        difference = self.target - predicted[:, None]
        total = spread[:, None] + self.variance[:, None, None] * unit
        a, b, c = total[..., 0, 0], 0.5 * (total[..., 0, 1] + total[..., 1, 0]), total[..., 1, 1]
        determinant = np.maximum(a * c - b * b, 1e-300)
        x, y = difference[..., 0], difference[..., 1]
        squared = (c * x * x - 2.0 * b * x * y + a * y * y) / (determinant * inflation)
        density = -0.5 * (squared + np.log(determinant)) - np.log(2.0 * np.pi * inflation)
        return np.asarray(np.where((self.places[k, :, 2] > 0.0)[:, None] & np.isfinite(density), density, -np.inf))

    def unseen(self, k: int, normals: Floats) -> NDArray[np.bool_]:
        """See `Fit.unseen`."""
        return np.asarray(np.einsum("ni,ni->n", normals @ self.rotation[k].T, self.places[k]) > 0.0)


def absolute_fit(
    source: Floats, target: Floats, sigma: Floats, camera: Camera, answers: NDArray[np.int64], upright: Upright | None
) -> AbsoluteFit:
    """Fit of each answer.

    Parameters
    ----------
    source : (n, 3) array
    target : (n', 2) array
    sigma : (n',) array
        Standard deviation of a pixel coordinate.
    camera : Camera
    answers : (K, n) int64 array
        −1 where unmatched; at least four matches in each, three where the vertical is known.
    upright : Upright, optional
        The pose then has four parameters; two more, with the vertical as a prior, where that is not exact.
    """
    points = source - source.mean(axis=0)
    points = points / np.sqrt((points**2).mean())
    used = answers >= 0
    image = target[np.maximum(answers, 0)]
    weight = np.where(used, 1.0 / sigma[np.maximum(answers, 0)], 0.0)
    rays = camera.bearings(image)
    count = len(answers)
    axes, prior = np.eye(3), np.zeros(6)
    if upright is not None:
        rotation, shift = upright_start(points @ upright.world.T, rays @ upright.camera.T, weight)
        rotation, shift = upright.camera.T @ rotation @ upright.world, shift @ upright.camera
        axes = upright.camera[[1, 0, 2]]
        if upright.noise > 0.0:
            prior[1:3] = upright.noise**-2.0
        else:
            axes, prior = axes[:1], prior[:4]
    else:
        chosen = triples(image, used)
        every = np.arange(count)[:, None, None]
        rotation, shift = poses_of_triples(points[chosen].reshape(-1, 3, 3), rays[every, chosen].reshape(-1, 3, 3))
        rotation, shift = rotation.reshape(count, -1, 3, 3), shift.reshape(count, -1, 3)
        with np.errstate(all="ignore"):
            places = points @ rotation.swapaxes(-1, -2) + shift[:, :, None]
            squared = (((camera.project(places) - image[:, None]) * weight[:, None, :, None]) ** 2).sum(axis=-1)
            behind = (~(places[..., 2] > 0.0) & used[:, None]).any(axis=-1)
            total = np.where(behind, np.inf, np.minimum(squared, CUT).sum(axis=-1))
        best = np.argsort(np.where(np.isnan(total), np.inf, total), axis=1, kind="stable")[:, :TRIED]
        rotation, shift = rotation[every[:, 0], best].reshape(-1, 3, 3), shift[every[:, 0], best].reshape(-1, 3)
        image, weight = np.repeat(image, TRIED, axis=0), np.repeat(weight, TRIED, axis=0)
    descent = _Descent(points, image, weight, camera, axes, prior)
    rotation, shift, chi2 = descent.run(rotation, shift)
    if upright is None:
        pick = np.arange(count) * TRIED + chi2.reshape(count, TRIED).argmin(axis=1)
        rotation, shift, chi2 = rotation[pick], shift[pick], chi2[pick]
        descent = _Descent(points, image[pick], weight[pick], camera, axes, prior)
    with np.errstate(all="ignore"):
        places, predicted, _ = descent.seen(rotation, shift)
        jacobian = descent.jacobian(places, shift)
        jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
        normal = invertible(descent.normal(jacobian))
    covariance: Floats = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    variance = sigma**2
    logarithms = np.where(used, np.log(2.0 * np.pi * variance[np.maximum(answers, 0)]), 0.0).sum(axis=1)
    evidence: Floats = -0.5 * (chi2 + np.linalg.slogdet(normal)[1]) - logarithms
    freedom: NDArray[np.int64] = 2 * used.sum(axis=1) - (6 if upright is None else 4)
    return AbsoluteFit(
        chi2, freedom, evidence, target, variance, answers, predicted, jacobian, covariance, places, rotation
    )


class _Descent:
    """Damped Gauss-Newton of B poses side by side: turns about some axes of the camera frame, and shifts."""

    def __init__(
        self, points: Floats, image: Floats, weight: Floats, camera: Camera, axes: Floats, prior: Floats
    ) -> None:
        self.points, self.image, self.weight = points, image, weight
        self.camera, self.axes, self.prior = camera, axes, prior

    def run(self, rotation: Floats, shift: Floats) -> tuple[Floats, Floats, Floats]:
        """The best poses near some, and their χ²."""
        turns = len(self.axes)
        shift = np.where(np.isfinite(shift), shift, [0.0, 0.0, 5.0])
        tilt = np.zeros((len(rotation), turns + 3))
        damping = np.full(len(rotation), 1e-6)
        diagonal = np.arange(turns + 3)
        with np.errstate(all="ignore"):
            places, predicted, chi2 = self.seen(rotation, shift, tilt)
            for _ in range(STEPS):
                jacobian = self.jacobian(places, shift)
                jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
                normal = self.normal(jacobian)
                residual = np.where(self.weight[..., None] > 0.0, predicted - self.image, 0.0)
                residual = np.where(np.isfinite(residual), residual, 0.0) * self.weight[..., None] ** 2
                slope = np.einsum("bnqp,bnq->bp", jacobian, residual) + tilt * self.prior
                normal[:, diagonal, diagonal] *= 1.0 + damping[:, None]
                step = -np.linalg.solve(invertible(normal), slope[..., None])[..., 0]
                new = turned(step[:, :turns] @ self.axes) @ rotation, shift + step[:, turns:]
                new_tilt = tilt + step
                places2, predicted2, chi22 = self.seen(*new, new_tilt)
                better = chi22 <= chi2
                fall = np.where(better & (chi22 < np.inf), chi2 - chi22, 0.0)
                rotation = np.where(better[:, None, None], new[0], rotation)
                shift, tilt = np.where(better[:, None], new[1], shift), np.where(better[:, None], new_tilt, tilt)
                places = np.where(better[:, None, None], places2, places)
                predicted = np.where(better[:, None, None], predicted2, predicted)
                chi2 = np.where(better, chi22, chi2)
                damping = np.where(better, 0.1 * damping, 30.0 * np.maximum(damping, 1e-4))
                if better.all() and not (fall > SETTLED * (1.0 + np.minimum(chi2, 1e300))).any():
                    break
        return rotation, shift, chi2

    def seen(self, rotation: Floats, shift: Floats, tilt: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Places in the camera frame, their pixels, and χ²."""
        places = self.points @ rotation.swapaxes(-1, -2) + shift[:, None]
        predicted = self.camera.project(places)
        squared = ((predicted - self.image) ** 2).sum(axis=-1) * self.weight**2
        chi2 = np.where(self.weight > 0.0, squared, 0.0).sum(axis=1)
        if tilt is not None:
            chi2 = chi2 + (tilt**2 * self.prior).sum(axis=1)
        behind = (~(places[..., 2] > 0.0) & (self.weight > 0.0)).any(axis=1)
        return places, predicted, np.where(behind | ~np.isfinite(chi2), np.inf, chi2)

    def jacobian(self, places: Floats, shift: Floats) -> Floats:
        """Of the pixels (B, n, 2) by the pose, (B, n, 2, p)."""
        camera, inverse = self.camera, 1.0 / places[..., 2]
        by_place = np.zeros((*places.shape[:2], 2, 3))
        by_place[..., 0, 0], by_place[..., 1, 1] = camera.fx * inverse, camera.fy * inverse
        by_place[..., 0, 2] = -camera.fx * places[..., 0] * inverse * inverse
        by_place[..., 1, 2] = -camera.fy * places[..., 1] * inverse * inverse
        by_turn = -by_place @ (crossed(places - shift[:, None]) @ self.axes.T)
        return np.concatenate([by_turn, by_place], axis=-1)

    def normal(self, jacobian: Floats) -> Floats:
        """Normal equations (B, p, p)."""
        weighed = (jacobian * self.weight[..., None, None]).reshape(len(jacobian), -1, jacobian.shape[-1])
        return np.asarray(weighed.swapaxes(-1, -2) @ weighed + np.diag(self.prior))
