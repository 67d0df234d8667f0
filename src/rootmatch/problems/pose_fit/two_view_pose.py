"""Maximum-likelihood pose of a second camera against a first one, a direction common to both known.

Both images are noisy: a pair counts by its first-order (Sampson) distance from the epipolar geometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rootmatch.algebra.directions import tangent_bases
from rootmatch.algebra.rotation import cross_matrix, rotation_about_y, rotation_from_vector
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.problems.pose_fit.baselines import add_far_baselines, baseline_directions, rotation_alone
from rootmatch.problems.pose_fit.descent import (
    DELTA,
    KEPT,
    ROUGH_STEPS,
    STEPS,
    State,
    descend,
    select_lowest,
    state_covariance,
    sum_of_squares,
)
from rootmatch.problems.pose_fit.epipolar_lines import Views
from rootmatch.problems.pose_fit.fitted_pose import make_pose_of_fit
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.starts import DOUBTED

ANGLES = 240
"""Rotations about the common direction that are tried, 1.5° apart. Not tuned."""
STARTS = 6
"""The best of them, from which an assignment is fitted. Not tuned."""
ALONG = 2.0
"""Noise of a position along an epipolar line over that across it, as the rotation's own noise adds to it. Not tuned."""
OPEN = 1.0
"""σ in radians beforehand of an angle that the points leave open. By construction: about all of it."""

BENT = 0.15
"""Relative deviation of χ² from its parabola, at the 68 % contour along its axes, from which samples are drawn. A round
value: variances are then off by about as much (benchmarks/poses.py)."""
SAMPLES = 512
"""Samples a round. Not tuned: a variance is then known to about a tenth."""
ROUNDS = 5
"""Rounds, each with a proposal that fits the samples of those before. Not tuned."""
TAILS = 4.0
"""Degrees of freedom of the proposal, a t distribution, whose tails are wider than those of any likelihood here."""
TEMPERATURE = 2.0
"""Log likelihoods are divided by this where proposals are fitted: they then reach along valleys that bend. Of 1, 2, 3
the value with the most of 1,200 scenes with noisy directions inside the 95 % quantile, by 0.4 % (seeds from 1000)."""
ENOUGH = 30.0
"""Minimum effective number of samples. Not tuned."""


