"""Motions of one point set onto another with the noise of both, also where its axes differ, as fits take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.algebra.rotation import angle_count, rotation_from_vector, turn_jacobian
from rootmatch.arrays import Floats, Integers
from rootmatch.frozen import copy_with
from rootmatch.problems.points import PointClouds
from rootmatch.problems.pose_fit.descent import STEPS, State, descend

REWEIGHTED = 3
"""How often covariances of axes that differ are taken anew. A round value."""
ROUGH = 8
"""Steps of the fits of labellings with each of these. A round value: most settle in four."""


@dataclass(frozen=True, eq=False)
class MotionModel:
    """One motion; see `rootmatch.problems.pose_fit.descent.Model`. States: (R, t, log scale).

    The true points are eliminated: a pair deviates by its distance over √(σ'² + scale² σ²) on each axis.
    """

    source: Floats
    """(m, k), or (B, m, k) of each problem; so are the others."""
    target: Floats
    """(m, k)."""
    variance: Floats
    """(m,) of the source."""
    variance2: Floats
    """(m,) of the target."""
    scaled: bool
    white: Floats | None = None
    """(m, k, k) in the place of 1 / σ, where axes differ; 0 of points without a match."""

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.source.shape[-1])

    def residuals(self, state: State) -> Floats:
        """See `Model`."""
        off, sigma, _ = self._parts(state)
        rows = len(off), off.shape[1] * off.shape[2]  # there may be no labelling
        if self.white is not None:
            return np.asarray((self.white @ off[..., None]).reshape(rows))
        return (off / sigma[..., None]).reshape(rows)

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
        return np.asarray(whole.reshape(len(moved), moved.shape[1] * size, whole.shape[-1]))

    def moved(self, state: State, step: Floats) -> State:
        """See `Model`."""
        angles = angle_count(self.dimension)
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


def reweight(
    model: MotionModel, state: State, clouds: PointClouds, assignments: Integers, steps: int = STEPS
) -> tuple[MotionModel, State]:
    """Fits of assignments (B, n) with covariances of axes that differ, those of the fit before, and their weights."""
    turns = clouds.source_covariance is not None or (model.scaled and bool(clouds.source_variance.any()))
    for _ in range(REWEIGHTED if turns else 1):
        model = copy_with(model, white=_whitening(clouds, assignments, state))
        state, _ = descend(model, state, steps)
    return model, state


def _whitening(clouds: PointClouds, assignments: Integers, state: State) -> Floats:
    """Inverse Cholesky factors (B, n, k, k) of the covariances of pairs, 0 where there is none."""
    first, second = clouds.covariances(np.exp(state[2])[:, None, None] * state[0])
    both = first + second[np.where(assignments >= 0, assignments, 0)]
    return np.asarray((assignments >= 0)[..., None, None] * np.linalg.inv(np.linalg.cholesky(both)))


def fit_with_covariances(
    clouds: PointClouds, assignments: Integers, centre: Floats, state: State
) -> tuple[State, Floats, Floats, Floats]:
    """The motion of each assignment (K, n) about a centre (K, k) of the source, from one that is nearly it.

    Returns
    -------
    state : State
    chi2 : (K,) array
    log_white : (K,) array
        Sum of the logarithms of 1 / √|Σ|.
    information : (K, p, p) array
        Exact second derivatives of χ²/2 by a turn, a shift of the centre, and the logarithm of the scale.
    """
    image = clouds.target[np.where(assignments >= 0, assignments, 0)]
    variance2 = clouds.target_variance[np.where(assignments >= 0, assignments, 0)]
    model = MotionModel(clouds.source - centre[:, None], image, clouds.source_variance, variance2, clouds.scaled)
    model, state = reweight(model, state, clouds, assignments, ROUGH)
    assert model.white is not None
    residuals, jacobian = model.residuals(state), model.jacobian(state)
    normal = jacobian.swapaxes(1, 2) @ jacobian
    information = normal + _residual_curvature(model, state, residuals)
    minimum = np.linalg.eigvalsh(information)[:, 0]
    information = np.where((minimum > 0.0)[:, None, None], information, normal)
    diagonal = np.diagonal(model.white, axis1=2, axis2=3)
    log_white = np.log(np.where(diagonal > 0.0, diagonal, 1.0)).sum(axis=(1, 2))
    return state, (residuals**2).sum(axis=1), log_white, information


def _residual_curvature(model: MotionModel, state: State, residuals: Floats) -> Floats:
    """What second derivatives (K, p, p) of moved points, times what is left of their deviations, add to Jᵀ J."""
    assert model.white is not None
    size = model.dimension
    moved = np.exp(state[2])[:, None, None] * model.source @ state[0].swapaxes(1, 2)
    pull = (model.white.swapaxes(2, 3) @ residuals.reshape(*moved.shape, 1))[..., 0]
    outer = pull.swapaxes(1, 2) @ moved
    along = np.trace(outer, axis1=1, axis2=2)
    angles = angle_count(size)
    whole = np.zeros((len(moved), *(angles + size + model.scaled,) * 2))
    if size == 3:
        whole[:, :3, :3] = 0.5 * (outer + outer.swapaxes(1, 2))
    whole[:, range(angles), range(angles)] -= along[:, None]
    if model.scaled:
        turned = (turn_jacobian(moved).swapaxes(2, 3) @ pull[..., None])[..., 0].sum(axis=1)
        whole[:, -1, -1] = along
        whole[:, -1, :angles] = whole[:, :angles, -1] = turned
    return whole
