"""Fits of whole assignments between two point sets by one motion each, in closed form and many at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import angle_count, turn_jacobian
from rootmatch.arrays import Floats, Integers
from rootmatch.frozen import copy_with
from rootmatch.problems.points import PointClouds, pairwise_squared_distances
from rootmatch.problems.pose_fit.motion_model import fit_with_covariances

FEWEST = 3
"""Matches that determine a motion."""
ROUNDS = 8
"""Maximum number of rounds in which an unknown scale changes the weights. Not tuned: three are usual."""
SETTLED = 1e-9
"""Relative change of the scale at which they end. Not tuned."""
TURN = 2.0 * math.pi
"""Range of a rotation that nothing determines: of one point all three, of two points that about their line."""
DECADES = 4.0
"""Width of the prior of an unknown scale, which is flat in its logarithm: from a hundredth to a hundredfold."""
RANGE_OF_LOG = DECADES * math.log(10.0)
"""The same of the natural logarithm."""


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
    full: Floats
    """Where axes differ in noise, the covariance (K, p, p) of a turn, of a shift of the centre and, where it is
    unknown, of the logarithm of the scale; (K, 0, 0) otherwise."""

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (K, p, p) of a turn, a shift of the centre's image and, if unknown, the logarithm of the scale."""
        if self.full.shape[1]:
            return self.full
        size = self.shift.shape[1]
        angles = angle_count(size)
        whole = np.zeros((len(self.scale), *(angles + size + self.clouds.scaled,) * 2))
        if size == 3:
            whole[:, :3, :3] = (self.frame * self.spread[:, None]) @ self.frame.swapaxes(1, 2)
        else:
            whole[:, 0, 0] = self.spread[:, 0]
        shifts = np.arange(angles, angles + size)
        whole[:, shifts, shifts] = 1.0 / self.total[:, None]
        if self.clouds.scaled:
            whole[:, -1, -1] = scale_variance(self)
        return whole

    def squares(self) -> tuple[Floats, Floats]:
        """Squared distances (K, n, n') of targets from moved source points, and their variances of a coordinate.

        The variance is that of both points and the mean over directions of the motion's own.
        """
        moved, own = self.places
        clouds = self.clouds
        both = (self.scale**2)[:, None, None] * clouds.source_variance[:, None] + clouds.target_variance
        return pairwise_squared_distances(moved, clouds.target), both + own[:, :, None]

    @cached_property
    def places(self) -> tuple[Floats, Floats]:
        """Places (K, n, k) of moved source points, and the mean over directions (K, n) of the motion's own variance."""
        turned = self.scale[:, None, None] * (self.clouds.source - self.centre[:, None]) @ self.rotation.swapaxes(1, 2)
        moved = turned + (self.shift + self.scale[:, None] * _rotate_points(self.rotation, self.centre))[:, None]
        size = self.clouds.source.shape[1]
        along = turned @ self.frame
        if self.full.shape[1]:
            return moved, np.trace(self._own(turned), axis1=2, axis2=3) / size
        if size == 3:
            # a turn about an axis moves a point by its distance from the axis
            moment = (along**2).sum(axis=2)[:, :, None] - along**2
        else:
            moment = 0.5 * (along**2).sum(axis=2)[:, :, None] * np.ones(2)
        return moved, 1.0 / self.total[:, None] + (moment * self.spread[:, None]).sum(axis=2) / size

    def _own(self, turned: Floats) -> Floats:
        """Covariances (K, n, k, k) of the places of points (K, n, k), from the centre's, by the motion's own."""
        parts = [turn_jacobian(turned), np.broadcast_to(np.eye(turned.shape[-1]), (*turned.shape, turned.shape[-1]))]
        jacobian = np.concatenate([*parts, turned[..., None]], axis=-1)[..., : self.covariance.shape[-1]]
        return np.asarray(jacobian @ self.covariance[:, None] @ jacobian.swapaxes(2, 3))

    def predictions(self, k: int) -> tuple[Floats, Floats]:
        """Squared deviations (n, n') of targets from where each point is predicted, and the logarithm of 1 / √|2π S|.

        The prediction is that of the other points of assignment k: a point's own match is left out. The motion's own
        uncertainty enters as its mean over directions, but for noise that axes differ in.
        """
        one = self if len(self.scale) == 1 else self.take(slice(k, k + 1))
        if one.full.shape[1]:
            return one._full_predictions()
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

    def _full_predictions(self) -> tuple[Floats, Floats]:
        """`predictions` of one assignment by the covariances of all pairs."""
        moved = self.places[0][0]
        own = self._own((moved - self.shift[0] - self.scale[0] * self.rotation[0] @ self.centre[0])[None])[0]
        first, second = (part[0] if part.ndim == 4 else part for part in self.clouds.covariances(self._linear))
        off, whole = self.clouds.target - moved[:, None], (first + own)[:, None] + second
        (matched,) = np.nonzero(self.assignments[0] >= 0)
        places = matched, self.assignments[0][matched]
        # of a point's own match the fit knows: (Σ − P)⁻¹ is the weight of its residual, and Σ (Σ − P)⁻¹ Σ its spread
        noise = first[matched] + second[places[1]]
        root = np.linalg.cholesky(noise)
        inverse = np.linalg.inv(root)
        leverage, axes = np.linalg.eigh(inverse @ own[matched] @ inverse.swapaxes(1, 2))
        rest = 1.0 - np.clip(leverage, 0.0, 0.95)
        wide = root @ axes
        whole[places] = (wide / rest[:, None]) @ wide.swapaxes(1, 2)
        off[places] = ((wide / rest[:, None]) @ np.linalg.inv(wide) @ off[places][..., None])[..., 0]
        return squared_deviations(off, whole), -0.5 * np.linalg.slogdet(TURN * whole)[1]

    @property
    def _linear(self) -> Floats:
        """The matrices (K, k, k) scale · R."""
        return np.asarray(self.scale[:, None, None] * self.rotation)

    def take(self, which: NDArray[np.integer] | slice) -> PointSetFit:
        """A subset of the fits; a slice costs least."""
        columns = [getattr(self, name) for name in COLUMNS]
        # `take` is three times as fast as an index for few
        some = [one[which] if isinstance(which, slice) else one.take(which, axis=0) for one in columns]
        return copy_with(self, **dict(zip(COLUMNS, some, strict=True)))

    def of_body(self, rows: slice, points: slice, clouds: PointClouds) -> PointSetFit:
        """The fits of one of several bodies."""
        places = self.places
        one = copy_with(self.take(rows), clouds=clouds, assignments=self.assignments[rows, points].copy())
        vars(one)["places"] = tuple(some[rows, points] for some in places)  # worked out already
        return one

    def joined(self, other: PointSetFit) -> PointSetFit:
        """These fits, followed by others of the same points."""
        both: dict[str, Any] = {n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in COLUMNS}
        return copy_with(self, **both)


