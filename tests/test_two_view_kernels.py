"""Compiled parts of the model of two views, against NumPy's density and against a fit by SciPy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from rootmatch.algebra.rotation import rotation_about_y
from rootmatch.model import two_view_fit
from rootmatch.model.two_view_descent import scan_rotations
from rootmatch.model.two_view_model import MIN_SINE, NOTHING, Relative, TwoViewModel
from rootmatch.model.two_view_odds import MIN_SINE2

KINDS = [(False, 0.0), (False, 0.001), (True, 0.0), (True, 0.001)]
"""Planar or not, and σ of the tilts."""


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def scene_of(planar: bool, tilt: float, sigma: float = 1e-6, seed: int = 0) -> tuple[TwoViewModel, Relative]:
    """Points that are seen twice, in order, and their pose; noise is far below the parallaxes."""
    rng, n = np.random.default_rng(seed), 9
    points = rng.uniform((-3.0, -2.0, 4.0), (3.0, 2.0, 9.0), (n, 3))
    t = unit(rng.normal(size=3) * [1.0, 0.0 if planar else 0.5, 0.3])
    poses = Relative(np.array([0.3]), t[None], tilt * rng.normal(size=(1, 2)), np.log([0.15]), np.log([0.3]))
    second = points @ poses.rotation[0].T + t
    bearings = [unit(unit(some) + sigma * rng.normal(size=(n, 3))) for some in (points, second)]
    variances = [sigma**2 * rng.uniform(0.5, 2.0, n) for _ in range(2)]
    return TwoViewModel(*bearings, *variances, rng.normal(0.0, 1.0, n), planar=planar, tilt=tilt), poses


def test_the_grid_has_the_best_baseline_of_each_rotation() -> None:
    for planar, tilt in KINDS:
        model, _ = scene_of(planar, tilt)
        matches = np.array([np.arange(9), [0, 2, 1, -1, -1, 5, 4, 7, 8]])
        total, axes = np.empty((2, 40)), np.empty((2, 40, 3))
        scan_rotations(model.views, planar, matches, 3.0, total, axes)
        for k, turn in np.ndindex(2, 40):
            own = np.flatnonzero(matches[k] >= 0)
            angle = 2.0 * np.pi * turn / 40
            u = model.first[own] @ rotation_about_y(np.cos(angle), np.sin(angle)).T
            rows = np.cross(u, model.second[matches[k, own]])
            if planar:
                basis = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
                best = np.linalg.eigh(basis @ rows.T @ rows @ basis.T)
                best = best[0], basis.T @ best[1]
            else:
                best = np.linalg.eigh(rows.T @ rows)
            reached = ((rows @ axes[k, turn]) ** 2).sum()
            # where two baselines are nearly as good, the grid may have something between them
            assert reached <= best[0][0] + 0.2 * (best[0][1] - best[0][0]) + 1e-12
            if best[0][0] < 0.1 * best[0][1]:
                assert abs(axes[k, turn] @ best[1][:, 0]) == pytest.approx(1.0, abs=1e-6)
            pose = Relative(np.array([angle]), axes[k, turn][None], np.zeros((1, 2)), np.zeros(1), np.zeros(1))
            e = model.seen(pose, own, matches[k, own]).e
            assert total[k, turn] == pytest.approx(np.log1p((e / 3.0) ** 2).sum(), rel=1e-9)


@pytest.mark.parametrize(("planar", "tilt"), KINDS)
def test_log_odds_are_those_of_the_density(planar: bool, tilt: float) -> None:
    assert pytest.approx(MIN_SINE**2) == MIN_SINE2
    rng = np.random.default_rng(5)
    model, true = scene_of(planar, tilt, 1e-4)
    weights = np.where(rng.random((9, 9)) < 0.2, -np.inf, rng.normal(0.0, 1.0, (9, 9)))
    second = model.second.copy()
    second[3], second[5] = model.first[3], true.translation[0]  # without parallax; in the epipole
    poses = Relative(*(np.repeat(part, 60, axis=0) for part in true))
    step = rng.normal(0.0, 1.0, (60, model.size)) * np.geomspace(1e-5, 1.0, 60)[:, None]
    step[:, -2:] = rng.normal(0.0, 3.0, (60, 2))
    poses = model.moved(poses, step)
    poses.translation[50] = model.first[0] @ poses.rotation[50].T  # a point in the direction of the motion
    variance, term = rng.gamma(10.0, 0.1, 60), rng.normal(0.0, 2.0, 60)
    pairs = np.divmod(np.arange(81), 9)
    seen = 0
    for log_weights in (None, weights):
        this = replace(model, second=second, log_weights=log_weights)
        found = this.log_odds(poses, variance, term, pairs)
        expected = this.seen(poses, *pairs, variance[:, None]).log_density - this.log_clutter[pairs[1]] + term[:, None]
        expected += 0.0 if log_weights is None else log_weights[pairs]
        # below that, what one of them leaves out is nothing to the other
        np.testing.assert_allclose(np.maximum(found, NOTHING), np.maximum(expected, NOTHING), atol=1e-7)
        seen += np.count_nonzero(found > NOTHING)
    assert seen > 250


def deviations(model: TwoViewModel, pose: Relative, matches: np.ndarray, weights: np.ndarray, near: bool) -> np.ndarray:
    """What a fit makes small."""
    own = np.flatnonzero(matches >= 0)
    seen, weight = model.seen(pose, own, matches[own]), weights[own]
    parts = [weight * seen.e[0]]
    if near:
        usable = (seen.ahead[0] > 0.0) & np.isfinite(seen.z[0])
        parts += [weight * np.where(usable, seen.z[0], 6.0), weight * seen.behind[0]]
    if model.tilt > 0.0:
        parts.append(pose.tilt[0] / model.tilt)
    return np.concatenate(parts)


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize(("planar", "tilt"), KINDS)
def test_a_descent_ends_where_that_of_scipy_does(planar: bool, tilt: float, near: bool) -> None:
    reached = 0
    for seed in range(8):
        model, true = scene_of(planar, tilt, seed=seed)
        rng = np.random.default_rng(seed)
        matches, weights = np.arange(9), rng.uniform(0.3, 1.0, 9)
        matches[4] = -1
        if seed % 2:
            matches[[1, 2]] = matches[[2, 1]]  # large deviations
        start = model.moved(true, np.concatenate([rng.normal(0.0, 0.01, (1, model.size - 2)), [[0.2, 0.0]]], axis=1))
        begun = start._replace(turn=start.turn.copy())
        found, normal = two_view_fit._descend_weighted(model, start, matches[None], weights[None], near, steps=60)
        np.testing.assert_array_equal(start.turn, begun.turn)

        def of(step: np.ndarray, pose: Relative, model=model, matches=matches, weights=weights) -> np.ndarray:  # type: ignore[no-untyped-def]
            if not near:
                step = np.append(step, 0.0)
            moved = model.moved(pose, np.append(step, 0.0)[None])
            return deviations(model, moved, matches, weights, near)

        still = np.zeros(model.size - (1 if near else 2))
        minimum = least_squares(of, still, args=(start,), x_scale="jac", method="trf", xtol=1e-12, ftol=1e-12).cost
        value = 0.5 * (of(still, found) ** 2).sum()
        reached += value <= minimum * (1.0 + 1e-4) + 1e-6
        slopes = np.stack([of(s, found) - of(-s, found) for s in 1e-6 * np.eye(len(still))], axis=1) / 2e-6
        size = len(still)
        scale = np.sqrt(np.outer(*2 * [np.diag(slopes.T @ slopes)]))
        if not seed % 2:
            np.testing.assert_allclose(normal[0, :size, :size] / scale, slopes.T @ slopes / scale, atol=0.02)
        assert math.isfinite(found.scale[0])
    assert reached >= 6
