"""Regions of which targets show more than of the rest: their probability, and what it does to matches in them."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.special import betaln

import rootmatch as rm
from rootmatch.arrays import Floats, Integers
from rootmatch.model.labelling_sums import sum_labellings
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.shown_regions import log_region_factor
from rootmatch.problems.points import PointClouds


def plot(seed: int) -> tuple[Floats, Floats, Integers]:
    """Stems of a forest plot, a scan of seven in ten of those within 22 m of a place, and 25 others in all the plot."""
    rng = np.random.default_rng(seed)
    stems, place, angle = rng.uniform(0.0, 60.0, (70, 2)), rng.uniform(15.0, 30.0, 2), rng.uniform(0.0, 6.28)
    seen = np.flatnonzero((np.linalg.norm(stems - place, axis=1) < 22.0) & (rng.random(70) < 0.7))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    target = np.concatenate([stems[seen], rng.uniform(0.0, 60.0, (25, 2))]) @ turn.T
    truth = np.full(70, -1)
    truth[seen] = np.arange(len(seen))
    source = stems + rng.normal(0.0, 0.1, stems.shape)
    return source, target + rng.normal(0.0, 0.1, target.shape), truth


@pytest.mark.parametrize("n", [2, 3, 5, 9])
def test_the_probabilities_of_all_that_may_be_shown_sum_to_one(n: int) -> None:
    source = np.random.default_rng(n).uniform(size=(n, 2))
    every = np.array(list(product([False, True], repeat=n)))
    shown = every.sum(axis=1)
    log_flat = betaln(shown + 1.0, n - shown + 1.0)
    assert np.exp(log_flat + log_region_factor(source, every)).sum() == pytest.approx(1.0, abs=1e-5)


def test_in_a_region_that_is_shown_a_point_is_hardly_missed() -> None:
    source, _, truth = plot(0)
    changed = np.repeat((truth >= 0)[None], 71, axis=0)
    changed[np.arange(70), np.arange(70)] ^= True
    *others, own = log_region_factor(source, changed)
    more = np.where(truth >= 0, -1.0, 1.0) * (np.array(others) - own)
    assert own > 5.0
    assert np.median(more[truth >= 0]) > 1.0
    away = np.linalg.norm(source - source[truth >= 0].mean(axis=0), axis=1)
    assert more[np.argsort(away)[-20:]].max() < -1.0
    assert log_region_factor(source, (np.arange(70) % 3 == 0)[None])[0] > -0.23, "points anywhere lose a fifth at most"


def test_sums_over_labellings_have_regions_in_them() -> None:
    """Labellings of the sums differ as those that are weighed by fits of their own do."""
    source, target, truth = plot(3)
    clouds = PointClouds(source, target, np.full(70, 0.01), np.full(len(target), 0.01), scaled=False, mirror=False)
    model = PointSetModel(clouds)
    (seen,) = np.nonzero(truth >= 0)
    without = np.tile(truth, (len(seen), 1))
    without[np.arange(len(seen)), seen] = -1
    every = np.concatenate([truth[None], without])
    odds = model.judge(every).log_odds
    sums = sum_labellings(model, every, np.exp(odds - odds.max()))
    assert sums is not None
    shares = np.log(sums.shares(every))
    np.testing.assert_allclose(shares[1:] - shares[0], odds[1:] - odds[0], atol=0.5)


def test_a_scan_of_a_part_of_a_plot_is_trusted() -> None:
    """With one rate for all stems each match loses up to a hundredth, and half of such scans were ambiguous.

    What is left out, so that all that remain are right together, is in the first alternative.
    """
    trusted = 0
    for seed in range(8):
        source, target, truth = plot(seed)
        match = rm.match(source, target, rm.Rigid(), noise=(0.1, 0.1))
        if not match:
            continue
        trusted += 1
        kept = match.assignment >= 0
        np.testing.assert_array_equal(match.assignment[kept], truth[kept])
        whole, found = match.alternatives[0][0], match.finding.labellings
        assert found is not None
        np.testing.assert_array_equal(whole, found.assignments[0])
        np.testing.assert_array_equal(whole[kept], match.assignment[kept])
    assert trusted >= 7


def test_a_certain_motion_of_points_in_doubt_is_told() -> None:
    """The motion is certain, and each of many points has two targets near its place: nothing there is symmetric."""
    rng = np.random.default_rng(1)
    source = rng.uniform(0.0, 100.0, (12, 2))
    moved = source @ np.array([[0.6, -0.8], [0.8, 0.6]]).T + 30.0
    target = np.concatenate([moved, moved[:10] + rng.normal(0.0, 0.15, (10, 2))])
    match = rm.match(source, target + rng.normal(0.0, 0.1, target.shape), rm.Rigid(), noise=(0.0, 0.1))
    assert match.status is rm.Status.MATCHED
    twice = np.flatnonzero(match.assignment < 0)
    assert 6 <= len(twice) <= 10
    assert (match.confidence[twice] < 0.95).all()
    assert (match.assignment % 12 == np.arange(12))[match.assignment >= 0].all()
    assert np.abs(match.pose.t - 30.0).max() < 0.5
