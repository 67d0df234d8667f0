"""Scenes that repeat themselves, of which two views show half: a labelling that is a period off, and the right one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.arrays import Floats, Integers
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.point_set_posterior import weigh_point_set_posterior
from rootmatch.model.repetition import find_repetition
from rootmatch.model.targets_box import view_probability_among
from rootmatch.problems.points import PointClouds
from rootmatch.samplers.point_sets.congruent import MAX_KEPT, congruent_labellings

SIGMA = 0.03
ROOM = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 5.0], [0.0, 5.0], [1.5, 0.0], [2.4, 0.0]])
Scene = tuple[Floats, Floats, Integers]


def rooms(seed: int) -> Scene:
    """Two maps of five rooms that differ by 10 cm, three of them in each; and the right labels."""
    rng = np.random.default_rng(seed)
    every = np.concatenate([ROOM + np.array([4.3 * k, 0.0]) for k in range(5)]) + rng.normal(0.0, 0.1, (30, 2))
    return halves(every, 13.7, 7.7, rng)


def halves(every: Floats, end: float, begin: float, rng: np.random.Generator, sigma: float = SIGMA) -> Scene:
    """Points up to one place, and from another one on, in a frame of their own; a tenth of each is lost."""
    first = np.flatnonzero((every[:, 0] < end) & (rng.random(len(every)) > 0.1))
    second = rng.permutation(np.flatnonzero((every[:, 0] > begin) & (rng.random(len(every)) > 0.1)))
    turn = rng.uniform(0.0, 2.0 * np.pi)
    back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    source = every[first] + rng.normal(0.0, sigma, (len(first), 2))
    target = every[second] @ back + rng.normal(0.0, sigma, (len(second), 2))
    place = np.full(len(every), -1)
    place[second] = np.arange(len(second))
    return source, target, place[first]


def is_right(match: rm.Match, truth: Integers) -> bool:
    """Whether there are matches, and all of them are right."""
    matched = match.assignment >= 0
    return bool(matched.any() and (match.assignment == truth)[matched].all())


def clouds_of(source: Floats, target: Floats) -> PointClouds:
    """Both sets with their noise."""
    u, v = (np.full(len(points), SIGMA**2) for points in (source, target))
    return PointClouds(source, target, u, v, scaled=False, mirror=False)


def test_rooms_are_not_matched_a_room_off() -> None:
    right = trusted = 0
    for seed in range(5):
        source, target, truth = rooms(seed)
        match = rm.match(source, target, rm.Rigid(2), noise=(SIGMA, SIGMA))
        right += is_right(match, truth)
        trusted += bool(match)
        assert is_right(match, truth) or not match
    assert right >= 4
    assert trusted >= 2


def test_what_the_best_labelling_leaves_repeats_the_targets() -> None:
    source, target, truth = rooms(10)
    model = PointSetModel(clouds_of(source, target))
    proposals = np.concatenate([truth[None], congruent_labellings(model.clouds, False).proper])
    judged = model.judge(proposals)
    assert judged.log_odds.argmax() > 0  # against clutter anywhere, another labelling is better
    found = find_repetition(model, judged)
    assert found is not None
    own, again, more = found
    assert more > 3.0  # the targets repeat themselves
    assert own.clutter.repeats > 0.5
    lead, before = (one.log_odds[0] - one.log_odds[judged.log_odds.argmax()] for one in (again, judged))
    assert lead > before + 3.0
    # shares are of all clutter
    assert own.clutter.alone + own.clutter.crowd_share + own.clutter.repeats == pytest.approx(1.0)


def test_the_image_of_an_object_repeats_as_it_does_itself() -> None:
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=2).reshape(-1, 2)
    model = PointSetModel(clouds_of(grid, grid + rng.normal(0.0, SIGMA, grid.shape)))
    judged = model.judge(congruent_labellings(model.clouds, False).proper)
    assert (judged.fit.assignments[judged.log_odds.argmax()] >= 0).all()
    found = find_repetition(model, judged)
    assert found is not None
    # so the best labelling, which leaves nothing, is as probable with repetitions as without
    assert float(found.judged.log_odds.max()) + found.log_odds == pytest.approx(float(judged.log_odds.max()), abs=1.0)
    told = weigh_point_set_posterior(model, judged)
    again = weigh_point_set_posterior(found.model, found.judged)
    assert min(told.present, again.present) > 0.99


def test_points_that_do_not_repeat_have_no_repetition() -> None:
    rng = np.random.default_rng(4)
    source, target, _ = halves(rng.uniform(0.0, 10.0, (30, 2)), 7.0, 3.0, rng)
    model = PointSetModel(clouds_of(source, target))
    judged = model.judge(congruent_labellings(model.clouds, False).proper)
    assert find_repetition(model, judged) is None


def road(seed: int) -> tuple[Floats, Floats, Integers]:
    """Two drives along one road, of which they have 40 of 100 m in common: dashes every 12 m, and studs anywhere."""
    rng = np.random.default_rng(seed)
    ends = np.arange(14)[:, None] * 12.0 + [0.0, 3.0] + rng.uniform(-6.0, 6.0)
    dashes = np.concatenate([np.stack([ends.ravel(), np.full(ends.size, y)], axis=1) for y in (0.0, 3.5)])
    world = np.concatenate([dashes, rng.uniform((0.0, -3.0), (160.0, 7.0), (20, 2))])
    in_first, in_second = ((world[:, 0] > x) & (world[:, 0] < x + 100.0) for x in (0.0, 60.0))
    first, second = (np.flatnonzero(shown & (rng.uniform(size=len(world)) < 0.95)) for shown in (in_first, in_second))
    second = rng.permutation(second)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    source, target = (world[own] + rng.normal(0.0, 0.03, (len(own), 2)) for own in (first, second))
    place = np.full(len(world), -1)
    place[second] = np.arange(len(second))
    return source, target @ turn.T + (20.0, -5.0), place[first]


def test_an_exact_row_is_not_matched_where_it_overlaps_most() -> None:
    """What stands by an exact law is in its place at each period; what stands anywhere tells which."""
    right = wrong = 0
    for seed in range(6):
        source, target, truth = road(seed)
        match = rm.match(source, target, rm.Rigid(2), noise=(0.03, 0.03))
        right += is_right(match, truth)
        wrong += bool(match) and not is_right(match, truth)
        assert is_right(match, truth) or seed not in (1, 5)  # which are right by displaced labellings alone
    assert right >= 3
    assert wrong <= 1


def test_what_is_flat_shows_places_within_the_noise() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0.0, 10.0, (30, 2)), np.zeros(30)])
    places = np.array([[5.0, 5.0, 0.02], [5.0, 5.0, 1.0], [11.5, 5.0, 0.0]])
    chances = view_probability_among(places, points, np.full(30, 0.02**2))
    assert chances[0] == pytest.approx(1.0)
    assert chances[1] < 1e-3
    assert 1e-3 < chances[2] < 0.2


def test_labellings_that_are_kept_are_near_their_motions() -> None:
    """The right one has fewer matches than some hundred others, whose motions bring rooms roughly onto rooms."""
    for seed in (1, 3, 24):
        source, target, truth = rooms(seed)
        found = congruent_labellings(clouds_of(source, target), False).proper
        assert len(found) == MAX_KEPT
        assert (((found == truth) & (truth >= 0)).sum(axis=1) >= 0.8 * (truth >= 0).sum()).any()


def test_points_beyond_the_window_are_not_missed() -> None:
    """Two halves of a cloud: the points that only one of them can show are no evidence against their motion."""
    trusted, gained = 0, 0.0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        source, target, truth = halves(rng.uniform(0.0, 10.0, (24, 2)), 7.0, 3.0, rng, 2.0 * SIGMA)
        match = rm.match(source, target, rm.Rigid(2), noise=(2.0 * SIGMA, 2.0 * SIGMA))
        assert is_right(match, truth) or not match
        trusted += bool(match)
        # a rate that is given is that of all points
        model = PointSetModel(clouds_of(source, target))
        known = replace(model, detection_rate=0.5)
        fit = model.fit(truth[None])
        gained += float(model.log_factors(fit)[-1, 0] - known.log_factors(fit)[-1, 0]) / 8.0
    assert gained > 2.0
    assert trusted >= 6
