"""Fits of whole assignments between two point sets by one motion each, in closed form and many at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.problems.points import PointClouds, squared_distances_to

ROUNDS = 8
"""Maximum number of rounds in which an unknown scale changes the weights. Not tuned: three are usual."""
SETTLED = 1e-9
"""Relative change of the scale at which they end. Not tuned."""
TURN = 2.0 * math.pi
"""Range of a rotation that nothing determines: of one point all three, of two points that about their line."""
DECADES = 4.0
"""Width of the prior of an unknown scale, which is flat in its logarithm: from a hundredth to a hundredfold."""


@dataclass(frozen=True, eq=False)
class PointSetFit:
    """K assignments, each with its motion x' = scale · R x + t."""

    chi2: Floats
    """(K,) squared deviations of the matched points over their variances."""
    dof: Integers
    """(K,) degrees of freedom of the law that χ² of a right assignment follows."""
    evidence: Floats
    """(K,) logarithm of the density of the matched detections per unit of volume: the motion is integrated out under
    the invariant measure of rotations, of volume one, a flat density of the scale's logarithm and of the translation;
    the volume of translations is not in it."""
    clouds: PointClouds
    assignments: Integers
    """(K, n)."""
    rotation: Floats
    """(K, k, k)."""
    shift: Floats
    """(K, k)."""
    scale: Floats
    """(K,)."""
    centre: Floats
    """(K, k) weighted mean of the matched source points."""
    spread: Floats
    """Variance (K, k) of the motion's rotation about each axis of ``frame``; in a plane, the same for both."""
    frame: Floats
    """Axes (K, k, k) of ``spread`` as columns, in the frame of the target."""
    total: Floats
    """(K,) sum of the weights of the matches."""

    def squares(self) -> tuple[Floats, Floats]:
        """Squared distances (K, n, n') of targets from moved source points, and their variances of a coordinate.

        The variance is that of both points and the mean over directions of the motion's own.
        """
        moved, own = self.places
        clouds = self.clouds
        both = (self.scale**2)[:, None, None] * clouds.source_variance[:, None] + clouds.target_variance
        return squared_distances_to(moved, clouds.target), both + own[:, :, None]

    @cached_property
    def places(self) -> tuple[Floats, Floats]:
        """Places (K, n, k) of moved source points, and the mean over directions (K, n) of the motion's own variance."""
        turned = self.scale[:, None, None] * (self.clouds.source - self.centre[:, None]) @ self.rotation.swapaxes(1, 2)
        moved = turned + (self.shift + self.scale[:, None] * _applied(self.rotation, self.centre))[:, None]
        size = self.clouds.source.shape[1]
        along = turned @ self.frame
        if size == 3:
            # a turn about an axis moves a point by its distance from the axis
            moment = (along**2).sum(axis=2)[:, :, None] - along**2
        else:
            moment = 0.5 * (along**2).sum(axis=2)[:, :, None] * np.ones(2)
        return moved, 1.0 / self.total[:, None] + (moment * self.spread[:, None]).sum(axis=2) / size

    def predictions(self, k: int) -> tuple[Floats, Floats]:
        """Squared deviations (n, n') of targets from where each point is predicted, and the logarithm of 1 / √|2π S|.

        The prediction is that of the other points of assignment k: a point's own match is left out. The motion's own
        uncertainty enters as its mean over directions.
        """
        one = self if len(self.scale) == 1 else self.take(np.array([k]))
        squared, variance = (part[0] for part in one.squares())
        assignment = self.assignments[k]
        (matched,) = np.nonzero(assignment >= 0)
        places = matched, assignment[matched]
        # of a point's own match the fit knows: its leverage is taken off both
        own = (self.scale[k] ** 2 * self.clouds.source_variance)[matched] + self.clouds.target_variance[places[1]]
        leverage = np.clip((variance[places] - own) / own, 0.0, 0.95)
        squared[places] /= (1.0 - leverage) ** 2
        variance[places] = own / (1.0 - leverage)
        size = self.clouds.source.shape[1]
        return squared / variance, -0.5 * size * np.log(2.0 * np.pi * variance)

    def take(self, which: NDArray[np.integer]) -> PointSetFit:
        """A subset of the fits."""
        return replace(self, **{name: getattr(self, name)[which] for name in COLUMNS})

    def joined(self, other: PointSetFit) -> PointSetFit:
        """These fits, followed by others of the same points."""
        both: dict[str, Any] = {n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in COLUMNS}
        return replace(self, **both)


COLUMNS = tuple(one.name for one in fields(PointSetFit) if one.name != "clouds")
"""Names of what there is one of for each assignment."""