@dataclass(frozen=True, eq=False)
class _TwoViewModel:
    """B relative poses; see `rootmatch.problems.pose_fit.descent.Model`. States: (R, t), t of length 1, y common."""

    views: Views
    k: Integers
    """(B, n) detections."""
    used: Bools
    planar: bool
    """Whether t is orthogonal to the common direction."""

    @property
    def size(self) -> int:
        """Parameters: an angle, the direction of t, and two tilts where the common direction is noisy."""
        return (2 if self.planar else 3) + (2 if self.views.tilt > 0.0 else 0)

    def residuals(self, state: State) -> Floats:
        """See `Model`."""
        parts = [np.where(self.used, self._deviations(state)[0], 0.0)]
        if self.views.tilt > 0.0:
            parts.append(_tilts(state[0]) / self.views.tilt)
        return np.concatenate(parts, axis=1)

    def jacobian(self, state: State) -> Floats:
        """See `Model`; by central differences."""
        count, size = len(state[0]), self.size
        signs = np.concatenate([np.eye(size), -np.eye(size)])
        many, around = self.moved_by(state, np.tile(DELTA * signs, (count, 1)))
        values = many.residuals(around).reshape(count, 2, size, -1)
        return np.asarray((values[:, 0] - values[:, 1]).swapaxes(-1, -2) / (2.0 * DELTA))

    def moved(self, state: State, step: Floats) -> State:
        """See `Model`."""
        turn, moves = self.directions(state[1])
        rotation = rotation_from_vector(step @ turn) @ state[0]
        translation = state[1] + np.einsum("bp,bpi->bi", step, moves)
        return rotation, translation / np.linalg.norm(translation, axis=1, keepdims=True)

    def repeated(self, times: int) -> _TwoViewModel:
        """Each of the fits so many times, one after another."""
        return replace(self, k=np.repeat(self.k, times, axis=0), used=np.repeat(self.used, times, axis=0))

    def moved_by(self, state: State, steps: Floats) -> tuple[_TwoViewModel, State]:
        """States after each of several steps (B S, p), S from every state, and the model of all of them."""
        times = len(steps) // len(state[0])
        many = self.repeated(times)
        return many, many.moved(tuple(np.repeat(part, times, axis=0) for part in state), steps)

    def hidden(self, state: State) -> Floats:
        """Minus the log probability (B,) that the points lie before both cameras."""
        along = self.views.parallax(state[0], state[1], np.arange(self.k.shape[1]), self.k)
        off = np.minimum(along, 0.0) / (ALONG * self._deviations(state)[1])
        return np.asarray(np.where(self.used, 0.5 * off**2, 0.0).sum(axis=1))

    def widths(self, state: State) -> Floats:
        """Sum (B,) of the logarithms of σ across the epipolar lines: the density of a detection is 1 over that."""
        return np.asarray(np.where(self.used, np.log(self._deviations(state)[1]), 0.0).sum(axis=1))

    def _deviations(self, state: State) -> tuple[Floats, Floats]:
        """See `Views.deviations`."""
        return self.views.deviations(cross_matrix(state[1]) @ state[0], np.arange(self.k.shape[1]), self.k)

    def directions(self, translation: Floats) -> tuple[Floats, Floats]:
        """The rotation vector (p, 3) and the change of t (B, p, 3) that belong to each parameter."""
        size = self.size
        turn, moves = np.zeros((size, 3)), np.zeros((len(translation), size, 3))
        turn[0, 1] = 1.0
        if self.planar:
            moves[:, 1] = np.cross([0.0, 1.0, 0.0], translation)
        else:
            moves[:, 1], moves[:, 2] = tangent_bases(translation)
        if self.views.tilt > 0.0:
            turn[-2, 0] = turn[-1, 2] = 1.0
        return turn, moves


def two_view_poses(
    views: Views, rotations: tuple[Floats, Floats], target: Floats, assignments: Integers, planar: bool = False
) -> list[Pose | None]:
    """The most likely relative pose of each assignment (K, n).

    Parameters
    ----------
    views : Views
    rotations : two (3, 3) arrays
        Of both camera frames onto those of the views.
    target : (n', 2) array
        Pixels of the second image.
    assignments : (K, n) int array
        −1 where unmatched; at least three matches in each, two where the motion is planar.
    planar : bool
        Whether the camera moves at right angles to the common direction.
    """
    count = len(assignments)
    every = _TwoViewModel(views, np.maximum(assignments, 0), assignments >= 0, planar)
    starts = _starts(every)
    times = starts[0].shape[1]
    state = tuple(part.reshape(-1, *part.shape[2:]) for part in starts)
    for steps, kept in ((ROUGH_STEPS, KEPT), (STEPS, 1)):
        model = every.repeated(times)
        state, chi2 = descend(model, state, steps)
        # points lie before both cameras: −t fits the epipolar lines as well as t
        hidden = np.array([model.hidden((state[0], sign * state[1])) for sign in (1.0, -1.0)])
        state = state[0], np.where((hidden[0] <= hidden[1])[:, None], state[1], -state[1])
        times = min(kept, times)
        cost = chi2 + 2.0 * hidden.min(axis=0)
        # the lowest of each group, with χ² alone beside them
        (rotation, translation, chi2), _ = select_lowest((*state, chi2), cost, count, times)
        state = rotation, translation
    return [
        _pose(every, k, tuple(part[k : k + 1] for part in state), float(chi2[k]), rotations=rotations, target=target)
        if np.isfinite(chi2[k])
        else None
        for k in range(count)
    ]


