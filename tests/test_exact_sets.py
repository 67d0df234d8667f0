"""A source that may be exactly symmetric, measured twice."""

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.model.exact_sets import share_by_exact_shapes
from rootmatch.model.exact_symmetry import fit_exact_shape
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.problems.points import PointClouds

NOISE = 0.05


def halves(rng: np.random.Generator, count: int, size: int) -> np.ndarray:
    """Points and the same after half a turn."""
    points = rng.uniform(-50.0, 50.0, (count, size))
    turned = points.copy()
    turned[:, :2] *= -1.0
    return np.concatenate([points, turned])


def measured_twice(rng: np.random.Generator, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both sets with noise, the second one turned and without some points, and the true labels."""
    n, size = points.shape
    turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    kept = rng.permutation(n)[: n - n // 20]
    truth = np.full(n, -1)
    truth[kept] = np.arange(len(kept))
    source, target = (points + NOISE * rng.normal(size=points.shape) for _ in range(2))
    return source, target[kept] @ turn.T + 100.0, truth


@pytest.mark.parametrize("size", [2, 3])
def test_of_many_points_the_turn_that_fits_better_is_not_trusted(size: int) -> None:
    for seed in range(8):
        rng = np.random.default_rng([seed, size])
        source, target, truth = measured_twice(rng, halves(rng, 40, size))
        match = rm.match(source, target, rm.Rigid(), noise=(NOISE, NOISE))
        assert match.status is rm.Status.AMBIGUOUS
        listed = [match.assignment, *(other for other, _ in match.alternatives[:5])]
        assert any(np.array_equal(one, truth) for one in listed)


@pytest.mark.parametrize("off", [1.5, 3.0])
def test_what_both_sets_show_of_an_asymmetry_tells_the_turn(off: float) -> None:
    """Each point is off by little; in either set alone hardly any deviation is significant."""
    for seed in range(4):
        rng = np.random.default_rng([seed, 5])
        points = halves(rng, 20, 3)
        points += off * NOISE * rng.normal(size=points.shape)
        source, target, truth = measured_twice(rng, points)
        match = rm.match(source, target, rm.Rigid(), noise=(NOISE, NOISE))
        assert match.status is rm.Status.MATCHED
        assert np.array_equal(match.assignment, truth)


@pytest.mark.parametrize("scaled", [False, True])
def test_turns_of_an_exact_shape_have_the_same_evidence(scaled: bool) -> None:
    for size in (2, 3):
        rng = np.random.default_rng(size)
        points = halves(rng, 10, size)
        turned = np.roll(np.arange(20), 10)
        source, target = (points + NOISE * rng.normal(size=points.shape) for _ in range(2))
        model = PointSetModel(
            PointClouds(source, target, np.full(20, NOISE**2), np.full(20, NOISE**2), scaled, mirror=False)
        )
        found = model.judge(np.array([np.arange(20), turned]))
        shares = share_by_exact_shapes(model, found, found.log_odds)
        assert np.logaddexp.reduce(shares) == pytest.approx(np.logaddexp.reduce(found.log_odds))
        covariance = np.tile(NOISE**2 * np.eye(size), (20, 1, 1))
        shape = fit_exact_shape(source, covariance, [(np.arange(20), turned)])
        assert shape is not None
        # the displaced shapes tell them apart by little, the exact one by nothing
        assert shape.log_odds > 2.0
        assert shares[0] == pytest.approx(shares[1], abs=0.5)
