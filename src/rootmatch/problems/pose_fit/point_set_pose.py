"""Maximum-likelihood motion between two point sets of one space, both noisy, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross_matrix, rotation_from_vector
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.descent import Floats, State, covariance_of, descended
from rootmatch.problems.pose_fit.fitted_pose import fitted_pose
from rootmatch.problems.pose_fit.pose import Pose

Integers = NDArray[np.int64]

FLAT = 1e-6
"""Singular value, relative to the largest, below which points lie in a plane, or two on a line. A round value."""
REWEIGHTED = 3
"""How often covariances of axes that differ are taken anew. A round value."""
ROUNDS = 20
"""Maximum number of closed-form fits, in which an unknown scale changes the weights. Not tuned: three are usual."""


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
        if size == 3:
            by_angle = -cross_matrix(moved)
        else:
            by_angle = np.stack([-moved[..., 1], moved[..., 0]], axis=-1)[..., None]
        unit = np.broadcast_to(np.eye(size), (*moved.shape, size))
        parts = [by_angle, unit]
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

    Minimises Σ |scale · R x + t − x'|² / (σ'² + scale² σ²): where the scale is known in closed form (Umeyama 1991, with
    weights). Where axes differ in noise, deviations are weighted by the inverse of Σ' + scale² R Σ Rᵀ, taken at the
    motion of the fit before.

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
    scale = 1.0
    for _ in range(ROUNDS if scaled else 1):
        rotation, translation, now = _closed(source, target, 1.0 / (variance2 + scale**2 * variance), scaled, mirror)
        if abs(now - scale) <= 1e-12 * scale:
            break
        scale = now
    model = _MotionModel(source, target, variance, variance2, scaled)
    state: State = rotation[None], translation[None], np.log(np.array([scale]))
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
    change[shifts, angles] = cross_matrix(turned) if size == 3 else np.array([[turned[1]], [-turned[0]]])
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


def _closed(source: Floats, target: Floats, weight: Floats, scaled: bool, mirror: bool) -> tuple[Floats, Floats, float]:
    """Weighted least squares: rotation, translation and scale."""
    share = weight / weight.sum()
    centre, centre2 = share @ source, share @ target
    first, second = source - centre, target - centre2
    u, values, vt = np.linalg.svd((second * share[:, None]).T @ first)
    signs = np.ones(source.shape[1])
    # points in a plane fit a rotation as well as its reflection, which is then not meant
    flat = values[-1] <= FLAT * values[0]
    if (flat or not mirror) and np.linalg.det(u) * np.linalg.det(vt) < 0.0:
        signs[-1] = -1.0
    rotation = (u * signs) @ vt
    scale = float((values * signs).sum() / (share @ (first**2).sum(axis=1))) if scaled else 1.0
    return rotation, centre2 - scale * rotation @ centre, scale
