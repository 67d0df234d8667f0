"""Levenberg–Marquardt over poses: many fits side by side, each to the bottom of its χ² (NumPy)."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from rootmatch.arrays import Bools, Floats

State = tuple[Floats, ...]

ROUGH_STEPS = 12
"""Steps after which fits from many starts are compared. Not tuned: most have arrived by then."""
KEPT = 3
"""How many fits from many starts, the lowest, are continued to convergence. Not tuned."""
STEPS = 300
"""Maximum number of steps. Not tuned: well-placed points take 5, points nearly on a line hundreds."""
SETTLED = 1e-13
"""Predicted relative decrease of χ² below which a fit has converged. Not tuned."""
DELTA = 1e-5
"""Step of central differences, in radians and in the unit of the fit. Not tuned."""
MAX_DAMPING = 1e12
"""Damping at which a fit that no step improves ends. Not tuned."""


class Model(Protocol):
    """A model to fit: B problems, each with its own parameters; B is the first axis of all arrays."""

    def residuals(self, state: State) -> Floats:
        """Deviations over their σ (B, r); 0 for what is not measured, NaN or infinity where a state is impossible."""
        ...

    def jacobian(self, state: State) -> Floats:
        """Derivatives (B, r, p) of the residuals by a small step."""
        ...

    def moved(self, state: State, step: Floats) -> State:
        """The state after a step (B, p)."""
        ...


def sum_of_squares(residuals: Floats) -> Floats:
    """χ² (B,) of residuals (B, r); infinite where one is not a number."""
    total = (residuals**2).sum(axis=-1)
    return np.where(np.isfinite(total), total, np.inf)


def descend(model: Model, state: State, steps: int = STEPS) -> tuple[State, Floats]:
    """The states at the bottom of the valleys in which they lie, and their χ² (B,).

    Marquardt's damping: each parameter by its own curvature, so units do not matter. A state that is impossible stays
    where it is, with infinite χ².
    """
    with np.errstate(all="ignore"):
        residuals = model.residuals(state)
        chi2 = sum_of_squares(residuals)
        damping = np.full(len(chi2), 1e-4)
        done = ~np.isfinite(chi2)
        for _ in range(steps):
            if done.all():
                break
            jacobian = np.nan_to_num(model.jacobian(state), nan=0.0, posinf=0.0, neginf=0.0)
            normal = jacobian.swapaxes(-1, -2) @ jacobian
            slope = (jacobian.swapaxes(-1, -2) @ np.nan_to_num(residuals, posinf=0.0, neginf=0.0)[..., None])[..., 0]
            diagonal = np.arange(normal.shape[-1])
            normal[:, diagonal, diagonal] *= 1.0 + damping[:, None]
            step = -np.linalg.solve(regularise_normal(normal), slope[..., None])[..., 0]
            reached = model.moved(state, np.where(done[:, None], 0.0, step))
            residuals2 = model.residuals(reached)
            chi22 = sum_of_squares(residuals2)
            better = (chi22 < chi2) & ~done
            state = tuple(_select_states(better, new, old) for new, old in zip(reached, state, strict=True))
            residuals = _select_states(better, residuals2, residuals)
            # what the step promised settles only where the damping did not cut it short
            settled = (-(slope * step).sum(axis=-1) <= SETTLED * chi2) & (damping <= 1e-3)
            chi2 = np.where(better, chi22, chi2)
            damping = np.where(better, np.maximum(0.1 * damping, 1e-12), 10.0 * np.maximum(damping, 1e-6))
            done |= settled | (damping > MAX_DAMPING) | (chi2 == 0.0)
    return state, chi2


def regularise_normal(normal: Floats) -> Floats:
    """Normal equations (K, p, p), made solvable where a pose is not determined."""
    p = normal.shape[-1]
    whole = np.isfinite(normal.sum(axis=(1, 2), keepdims=True))
    normal = np.where(whole, normal, np.eye(p))
    diagonal = np.arange(p)
    normal[:, diagonal, diagonal] *= 1.0 + 1e-12
    normal[:, diagonal, diagonal] += 1e-300
    return normal


def state_covariance(model: Model, state: State) -> Floats:
    """Covariances (B, p, p) of steps from the bottom: (Jᵀ J)⁻¹, by the law of Gauß and Markov."""
    with np.errstate(all="ignore"):
        jacobian = np.nan_to_num(model.jacobian(state), nan=0.0, posinf=0.0, neginf=0.0)
        inverse = np.linalg.inv(regularise_normal(jacobian.swapaxes(-1, -2) @ jacobian))
    return np.asarray(0.5 * (inverse + inverse.swapaxes(-1, -2)), dtype=np.float64)


def select_lowest(state: State, chi2: Floats, groups: int, count: int = 1) -> tuple[State, Floats]:
    """The ``count`` lowest fits of each group; groups are of equal size and follow one another."""
    order = np.argsort(chi2.reshape(groups, -1), axis=1, kind="stable")[:, :count]
    pick = (np.arange(groups)[:, None] * (len(chi2) // groups) + order).ravel()
    return tuple(part[pick] for part in state), chi2[pick]


def _select_states(condition: Bools, new: Floats, old: Floats) -> Floats:
    return np.where(condition.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