def _starts(model: _TwoViewModel) -> State:
    """Rotations (K, S, 3, 3) and translations (K, S, 3) of least deviation, of a grid of rotations."""
    views, k, used = model.views, model.k, model.used
    angle = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    rotation = rotation_about_y(np.cos(angle), np.sin(angle))
    turned = views.first @ rotation.swapaxes(-1, -2)
    # t · (R q × q') = 0
    rows = np.cross(turned[None], views.second[k][:, None]) * used[:, None, :, None]
    if model.planar:
        rows = rows[..., [0, 2]]
    minimum = np.linalg.eigh(rows.swapaxes(-1, -2) @ rows)[1][..., 0]
    translation = (
        np.stack([minimum[..., 0], 0.0 * minimum[..., 0], minimum[..., 1]], axis=-1) if model.planar else minimum
    )
    deviation, _ = views.deviations(cross_matrix(translation) @ rotation, np.arange(k.shape[1]), k[:, None])
    total = np.where(used[:, None], np.log1p(deviation**2 / DOUBTED), 0.0).sum(axis=-1)
    valley = (total <= np.roll(total, 1, axis=1)) & (total <= np.roll(total, -1, axis=1))
    best = np.argsort(np.where(valley, total, np.inf), axis=1, kind="stable")[:, :STARTS]
    # where the parallax is less than the steps of the grid, baselines at these say nothing
    ways = baseline_directions(model.planar)
    alone = rotation_alone(views.first, views.second[k], used)
    turned = np.repeat(rotation_about_y(np.cos(alone), np.sin(alone))[:, None], len(ways), axis=1)
    return (
        np.concatenate([rotation[best], turned], axis=1),
        np.concatenate([translation[np.arange(len(k))[:, None], best], np.tile(ways, (len(k), 1, 1))], axis=1),
    )


def _tilts(rotation: Floats) -> Floats:
    """Rotation (B, 2) of the common direction about x and z, in radians.

    By the angle, not by its sine: half a turn about a horizontal baseline leaves the epipolar lines as they are, and
    would cost nothing.
    """
    sine = np.stack([rotation[:, 2, 1], -rotation[:, 0, 1]], axis=1)
    size = np.linalg.norm(sine, axis=1)
    angle = np.arctan2(size, rotation[:, 1, 1])
    return np.where(size > 0.0, angle / np.maximum(size, 1e-300), 1.0)[:, None] * sine


def _pose(
    model: _TwoViewModel, k: int, state: State, chi2: float, *, rotations: tuple[Floats, Floats], target: Floats
) -> Pose:
    """The pose of one fit, in the frames of the cameras."""
    views = model.views
    members = np.flatnonzero(model.used[k])
    alone = replace(model, k=model.k[k : k + 1], used=model.used[k : k + 1])

    def excess(steps: Floats) -> Floats:
        beyond = np.asarray((np.abs(steps) > np.pi).any(axis=1))
        many, moved = alone.moved_by(state, np.where(beyond[:, None], 0.0, steps))
        reached = sum_of_squares(many.residuals(moved)) + 2.0 * (many.hidden(moved) + many.widths(moved))
        return np.where(beyond, np.inf, reached - lowest)

    lowest = chi2 + 2.0 * float((alone.hidden(state) + alone.widths(state))[0])

    covariance = second_moments(excess, _bound_covariance(state_covariance(alone, state)[0]))
    covariance = add_far_baselines(alone, state, lowest, covariance)
    turn, moves = alone.directions(state[1])
    to_camera = rotations[1].T
    change = np.concatenate([to_camera @ turn.T, to_camera @ moves[0].T])
    detected = model.k[k, members]
    essential = cross_matrix(state[1][0]) @ state[0][0]
    off, sigma = views.offsets_from_lines(essential, members, detected)
    if target.shape[1] == 3:
        rays = views.second[detected] / np.linalg.norm(views.second[detected], axis=1, keepdims=True)
        predicted = (rays - (views.second_axes[detected] @ off[..., None])[..., 0]) @ rotations[1]
    else:
        predicted = target[detected] - off
    distance = np.linalg.norm(off, axis=1)
    return make_pose_of_fit(
        to_camera @ state[0][0] @ rotations[0],
        to_camera @ state[1][0],
        change @ covariance @ change.T,
        chi2=chi2,
        dof=len(members) - model.size + (2 if views.tilt > 0.0 else 0),
        points=members,
        predicted=predicted,
        residuals=distance,
        sigma=sigma,
    )


