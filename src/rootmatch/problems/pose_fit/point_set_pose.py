"""Maximum-likelihood motion between two point sets of one space, both noisy, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rootmatch.algebra.rotation import rotation_from_vector, turn_jacobian
from rootmatch.arrays import Floats, Integers
from rootmatch.problems.points import PointClouds, PointSets
from rootmatch.problems.pose_fit.descent import State, covariance_of, descended
from rootmatch.problems.pose_fit.fitted_pose import fitted_pose
from rootmatch.problems.pose_fit.point_set_fit import fitted_point_sets
from rootmatch.problems.pose_fit.pose import Pose

FLAT = 1e-6
"""Singular value, relative to the largest, below which points lie in a plane, or two on a line. A round value."""
REWEIGHTED = 3
"""How often covariances of axes that differ are taken anew. A round value."""


@dataclass(frozen=True, eq=False)
class _MotionModel:
    """One motion; see `rootmatch.problems.pose_fit.descent.Model`. States: (R, t, log scale).

    The true points are eliminated: a pair deviates by its distance over √(σ'² + scale² σ²) on each axis.
    """

    source: Floats
    target: Floats
    variance: Floats
    """(m,) of the source."""
    variance2: Floats
    """(m,) of the target."""
    scaled: bool
    white: Floats | None = None
    """(m, k, k) in the place of 1 / σ, where axes differ."""

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.source.shape[1])

    def residuals(self, state: State) -> Floats:
        """See `Model`."""
        off, sigma, _ = self._parts(state)
        if self.white is not None:
            return np.asarray((self.white @ off[..., None]).reshape(len(off), -1))
        return (off / sigma[..., None]).reshape(len(off), -1)

    def jacobian(self, state: State) -> Floats:
        """See `Model`."""
        off, sigma, moved = self._parts(state)
        size = self.dimension
        parts = [turn_jacobian(moved), np.broadcast_to(np.eye(size), (*moved.shape, size))]
        if self.scaled:
            # the weights depend on the scale too
            share = np.exp(2.0 * state[2])[:, None] * self.variance / sigma**2
            parts.append((moved - (0.0 if self.white is not None else share[..., None] * off))[..., None])
        whole = np.concatenate(parts, axis=-1)
        whole = whole / sigma[..., None, None] if self.white is None else self.white @ whole
        return np.asarray(whole.reshape(len(moved), -1, whole.shape[-1]))

    def moved(self, state: State, step: Floats) -> State:
        """See `Model`."""
        angles = 3 if self.dimension == 3 else 1
        if angles == 3:
            turn = rotation_from_vector(step[:, :3])
        else:
            c, s = np.cos(step[:, 0]), np.sin(step[:, 0])
            turn = np.moveaxis(np.array([[c, -s], [s, c]]), -1, 0)
        translation = state[1] + step[:, angles : angles + self.dimension]
        return turn @ state[0], translation, state[2] + (step[:, -1] if self.scaled else 0.0)

    def _parts(self, state: State) -> tuple[Floats, Floats, Floats]:
        """Distances (1, m, k), their σ (1, m), and the source points rotated and scaled."""
        scale = np.exp(state[2])[:, None, None]
        moved = scale * self.source @ state[0].swapaxes(-1, -2)
        sigma = np.sqrt(self.variance2 + scale[..., 0] ** 2 * self.variance)
        return moved + state[1][:, None] - self.target, sigma, moved


def point_set_pose(points: PointSets, assignment: Integers, *, scaled: bool, mirror: bool = False) -> Pose:
    """The most likely motion of the source points of an assignment (n,) onto their targets.

    Minimises Σ |scale · R x + t − x'|² / (σ'² + scale² σ²), from the motion of `fitted_point_sets`. If axes differ in
    noise, deviations are weighted by the inverse of Σ' + scale² R Σ Rᵀ, taken at the motion of the fit before.

    Parameters
    ----------
    points : PointSets
        Both of k = 2 or 3 dimensions.
    assignment : (n,) int array
        −1 where unmatched; at least k matches.
    scaled : bool
        Whether the scale is estimated; 1 otherwise.
    mirror : bool
        Whether a reflection is possible.
    """
    members = np.flatnonzero(assignment >= 0)
    source, target = points.source[members], points.target[assignment[members]]
    variance, variance2 = points.source_noise[members] ** 2, points.target_noise[assignment[members]] ** 2
    centre = source.mean(axis=0)
    source = source - centre
    # points in a plane fit a rotation as well as its reflection, which is then not meant
    values = np.linalg.svd(source, compute_uv=False)
    solid = bool(values[-1] > FLAT * values[0])
    clouds = PointClouds(source, target, variance, variance2, scaled=scaled, mirror=mirror and solid)
    start = fitted_point_sets(clouds, np.arange(len(members))[None], clouds.mirror)
    model = _MotionModel(source, target, variance, variance2, scaled)
    state: State = start.rotation, start.shift, np.log(start.scale)
    if scaled:
        state, _ = descended(model, state)
    if points.source_covariance is not None or points.target_covariance is not None:
        for _ in range(REWEIGHTED):
            model = replace(model, white=_whitening(points, members, assignment[members], state))
            state, _ = descended(model, state)
    (rotation,), (translation,), (log,) = state
    scale, size = float(np.exp(log)), source.shape[1]
    turned = scale * rotation @ centre
    local = covariance_of(model, state)[0]
    change = np.eye(len(local))
    angles = slice(0, 3) if size == 3 else slice(0, 1)
    shifts = slice(angles.stop, angles.stop + size)
    # t = t' − s R c
    change[shifts, angles] = -turn_jacobian(turned)
    if scaled:
        change[shifts, -1], change[-1, -1] = -turned, scale
    off = model.residuals(state)[0]
    predicted = scale * source @ rotation.T + translation
    return fitted_pose(
        rotation,
        translation - turned,
        change @ local @ change.T,
        chi2=float((off**2).sum()),
        dof=size * len(members) - len(local),
        points=members,
        predicted=predicted,
        residuals=np.linalg.norm(target - predicted, axis=1),
        sigma=np.sqrt(variance2 + scale**2 * variance),
        scale=scale if scaled else 1.0,
    )


def _whitening(points: PointSets, members: Integers, images: Integers, state: State) -> Floats:
    """Inverse Cholesky factors (m, k, k) of the covariances of pairs, the source's as a motion turns it."""
    turn = np.exp(state[2][0]) * state[0][0]
    of_source, of_target = (
        sigma[own, None, None] ** 2 * np.eye(len(turn)) if known is None else known[own]
        for known, sigma, own in (
            (points.source_covariance, points.source_noise, members),
            (points.target_covariance, points.target_noise, images),
        )
    )
    both = turn @ of_source @ turn.T + of_target
    least = FLAT**2 * np.trace(both, axis1=1, axis2=2)[:, None, None]
    return np.asarray(np.linalg.inv(np.linalg.cholesky(both + least * np.eye(len(turn)))))
