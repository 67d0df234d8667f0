"""Points of the first image without a match lie together, as those of a vehicle that has moved by itself do."""

from __future__ import annotations

import numpy as np

import rootmatch as rm
from rootmatch.model.clutter import estimate_clutter
from rootmatch.model.two_view_places import log_member_density
from test_two_view_motions import CAMERA, SIGMA, VERTICAL, with_vehicle


def crowd_among_others(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Twenty points (20, 2) of an image, of which the first eight are a crowd; and which these are."""
    rng = np.random.default_rng(seed)
    anywhere = rng.uniform((0, 0), (1280, 960), (12, 2))
    return np.concatenate([rng.normal((900, 300), 40, (8, 2)), anywhere]), np.arange(20) < 8


def test_members_of_a_crowd_are_denser_than_what_lies_anywhere() -> None:
    points, crowd = crowd_among_others(0)
    crowds = estimate_clutter(points, np.full(20, SIGMA), np.array([1280.0 * 960.0]))
    more = log_member_density(crowds, crowd.astype(float)) - log_member_density(crowds, 1.0 - crowd)
    assert more[crowd].min() > 1.0
    assert np.median(more[~crowd]) < 0.0
    np.testing.assert_allclose(log_member_density(crowds, np.zeros(20)), -np.log(1280 * 960))


def test_densities_of_all_members_are_those_of_clutter() -> None:
    points, _ = crowd_among_others(1)
    crowds = estimate_clutter(points, np.full(20, SIGMA), np.array([1280.0 * 960.0]))
    # but for one more that lies anywhere
    np.testing.assert_allclose(log_member_density(crowds, np.full(20, 1e9)), crowds.log_density)


def test_a_vehicle_that_nobody_named_is_not_matched_by_accident() -> None:
    """With one detection rate for all points, all three were trusted with a point of the vehicle at a wrong place."""
    problem = rm.ThreePlusOne(CAMERA, axis=VERTICAL, axis2=VERTICAL)
    for seed in (6, 45, 90):
        source, target, truth, _ = with_vehicle(seed)
        match = rm.match(source, target, problem, noise=SIGMA)
        matched = match.assignment >= 0
        assert not match or (match.assignment == truth)[matched].all()
