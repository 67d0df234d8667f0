"""Sums over all labellings of two point sets: against all of them one by one, and against Gibbs sampling."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp

import rootmatch as rm
from rootmatch.explain.point_set_decision import make_point_set_model
from rootmatch.explain.task import MatchingTask
from rootmatch.model.labelling_sums import is_same_motion, sum_labellings
from rootmatch.model.matchings import FEWEST, sum_matchings_by_part
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.point_set_posterior import weigh_point_set_posterior


def turned(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points of a plane after a random turn, elsewhere."""
    a = rng.uniform(0.0, 2.0 * np.pi)
    return points @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) + (300.0, 50.0)


def overlapping(seed: int, noise: float, own: int, common: int) -> tuple[np.ndarray, ...]:
    """Two sets of so many points of a plane that have some in common, all measured with noise, and the truth."""
    rng = np.random.default_rng(seed)
    world = rng.uniform(-100.0, 100.0, (2 * own - common, 2))
    source = world[:own] + rng.normal(0.0, noise, (own, 2))
    target = turned(world[own - common :], rng) + rng.normal(0.0, noise, (own, 2))
    order, truth = rng.permutation(own), np.full(own, -1)
    truth[own - common :] = np.argsort(order)[:common]
    return source, target[order], truth


def model_of_sets(source: np.ndarray, target: np.ndarray, noise: tuple[float, float]) -> PointSetModel:
    """The model of one rigid motion."""
    model = make_point_set_model(MatchingTask.of(rm.Rigid(), source, target, noise=noise))
    assert model is not None
    return model


def every_labelling(n: int, n_target: int, minimum: int) -> np.ndarray:
    """All labellings (K, n) of so many matches and more."""
    found = [np.full((1, n), -1)]
    for i in range(n):
        parts = []
        for row in found[-1]:
            free = [-1, *sorted(set(range(n_target)) - set(row.tolist()))]
            more = np.repeat(row[None], len(free), axis=0)
            more[:, i] = free
            parts.append(more)
        found.append(np.concatenate(parts))
    return found[-1][(found[-1] >= 0).sum(axis=1) >= minimum]


def gibbs_marginals(model: PointSetModel, start: np.ndarray, sweeps: int) -> np.ndarray:
    """Probability (n, n' + 1) of each match and of none, from labellings drawn point by point by their odds."""
    rng, one = np.random.default_rng(0), start.copy()
    n, n_target = len(start), len(model.clouds.target)
    squared, variance = (part[0] for part in model.fit(start[None]).squares())
    near, counts = squared < 60.0 * variance, np.zeros((n, n_target + 1))
    for sweep in range(sweeps):
        for i in range(n):
            others = np.delete(one, i)
            targets = np.append(np.setdiff1d(np.flatnonzero(near[i]), others), -1)
            rows = np.repeat(one[None], len(targets), axis=0)
            rows[:, i] = targets
            odds = model.judge(rows).log_odds
            chance = np.exp(odds - logsumexp(odds))
            if sweep >= sweeps // 6:
                counts[i, targets] += chance
            one[i] = rng.choice(targets, p=chance / chance.sum())
    return counts / counts.sum(axis=1, keepdims=True)


