"""Unmatched points where nothing is recognised: the body may be absent, or be there and show too little."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations
from math import comb, exp, lgamma
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.finding import make_empty_finding
from rootmatch.explain.image_decision import image_finding
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.model import unrecognised
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.mode_search import find_modes
from rootmatch.model.pose_density import Broad, Doubted, Gaussian
from rootmatch.model.posterior import empty_posterior
from rootmatch.model.proposals import Proposals
from rootmatch.model.shown_in_part import (
    IN_SIGHT,
    SIGHT,
    FewShown,
    ShownOfCopy,
    count_distributions,
    count_ways_to_own,
    odds_of_few,
    sum_small_subsets,
)
from rootmatch.model.two_view_model import TwoViewModel
from rootmatch.model.two_view_posterior import TwoViewPosterior

Floats = NDArray[np.float64]
CAMERA = rm.Camera(800.0, 800.0, 320.0, 240.0)


def test_what_images_may_show_of_a_copy_by_enumeration() -> None:
    """Five points before two cameras, of which one leaves four detections and the other three."""
    rate, counts, camera = 0.7, np.array([4, 3]), rm.Camera(800.0, 800.0, 320.0, 240.0)
    views = [(camera, np.eye(3), np.zeros(3)), (camera, np.eye(3), np.array([0.1, 0.0, 0.0]))]
    points, rows = np.random.default_rng(0).uniform(-0.1, 0.1, (5, 3)), np.zeros((9, 3))
    rows[:, :2], rows[:, 2] = np.random.default_rng(1).uniform(0.0, 480.0, (9, 2)), np.arange(9) % 2
    options = MatchOptions(detection_rate=rate)
    task = MatchingTask.of(rm.P3P(rm.Rig(views)), points, rows, noise=0.3, options=options)
    shown = ShownOfCopy.of(Candidate.make_model(task), counts, 8, 10.0)

    def of_image(chance: float, count: int, maximum: int) -> float:
        own = [comb(5, k) * chance**k * (1.0 - chance) ** (5 - k) for k in range(maximum + 1)]
        ways = [exp(lgamma(count + 1) - lgamma(count - k + 1) + lgamma(count - k + 0.5)) for k in range(maximum + 1)]
        return float(np.dot(own, ways)) / exp(lgamma(count + 0.5))

    def odds(first: int, second: int) -> float:
        cases = [(0.9, rate), *((0.1 / 3.0, part * rate) for part in IN_SIGHT)]
        return sum(weight * of_image(each, 4, first) * of_image(each, 3, second) for weight, each in cases)

    for maximum in ((4, 3), (3, 3), (3, 2)):
        assert shown.unmet_odds(np.array(maximum)) == pytest.approx(odds(*maximum) - odds(2, 2), rel=1e-6)
    assert shown.unmet_odds(np.array([2, 2])) == 0.0


def test_few_detected_points_by_enumeration() -> None:
    rng = np.random.default_rng(0)
    chance, weights, counts, maximum = rng.uniform(0.1, 0.9, (3, 2, 4)), np.array([0.2, 0.5, 0.3]), (3, 1), 2

    def of_image(case: int, image: int) -> tuple[float, Floats]:
        """Sum over what is detected of an image, and over that without each point."""
        total, without = 0.0, np.zeros(4)
        for k in range(maximum + 1):
            ways = len(list(permutations(range(counts[image]), k)))
            odds = np.exp(lgamma(counts[image] - k + 0.5) - lgamma(counts[image] + 0.5)) if ways else 0.0
            for some in combinations(range(4), k):
                own = np.isin(np.arange(4), some)
                value = ways * odds * np.prod(np.where(own, chance[case, image], 1.0 - chance[case, image]))
                total += value
                without += value * ~own
        return total, without

    whole, without = 0.0, np.zeros((2, 4))
    for case, weight in enumerate(weights):
        (first, of_first), (second, of_second) = of_image(case, 0), of_image(case, 1)
        whole += weight * first * second
        without += weight * np.array([of_first * second, first * of_second])
    odds, share = odds_of_few(chance.transpose(1, 2, 0), weights, np.array(counts), maximum)
    assert odds == pytest.approx(whole)
    np.testing.assert_allclose(share, without.reshape(-1) / whole)


def test_what_may_be_hidden_as_a_whole_is_summed_over_what_is_ever_visible() -> None:
    rng = np.random.default_rng(1)
    visible, rates, maximum = rng.uniform(0.0, 1.0, (3, 8)) * (rng.random(8) < 0.7), np.array([0.4, 0.95]), 2
    few = count_distributions(visible, rates, 2, maximum)
    each = np.outer(rates, (1.0, *IN_SIGHT)).reshape(-1)
    chance = (visible.T[:, :, None] * each).reshape(2, 4, -1)
    assert SIGHT.sum() == pytest.approx(1.0)
    for counts in (np.array([3, 1]), np.array([0, 2])):
        odds = (count_ways_to_own(counts, maximum) * few).sum(axis=0).prod(axis=0)
        np.testing.assert_allclose(np.log(odds), sum_small_subsets(chance, counts, maximum)[0])


def test_what_is_expected_of_a_body_is_worked_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, rng = list[int](), np.random.default_rng(2)
    points = rng.uniform(-0.1, 0.1, (6, 3))
    guess = Gaussian(np.eye(3), np.array([0.0, 0.0, 1.0]), 1e-4 * np.eye(6))
    prior = Doubted([guess], [np.log(0.99)], Broad(0.1), 0.01)
    target = CAMERA.project(points + np.array([0.2, 0.0, 1.0]))
    model = DetectionModel(CAMERA, points, target, np.ones(6), prior=prior)
    place = Proposals(np.arange(6)[None], np.eye(3)[None], points.mean(axis=0)[None] + [0.2, 0.0, 1.0])
    modes, work = find_modes(model, place), unrecognised.count_distributions

    def counted(visible: Floats, *rest: Any) -> Any:
        asked.append(len(visible))
        return work(visible, *rest)

    monkeypatch.setattr(unrecognised, "count_distributions", counted)
    first = unrecognised.odds_of_unrecognised(model, prior, modes)
    again = unrecognised.odds_of_unrecognised(replace(model), prior, modes)
    np.testing.assert_array_equal(first, again)
    assert asked == [unrecognised.POSES]


def scene(seed: int, rate: float = 0.6, clutter: int = 2) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Six LEDs in some turn, or in one of five images none, with clutter; where each is."""
    rng = np.random.default_rng([seed, 77])
    points = rng.uniform(-0.1, 0.1, (6, 3))
    place = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.8, 1.2)])
    pixels = CAMERA.project(points @ Rotation.random(random_state=seed).as_matrix().T + place)
    shown = np.flatnonzero(rng.random(6) < rate)
    target = np.concatenate([pixels[shown], rng.uniform((0, 0), (640, 480), (clutter, 2))])
    truth = np.full(6, -1)
    if rng.random() < 0.2:
        return points, rng.uniform((0, 0), (640, 480), target.shape), truth
    truth[shown] = np.arange(len(shown))
    return points, target + rng.normal(0.0, 0.3, target.shape), truth


