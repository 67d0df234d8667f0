"""Two images of scenes that are alike, and not the same: houses with the same windows, and a wall larger than both."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.model import two_view_alike
from rootmatch.model.two_view_alike import _alike_density_ratios, _integrate_share
from rootmatch.model.two_view_model import Relative, TwoViewModel

CAMERA = rm.Camera(1000.0, 1000.0, 640.0, 480.0)
SIGMA = 0.3


def windows(columns: int, rows: int, off: float, rng: np.random.Generator) -> np.ndarray:
    """Windows (n, 3) of a house across the street, each off the grid."""
    x, y = np.meshgrid(2.5 * np.arange(columns), 3.0 * np.arange(rows))
    grid = np.column_stack([x.ravel() - x.mean(), y.ravel() - 5.0, np.full(x.size, 12.0)])
    return grid + rng.normal(0.0, off, grid.shape)


def images_of(
    first: np.ndarray, second: np.ndarray, baseline: float, rng: np.random.Generator
) -> tuple[rm.Match, np.ndarray]:
    """The match of images of two houses, and the window of the second house that each of the first one's would be."""
    views = [Rotation.from_euler("zx", rng.normal(0.0, (0.03, 0.05))).as_matrix() for _ in range(2)]
    seen = []
    for house, R, x in ((first, views[0], 0.0), (second, views[1], baseline)):
        pixels = CAMERA.project((house - (x, 0.0, 0.0)) @ R.T) + rng.normal(0.0, SIGMA, (len(house), 2))
        inside = np.flatnonzero(((pixels > 0.0) & (pixels < (1280.0, 960.0))).all(axis=1))
        inside = rng.permutation(inside)
        seen.append((pixels[inside], inside))
    axis, axis2 = (tuple(R[:, 1]) for R in views)
    problem = rm.ThreePlusOne(CAMERA, axis=axis, axis2=axis2)
    (source, of_first), (target, of_second) = seen
    same = of_first[:, None] == of_second
    truth = np.where(same.any(axis=1), same.argmax(axis=1), -1)
    return rm.match(source, target, problem, noise=SIGMA), truth


def test_houses_with_the_same_windows_are_not_the_same_house() -> None:
    """A few of twelve windows, 8 px off a common grid, agree within the noise, as rows are epipolar lines."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        first, second = (windows(4, 3, 0.1, rng) for _ in range(2))
        match, _ = images_of(first, second, 2.0, rng)
        assert match.probability < 0.9
        if seed < 4:
            match, truth = images_of(first, first, 2.0, rng)
            assert match
            assert np.array_equal(match.assignment, truth)


def test_a_wall_larger_than_both_images_is_still_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """All windows of the second image are near windows of the first, periods away; two thirds of them are the same."""
    sure = []
    for repeated in (two_view_alike.REPEATED, 1e-300):
        monkeypatch.setattr(two_view_alike, "REPEATED", repeated)
        told = []
        for seed in range(5):
            rng = np.random.default_rng(seed)
            wall = windows(10, 3, 0.05, rng)
            match, truth = images_of(wall, wall, 5.6, rng)
            matched = match.assignment >= 0
            assert not match or np.array_equal(match.assignment[matched], truth[matched])
            told.append(match.probability)
        sure.append(int(np.count_nonzero(np.array(told) > 0.9)))
    assert sure[0] >= 1
    assert sure[1] == 0  # as if what is in one image alone had to be clutter


def small_model(rng: np.random.Generator) -> TwoViewModel:
    first, second = (rng.normal((0.0, 0.0, 1.0), 0.2, (count, 3)) for count in (4, 5))
    first, second = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (first, second))
    return TwoViewModel(first, second, np.full(4, 1e-6), np.full(5, 1e-6), np.full(5, 0.7))


def test_the_odds_of_what_is_alike_are_those_of_the_formula() -> None:
    rng = np.random.default_rng(3)
    model = small_model(rng)
    t = rng.normal(size=(6, 3))
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    poses = Relative(rng.normal(0.0, 0.1, 6), t, np.zeros((6, 2)), np.full(6, math.log(0.3)), np.full(6, math.log(0.8)))
    rows, columns = np.repeat(np.arange(4), 5), np.tile(np.arange(5), 4)
    widths = np.array([8.0, 16.0, 32.0, 64.0, 64.0, 64.0])
    ratios = _alike_density_ratios(model, poses, widths, (rows, columns))
    density = np.exp(model.seen(poses, rows, columns, widths[:, None] ** 2).log_density).reshape(6, 4, 5)
    np.testing.assert_allclose(ratios, density.mean(axis=1) / math.exp(0.7), rtol=1e-6, atol=1e-9)
    counted = np.array([[1.0, 1.0, 1.0, 1.0, 1.0], [1.0, 0.0, 0.5, 1.0, 0.0]])
    found = _integrate_share(ratios, counted)
    for some, odds in zip(counted, found, strict=True):
        for ratio, one in zip(ratios, odds, strict=True):
            exact = quad(lambda a, r=ratio, c=some: float(np.prod((1.0 + a * (r - 1.0)) ** c)), 0.0, 1.0)[0]
            assert one == pytest.approx(math.log(exact), abs=1e-4)


def test_pairs_that_are_forbidden_are_not_alike() -> None:
    model = small_model(np.random.default_rng(4))
    weights = np.zeros(model.shape)
    weights[:, 2] = -np.inf
    every = np.repeat(np.arange(4), 4), np.tile([0, 1, 3, 4], 4)
    pose = Relative(np.zeros(1), np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 2)), np.full(1, -1.0), np.full(1, 0.3))
    ratios = _alike_density_ratios(replace(model, log_weights=weights), pose, np.full(1, 64.0), every)
    assert ratios[0, 2] == 0.0
    assert ratios.shape == (1, 5)