def _bound_covariance(covariance: Floats) -> Floats:
    """A covariance whose angles stay within about a radian: beyond, all directions are as likely."""
    return np.asarray(np.linalg.inv(np.linalg.inv(covariance) + np.eye(len(covariance)) / OPEN**2))


def second_moments(chi2: Callable[[Floats], Floats], covariance: Floats) -> Floats:
    """Second moments (p, p) about 0 of steps under exp(−χ² / 2), by adaptive importance sampling.

    Two views that determine a rotation and a baseline badly have valleys of χ² that bend, and (Jᵀ J)⁻¹ at the bottom is
    then far too small.

    Parameters
    ----------
    chi2 : callable
        Excess of χ² (S,) over the bottom after steps (S, p) from there; infinite where impossible.
    covariance : (p, p) array
        (Jᵀ J)⁻¹ at the bottom, returned where χ² is a parabola that far, or where samples cannot say more: a direction
        that the points do not determine at all, or hardly any sample that is likely.
    """
    try:
        sampled = _sample_moments(chi2, covariance)
    except np.linalg.LinAlgError:  # a proposal without extent in some direction
        return covariance
    return covariance if sampled is None or not np.all(np.isfinite(sampled)) else sampled


def _sample_moments(chi2: Callable[[Floats], Floats], covariance: Floats) -> Floats | None:
    """See `second_moments`; nothing if the covariance given is as good."""
    values, vectors = np.linalg.eigh(covariance)
    axes = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    size = len(axes)
    contour = float(np.sqrt(size))
    ends = chi2(contour * np.concatenate([axes, -axes]))
    if not np.any(np.abs(ends / size - 1.0) > BENT):
        return None
    rng = np.random.default_rng(0)
    mean, root = np.zeros(size), axes.T
    steps: list[Floats] = []
    excess: list[Floats] = []
    proposals: list[tuple[Floats, Floats]] = []
    weight = np.zeros(0)
    for _ in range(ROUNDS):
        normal = rng.standard_normal((SAMPLES, size)) / np.sqrt(rng.chisquare(TAILS, (SAMPLES, 1)) / TAILS)
        steps.append(mean + normal @ root.T)
        excess.append(chi2(steps[-1]))
        proposals.append((mean, root))
        every = np.concatenate(steps)
        # all samples of all rounds, as of the mixture of their proposals
        density = np.mean([_t_density(every, *proposal) for proposal in proposals], axis=0)
        weight, tempered = (_weights(np.concatenate(excess) / heat, density) for heat in (1.0, TEMPERATURE))
        if not weight.any():
            return None
        mean = tempered @ every
        spread = (every - mean).T @ (tempered[:, None] * (every - mean)) + 1e-3 * covariance
        root = np.linalg.cholesky(spread)
    if 1.0 / float((weight**2).sum()) < ENOUGH:
        return None
    every = np.concatenate(steps)
    return np.asarray(every.T @ (weight[:, None] * every))


def _weights(chi2: Floats, density: Floats) -> Floats:
    """Weights (S,) of samples drawn with a density, of sum 1; all 0 where no sample is possible."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        weight = np.exp(-0.5 * chi2) / density
    weight = np.where(np.isfinite(weight), weight, 0.0)
    return weight / max(float(weight.sum()), 1e-300)


def _t_density(steps: Floats, mean: Floats, root: Floats) -> Floats:
    """Density (S,) of a t distribution, up to a factor that all share."""
    squared = (np.linalg.solve(root, (steps - mean).T) ** 2).sum(axis=0)
    size = len(mean)
    return np.asarray((1.0 + squared / TAILS) ** (-0.5 * (TAILS + size)) / abs(np.linalg.det(root)))