def test_confidence_in_unmatched_points_is_right_as_often_as_told() -> None:
    told, right = list[float](), list[bool]()
    for seed in range(150):
        points, target, truth = scene(seed)
        if len(target) < 4:
            continue
        match = rm.match(points, target, rm.P3P(CAMERA), noise=0.3, detection_rate=0.6)
        if not match:
            unmatched = match.assignment < 0
            told += match.confidence[unmatched].tolist()
            right += (truth[unmatched] < 0).tolist()
    assert len(told) > 300
    assert np.mean(right) < 0.9, "else it is no test"
    assert np.mean(told) == pytest.approx(np.mean(right), abs=0.06)


def test_only_who_asks_for_one_body_is_told_of_parts_and_fewer_detections_show_fewer() -> None:
    """Of several motions in an image `rootmatch.explain.missing_motions` says how many are asked for."""
    points, target, _ = scene(0)
    task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.3)

    def confidence(task: MatchingTask, taken: NDArray[np.bool_] | None = None) -> Floats:
        told = image_finding(
            make_empty_finding(task, ""), empty_posterior(6), Candidate.of(task, []), taken=taken
        ).all_confidence
        assert told is not None
        return told

    np.testing.assert_allclose(confidence(replace(task, weighs_parts=False)), 0.999)
    alone, beside = confidence(task), confidence(task, np.arange(len(target)) > 0)  # others have all but one
    assert alone.max() < 0.9
    assert beside.min() > alone.max(), "one detection is one point at most"