def fitted_point_sets(clouds: PointClouds, assignments: Integers, mirror: bool) -> PointSetFit:
    """The motion of each assignment (K, n) and its evidence; the true points are eliminated.

    Weighted least squares (Umeyama 1991). The translation is integrated exactly, a rotation of a plane too (a Bessel
    function); of space by Laplace's method about the best one, whose curvature is exact: sums of the singular values
    of the weighted cross-covariance. A direction that nothing determines counts with its whole range.

    Parameters
    ----------
    clouds : PointClouds
    assignments : (K, n) int64 array
        −1 where unmatched; two matches or more each.
    mirror : bool
        Whether the motion may be a reflection: then both kinds are as probable before anything is seen.
    """
    matched = assignments >= 0
    image = clouds.target[np.where(matched, assignments, 0)]
    variance2 = clouds.target_variance[np.where(matched, assignments, 0)]
    count, size = len(assignments), clouds.source.shape[1]
    scale = np.ones(count)
    for _ in range(ROUNDS if clouds.scaled else 1):
        weight = matched / (variance2 + scale[:, None] ** 2 * clouds.source_variance)
        total = weight.sum(axis=1)
        centre = (weight @ clouds.source) / total[:, None]
        centre2 = (weight[:, None] @ image)[:, 0] / total[:, None]
        first, second = clouds.source - centre[:, None], image - centre2[:, None]
        u, values, vt = np.linalg.svd((second * weight[:, :, None]).swapaxes(1, 2) @ first)
        turn = np.where(np.linalg.det(u @ vt) < 0.0, -1.0, 1.0)
        signs = np.ones((count, size))
        if not mirror:
            signs[:, -1] = turn
        spread = (weight * (first**2).sum(axis=2)).sum(axis=1)
        before = scale
        if clouds.scaled:
            scale = np.maximum((values * signs).sum(axis=1), 1e-300) / np.maximum(spread, 1e-300)
            if np.all(np.abs(scale - before) <= SETTLED * scale):
                break
    rotation = (u * signs[:, None]) @ vt
    off = second - scale[:, None, None] * first @ rotation.swapaxes(1, 2)
    chi2 = (weight * (off**2).sum(axis=2)).sum(axis=1)
    curvature = _curvature(scale[:, None] * values * signs)
    turned = _log_turned(curvature)
    if mirror:
        other = signs * np.where(np.arange(size) == size - 1, -1.0, 1.0)
        worse = scale * (values * (signs - other)).sum(axis=1)
        turned = np.logaddexp(turned, _log_turned(_curvature(scale[:, None] * values * other)) - worse) - math.log(2.0)
    n_matched = matched.sum(axis=1)
    freedom = size * (n_matched - 1) - (3 if size == 3 else 1)
    norm = 0.5 * size * np.where(matched, np.log(np.where(matched, weight, 1.0) / TURN), 0.0).sum(axis=1)
    evidence = norm + 0.5 * size * np.log(TURN / total) + turned - 0.5 * chi2
    if clouds.scaled:
        freedom = freedom - 1
        range_of_log = DECADES * math.log(10.0)
        evidence += 0.5 * np.log(TURN / (scale**2 * spread + TURN / range_of_log**2)) - math.log(range_of_log)
    own = 1.0 / (curvature + 1.0 / TURN)
    return PointSetFit(
        chi2=chi2, dof=np.maximum(freedom, 0).astype(np.int64), evidence=evidence, clouds=clouds,
        assignments=assignments, rotation=rotation, shift=centre2 - scale[:, None] * _applied(rotation, centre),
        scale=scale, centre=centre,
        spread=own if size == 3 else np.repeat(own, 2, axis=1), frame=u, total=total,
    )  # fmt: skip


def scale_variance(fit: PointSetFit) -> Floats:
    """Variance (K,) of the logarithm of the scale."""
    clouds, matched = fit.clouds, fit.assignments >= 0
    variance = clouds.target_variance[np.where(matched, fit.assignments, 0)]
    weight = matched / (variance + fit.scale[:, None] ** 2 * clouds.source_variance)
    squares = ((clouds.source - fit.centre[:, None]) ** 2).sum(axis=2)
    return np.asarray(1.0 / np.maximum(fit.scale**2 * (weight * squares).sum(axis=1), 1e-300))


def _applied(rotation: Floats, points: Floats) -> Floats:
    """Rotated points (K, k)."""
    return np.asarray((rotation @ points[:, :, None])[:, :, 0])


def _curvature(values: Floats) -> Floats:
    """Second derivatives of χ²/2 by turns about the axes of the target's frame, (K, 3) in space and (K, 1) in a plane.

    ``values`` (K, k): singular values of the cross-covariance, the last negative where a reflection would fit better.
    """
    total = values.sum(axis=1, keepdims=True)
    return np.asarray(np.maximum(total - values if values.shape[1] == 3 else total, 0.0))


def _log_turned(curvature: Floats) -> Floats:
    """Logarithm of the mean over all rotations of exp(−χ²/2), over its value at the best one."""
    if curvature.shape[1] == 1:
        from scipy.special import i0e  # slow to import

        return np.asarray(np.log(i0e(curvature[:, 0])))
    # 8π² is the volume of the rotations
    return np.asarray(0.5 * np.log(TURN / (curvature + 1.0 / TURN)).sum(axis=1) - math.log(2.0 * TURN**2))