COLUMNS = tuple(one.name for one in fields(PointSetFit) if one.name != "clouds")
"""Names of what there is one of for each assignment."""


def fit_point_sets(clouds: PointClouds, assignments: Integers, mirror: bool) -> PointSetFit:
    """The motion of each assignment (K, n) and its evidence; the true points are eliminated.

    Weighted least squares (Umeyama 1991). The translation is integrated exactly, a rotation of a plane too (a Bessel
    function); of space by Laplace's method about the best one, whose curvature is exact: sums of the singular values
    of the weighted cross-covariance. A direction that nothing determines counts with its whole range. Where axes differ
    in noise, this is where a fit with the covariances of all pairs begins, see `_full`.

    Parameters
    ----------
    clouds : PointClouds
    assignments : (K, n) int64 array
        −1 where unmatched; two matches or more each.
    mirror : bool
        Whether the motion may be a reflection: then both kinds are as probable before anything is seen.
    """
    matched = assignments >= 0
    own = np.where(matched, assignments, 0)
    image, variance2 = clouds.target.take(own, axis=0), clouds.target_variance.take(own)
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
        before = scale
        if clouds.scaled:
            spread = (weight * (first**2).sum(axis=2)).sum(axis=1)
            scale = np.maximum((values * signs).sum(axis=1), 1e-300) / np.maximum(spread, 1e-300)
            if np.all(np.abs(scale - before) <= SETTLED * scale):
                break
    rotation = (u * signs[:, None]) @ vt
    off = second - scale[:, None, None] * first @ rotation.swapaxes(1, 2)
    chi2 = (weight * (off**2).sum(axis=2)).sum(axis=1)
    curvature = _curvature(scale[:, None] * values * signs)
    turned = _log_rotation_integral(curvature)
    if mirror:
        other = signs * np.where(np.arange(size) == size - 1, -1.0, 1.0)
        worse = scale * (values * (signs - other)).sum(axis=1)
        turned = np.logaddexp(
            turned, _log_rotation_integral(_curvature(scale[:, None] * values * other)) - worse
        ) - math.log(2.0)
    n_matched = matched.sum(axis=1)
    freedom = size * (n_matched - 1) - angle_count(size)
    norm = 0.5 * size * np.log(np.where(matched, weight / TURN, 1.0)).sum(axis=1)
    evidence = norm + 0.5 * size * np.log(TURN / total) + turned - 0.5 * chi2
    if clouds.scaled:
        freedom = freedom - 1
        evidence += 0.5 * np.log(TURN / (scale**2 * spread + TURN / RANGE_OF_LOG**2)) - math.log(RANGE_OF_LOG)
    turns = 1.0 / (curvature + 1.0 / TURN)
    fit = PointSetFit(
        chi2=chi2, dof=np.maximum(freedom, 0).astype(np.int64), evidence=evidence, clouds=clouds,
        assignments=assignments, rotation=rotation, shift=centre2 - scale[:, None] * _rotate_points(rotation, centre),
        scale=scale, centre=centre,
        spread=turns if size == 3 else np.repeat(turns, 2, axis=1), frame=u, total=total, full=np.empty((count, 0, 0)),
    )  # fmt: skip
    if not clouds.has_covariances:
        return fit
    if not mirror:
        return _refine_with_covariances(fit, centre2)
    flipped = copy_with(fit, rotation=(u * np.where(np.arange(size) == size - 1, -signs, signs)[:, None]) @ vt)
    every = _refine_with_covariances(fit.joined(flipped), np.concatenate([centre2, centre2]))
    own, other = every.evidence[:count], every.evidence[count:]
    better = np.where(other > own, count, 0) + np.arange(count)
    return copy_with(every.take(better), evidence=np.logaddexp(own, other) - math.log(2.0))


