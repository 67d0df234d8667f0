"""Points that no camera shows, of something that has other points in their stead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

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