def test_sums_in_parts_are_those_of_all_assignments() -> None:
    rng = np.random.default_rng(3)
    pairs = np.array([(0, 0), (0, 1), (1, 1), (2, 3), (3, 3), (3, 4), (4, 2), (5, 5)])
    log_odds = rng.normal(0.5, 2.0, (2, len(pairs)))
    sums = sum_matchings_by_part(log_odds, *pairs.T, minimum=-50.0)
    place = np.full((6, 6), -1)
    place[tuple(pairs.T)] = np.arange(len(pairs))
    every = every_labelling(6, 6, FEWEST)
    own = np.where(every >= 0, place[np.arange(6), every], len(pairs))
    every, own = every[(own >= 0).all(axis=1)], own[(own >= 0).all(axis=1)]
    log_each = np.pad(log_odds, ((0, 0), (0, 1)))[:, own].sum(axis=2)
    assert np.allclose(sums.log_total, logsumexp(log_each, axis=1))
    share = np.exp(log_each - sums.log_total[:, None])
    for row, column, marginal in zip(sums.rows, sums.columns, sums.marginals.T, strict=True):
        assert np.allclose(marginal, share[:, every[:, row] == column].sum(axis=1))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_samples_sum_over_all_labellings(seed: int) -> None:
    """Three pairs of points, near each other: hundreds of labellings count, of which some were weighed."""
    rng, noise = np.random.default_rng([seed, 8]), 3.0
    apart = rng.normal(size=(3, 2))
    corners = np.array([(0.0, 0.0), (90.0, 10.0), (20.0, 70.0)])
    source = np.concatenate([corners, corners + 4.0 * apart / np.linalg.norm(apart, axis=1, keepdims=True)])
    model = model_of_sets(source, turned(source, rng) + rng.normal(0.0, noise, source.shape), (0.0, noise))
    every = every_labelling(6, 6, 3)
    odds = model.judge(every).log_odds
    share = np.exp(odds - logsumexp(odds))
    some = np.argsort(-odds)[:64]
    some = some[is_same_motion(every[some], every[some[0]])]
    sums = sum_labellings(model, every[some], share[some])
    assert sums is not None
    assert sums.shares(every[some]) == pytest.approx(share[some], abs=0.04)
    for one in every[some[:4]]:
        assert sums.weights @ sums.of_points(one) == pytest.approx((every == one).T @ share, abs=0.06)


def test_points_that_overlap_in_part_are_as_doubtful_as_samples_say() -> None:
    """σ is not small beside the spacing, and half of the points have no partner: no match is certain."""
    source, target, truth = overlapping(13, 2.0, 35, 18)
    model = model_of_sets(source, target, (2.0, 2.0))
    found = weigh_point_set_posterior(model, model.judge(truth[None]))
    first = found.assignments[0]
    exact = gibbs_marginals(model, first, 40)
    off = found.confidence[0] - exact[np.arange(len(first)), first]
    assert np.abs(off[first >= 0]).mean() < 0.06
    assert found.confidence[0][first >= 0].max() < 0.998
    assert np.abs(found.confidence[1] - exact[:, -1]).mean() < 0.05


@pytest.mark.parametrize("seed", [216, 262])
def test_two_changes_at_once_are_weighed_where_the_second_costs_little(seed: int) -> None:
    """With one point off σ is in doubt, and a second one is no surprise any more."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(-80.0, 80.0, (7, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    seen, count = source @ turn.T + (0.0, 0.0, 900.0), int(rng.integers(4, 6))
    visible = np.zeros(7, np.bool_)
    visible[rng.choice(7, count, replace=False)] = True
    aside = rng.normal(size=(7, 3))
    aside *= (rng.uniform(1.2, 4.0, 7) / np.linalg.norm(aside, axis=1))[:, None]
    doubled = rng.random(7) < 0.4
    target = np.concatenate([seen[visible] + rng.normal(0.0, 0.3, (count, 3)), (seen + aside)[doubled]])
    own, double = np.full(7, -1), np.full(7, -1)
    own[visible], double[doubled] = np.arange(count), count + np.arange(int(doubled.sum()))
    every = np.array(list(itertools.product(*({-1, a, b} for a, b in zip(own, double, strict=True)))))
    every = every[(every >= 0).sum(axis=1) >= 3]
    target = target[order := rng.permutation(len(target))]
    every = np.where(every >= 0, np.argsort(order)[every], -1)
    match = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.3))
    odds = model_of_sets(source, target, (0.0, 0.3)).judge(every).log_odds
    agree = (every == match.assignment)[:, match.assignment >= 0].all(axis=1)
    assert match.probability < np.exp(logsumexp(odds[agree]) - logsumexp(odds)) + 0.02