def concatenate_clouds(every: Sequence[PointClouds]) -> PointClouds:
    """The points of several bodies among the same targets."""
    known = [one.source_covariance for one in every if one.source_covariance is not None]
    return every[0]._replace(
        source=np.concatenate([one.source for one in every]),
        source_variance=np.concatenate([one.source_variance for one in every]),
        source_covariance=np.concatenate(known) if known else None,
    )


def _refine_with_covariances(fit: PointSetFit, centre2: Floats) -> PointSetFit:
    """A fit by the covariances of all pairs, by Laplace's method about its motion.

    A rotation of a plane is still integrated as if χ² were its cosine.
    """
    size, scaled = fit.shift.shape[1], fit.clouds.scaled
    angles = angle_count(size)
    (rotation, shift, log_scale), chi2, log_white, information = fit_with_covariances(
        fit.clouds, fit.assignments, fit.centre, (fit.rotation, centre2, np.log(fit.scale))
    )
    scale = np.exp(log_scale)
    # one after the other: the rotation, given that all else follows it, then the scale, then the shift
    rest, across = information[:, angles:, angles:], information[:, :angles, angles:]
    of_turn = information[:, :angles, :angles] - across @ np.linalg.solve(rest, across.swapaxes(1, 2))
    curvature, frame = np.linalg.eigh(of_turn)
    curvature = np.maximum(curvature, 0.0)
    of_shift = rest[:, :size, :size]
    evidence = log_white - 0.5 * size * math.log(TURN) * (fit.assignments >= 0).sum(axis=1) - 0.5 * chi2
    evidence += 0.5 * size * math.log(TURN) - 0.5 * np.linalg.slogdet(of_shift)[1] + _log_rotation_integral(curvature)
    if scaled:
        column = rest[:, :size, size]
        of_scale = rest[:, size, size] - (column * np.linalg.solve(of_shift, column[..., None])[..., 0]).sum(axis=1)
        evidence += 0.5 * np.log(TURN / (of_scale + TURN / RANGE_OF_LOG**2)) - math.log(RANGE_OF_LOG)
    own = 1.0 / (curvature + 1.0 / TURN)
    vague = np.zeros(rest.shape[1] + angles)
    vague[:angles] = 1.0 / TURN
    return copy_with(
        fit, chi2=chi2, evidence=evidence, rotation=rotation, scale=scale,
        shift=shift - scale[:, None] * _rotate_points(rotation, fit.centre),
        spread=own if size == 3 else np.repeat(own, 2, axis=1), frame=frame if size == 3 else fit.frame,
        full=np.asarray(np.linalg.inv(information + np.diag(vague)), np.float64),
    )  # fmt: skip


def squared_deviations(off: Floats, spread: Floats) -> Floats:
    """Squares (…,) of deviations (…, k) over their covariances (…, k, k)."""
    return np.asarray((off * np.linalg.solve(spread, off[..., None])[..., 0]).sum(axis=-1))


def scale_variance(fit: PointSetFit) -> Floats:
    """Variance (K,) of the logarithm of the scale."""
    clouds, matched = fit.clouds, fit.assignments >= 0
    variance = clouds.target_variance[np.where(matched, fit.assignments, 0)]
    weight = matched / (variance + fit.scale[:, None] ** 2 * clouds.source_variance)
    squares = ((clouds.source - fit.centre[:, None]) ** 2).sum(axis=2)
    return np.asarray(1.0 / np.maximum(fit.scale**2 * (weight * squares).sum(axis=1), 1e-300))


def _rotate_points(rotation: Floats, points: Floats) -> Floats:
    """Rotated points (K, k)."""
    return np.asarray((rotation @ points[:, :, None])[:, :, 0])


def _curvature(values: Floats) -> Floats:
    """Second derivatives of χ²/2 by turns about the axes of the target's frame, (K, 3) in space and (K, 1) in a plane.

    ``values`` (K, k): singular values of the cross-covariance, the last negative where a reflection would fit better.
    """
    total = values.sum(axis=1, keepdims=True)
    return np.asarray(np.maximum(total - values if values.shape[1] == 3 else total, 0.0))


def _log_rotation_integral(curvature: Floats) -> Floats:
    """Logarithm of the mean over all rotations of exp(−χ²/2), over its value at the best one."""
    if curvature.shape[1] == 1:
        from scipy.special import i0e  # slow to import

        return np.asarray(np.log(i0e(curvature[:, 0])))
    # 8π² is the volume of the rotations
    return np.asarray(0.5 * np.log(TURN / (curvature + 1.0 / TURN)).sum(axis=1) - math.log(2.0 * TURN**2))