def test_what_faces_away_is_not_in_view() -> None:
    """A body is in view by the points that face the camera: half of its turns say nothing of a rate of .97."""
    rng = np.random.default_rng(1)
    points, flat = rng.uniform(-0.05, 0.05, (5, 3)), np.tile([0.0, 0.0, 1.0], (5, 1))
    target = rng.uniform((0, 0), (640, 480), (6, 2))

    def of(normals: Floats) -> Floats:
        given = {"normals": normals, "view_cosine": np.full(5, 0.5), "rate": 0.97}
        model = DetectionModel(CAMERA, points, target, np.full(6, 0.3), **given)
        return FewShown(model, 3, np.array([6])).undetected_probability()

    one_side, all_sides = of(flat), of(points / np.linalg.norm(points, axis=1)[:, None])
    assert 0.75 < one_side.mean() < 0.88, "it would show nearly all of its points, but from beside"
    assert all_sides.mean() < 0.78, "it never shows more than half of them"


def test_a_body_that_a_search_has_not_met_by_enumeration() -> None:
    """With the search's chance of missing what shows more than so few points, and the prior odds of that."""
    rng, maximum, unmet, present = np.random.default_rng(3), 3, 0.3, 0.8 / 0.2
    points, target = rng.uniform(-0.05, 0.05, (5, 3)), rng.uniform((0, 0), (640, 480), (7, 2))
    model = DetectionModel(CAMERA, points, target, np.full(7, 0.3))
    few, more = FewShown(model, maximum, np.array([7])), np.zeros(2)
    rates = np.outer(model.rate_quadrature[0], (1.0, *IN_SIGHT)).reshape(1, 1, -1).repeat(5, axis=1)
    cases = np.outer(np.exp(model.rate_quadrature[1]), SIGHT).reshape(-1)
    for chance, weight in zip(rates[0].T, cases, strict=True):
        for k in range(maximum + 1, 6):
            for some in combinations(range(5), k):
                own = np.isin(np.arange(5), some)
                each = weight * np.prod(np.where(own, chance, 1.0 - chance))
                more += each, each * (0 not in some)
    known = few.undetected_probability()[0]
    odds = odds_of_few(rates, cases, np.array([7]), maximum)[0] * present
    expected = (known * (1.0 + odds) + present * unmet * more[1]) / (1.0 + odds + present * unmet * more[0])
    assert replace(few, unmet=unmet).undetected_probability()[0] == pytest.approx(expected, abs=0.01)
    assert expected < known - 0.03


def test_what_ends_a_search_early_says_little_of_a_body_in_view() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.1, 0.1, (24, 3))
    pixels = CAMERA.project(points + np.array([0.0, 0.0, 1.0])) + rng.normal(0.0, 0.3, (24, 2))
    target = np.concatenate([pixels, rng.uniform((0, 0), (640, 480), (24, 2))])
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.3, sampler=rm.Guided(budget=500))
    assert not match, "else it is no test"
    assert (match.assignment < 0).all()
    assert 0.2 < match.confidence.mean() < 0.7, "was .99: all of them are in view"


def test_two_views_that_share_too_few_points() -> None:
    """Of six points with a rate of .5 most motions show three matches at most; of 1 none does."""
    rays = np.random.default_rng(0).normal(size=(6, 3)) * 0.2 + (0.0, 0.0, 1.0)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    noise = np.full(6, 1e-6)

    def unmatched(rate: float) -> float:
        model = TwoViewModel(rays, rays[:5], noise, noise[:5], np.zeros(5), detection_rate=rate)
        told = TwoViewPosterior(model, -np.inf, []).unmatched
        assert np.ptp(told) < 1e-12
        return float(told[0])

    assert unmatched(0.999) == pytest.approx(0.999 * 0.5 / 0.55, abs=1e-3)
    assert 0.7 < unmatched(0.5) < 0.85  # the absence, .5, and what shows three of six
