"""Points that no camera shows, of something that has other points in their stead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from hall_scenes import RIG, SIGMA, cluster, images
from rootmatch.model.elsewhere import _Place, log_odds_of_another
from rootmatch.model.image_alike import REACH


def found(seed: int, *, elsewhere: int, covered: int) -> rm.Match:
    """A cluster of six markers, of which the last ones are elsewhere, and the last ones are covered."""
    rng = np.random.default_rng(seed)
    points = cluster(rng, 6)
    built = points.copy()
    built[6 - elsewhere :] = cluster(rng, elsewhere)
    shown = np.repeat([0.8, 0.0], [6 - covered, covered])
    return rm.match(points, images(rng, built, shown)[0], rm.P3P(RIG), noise=SIGMA)


@pytest.mark.parametrize("seed", [1008, 1010])
def test_two_points_that_are_elsewhere_may_be_of_something_else(seed: int) -> None:
    """Four of six points match, and cameras see two more in the place of the others: the body with two points moved,
    with .05² (`INEXACT`), or something else, with .001 / 4 (`WRONG_MODEL`, `ANOTHER`)."""
    match = found(seed, elsewhere=2, covered=0)
    assert match.sightings is not None
    assert ((match.sightings.assignment >= 0).any(axis=0) == [True] * 4 + [False] * 2).all()
    odds = log_odds_of_another(match.finding.model, match.finding.posterior.modes, match.finding.mode)
    np.testing.assert_allclose(odds, np.log(0.1), atol=0.02)
    assert not match
    assert match.probability is not None
    assert match.probability < 1 / 1.1


@pytest.mark.parametrize("seed", [1008, 1010])
def test_two_points_that_are_covered_are_not_elsewhere(seed: int) -> None:
    match = found(seed, elsewhere=0, covered=2)
    assert match
    assert match.probability is not None
    assert match.probability > 0.99


def test_detections_are_gated_as_one_by_one() -> None:
    """Each by its squared deviation from where a point that may be anywhere is predicted, of its own camera."""
    match = found(1008, elsewhere=2, covered=0)
    model, told = match.finding.model, match.finding.posterior
    assert model is not None
    assert told is not None
    modes, rng = told.modes, np.random.default_rng(0)
    model = replace(model, sigma=rng.uniform(0.2, 0.4, model.shape[1]))
    at, free = model.linearise_about(modes.rotation[:1], modes.position[:1]), rng.random(model.shape[1]) < 0.8
    rows = np.flatnonzero(modes.visible[0] > 0.1)
    near = _Place(model, at, modes.covariance[0], rows).gate(free)
    spread, gated = np.zeros((9, 9)), 0
    spread[:6, :6], spread[6:, 6:] = modes.covariance[0], model.radius**2 * np.eye(3)
    for row in rows.tolist():
        (own,) = (free & (model.image_indices == row // 6)).nonzero()
        jacobian = np.hstack([at.jacobian[0, row], at.jacobian[0, row, :, 3:]])
        across = jacobian @ spread @ jacobian.T + model.sigma[own].max() ** 2 * np.eye(2)
        off = model.target[own] - at.pixels[0, row]
        squared = np.array([one @ np.linalg.solve(across, one) for one in off])
        expected = own[squared < REACH**2].tolist()
        assert near[row].tolist() == expected
        gated += len(expected)
    assert gated > len(rows)


def flight(seed: int, *, moved: bool, beside: bool = False) -> tuple[int, int]:
    """Trusted frames of a cluster of six markers in flight, before and after one is dark; in the end, ten frames each.

    ``moved``: whether it is elsewhere on the body then; ``beside``: whether another marker comes near, but turns.
    """
    rng = np.random.default_rng(seed)
    points, axis, trusted = cluster(rng, 6), rng.normal(size=3), [0, 0]
    tracker = rm.Tracker(points, rm.P3P(RIG), noise=SIGMA)
    for k in range(40):
        R = Rotation.from_rotvec(0.01 * k * axis).as_matrix()
        built, shown = points.copy(), np.full(7, 0.95)
        if moved and k >= 10:
            built[5] += (0.04, -0.03, 0.02)
        passing = R.T @ Rotation.from_rotvec((0.0, 0.0, 0.05 * k)).as_matrix() @ (0.08, 0.0, 0.0)
        shown[5:] = 0.95 * (moved or k < 10), 0.95 * (beside and k >= 10)
        target, _ = images(rng, np.vstack([built, passing]), shown, (R, np.array([0.02 * k, 0.0, 0.0])))
        match = tracker.update(target, time=k / 60.0)
        trusted[0] += bool(match) and k < 10
        trusted[1] += bool(match) and k >= 30
    return trusted[0], trusted[1]


@pytest.mark.parametrize("seed", [1002])
def test_a_point_that_moves_with_the_body_in_the_stead_of_another_is_of_something_else(seed: int) -> None:
    """It may as well be the body, of which a marker was moved."""
    assert flight(seed, moved=True) == (10, 0)


@pytest.mark.parametrize("seed", [1003])
@pytest.mark.parametrize("beside", [False, True])
def test_a_dark_point_is_no_reason_for_doubt_nor_is_what_does_not_move_with_the_body(seed: int, beside: bool) -> None:
    early, late = flight(seed, moved=False, beside=beside)
    assert early == 10
    assert late >= 9
