"""The search by local triples against the exhaustive one among their images, and what it finds of hidden objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rootmatch.arrays import Integers
from rootmatch.explain.explain import explain
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.enumeration import target_arrangements
from rootmatch.problems.padding import select_sources
from rootmatch.samplers.guided import local_growth, local_search
from rootmatch.samplers.guided.hypotheses import Hypotheses
from rootmatch.samplers.guided.listed_triples import run_listed_tests
from rootmatch.samplers.guided.local_growth import PartialVerification
from rootmatch.samplers.guided.local_search import MISSED, LocalSearch
from rootmatch.samplers.guided.minimal_sets import nearest_other_points
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.refinement import verify_known
from rootmatch.samplers.guided.rivals import RIVAL_MISSED
from rootmatch.samplers.guided.screening import ALONG
from rootmatch.samplers.guided.sequential_test import (
    lookups_before_dropped,
    prepare_sets,
    run_sequential_tests,
    sequential_test,
)
from rootmatch.samplers.guided.visibility import FAILURE
from rootmatch.samplers.guided.visible_search import choose_search

Points = NDArray[np.float64]
CAMERA = rm.Camera(3000.0, 3000.0, 2000.0, 1500.0)
SIGMA = 0.5


@pytest.fixture(params=[False, True])
def _verified_in_parts_too(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Verify objects of these tests in parts too, as larger ones are."""
    if request.param:
        monkeypatch.setattr(local_search, "WHOLE", 32)
        monkeypatch.setattr(local_search, "VERIFIED", 24)
        monkeypatch.setattr(local_growth, "VERIFIED", 24)
        monkeypatch.setattr(local_growth, "STRIDE", 2.0)


def seen_from_one_side(source: Points, seed: int, clutter: int) -> tuple[Points, NDArray[np.int64]]:
    """Detections of the half of a surface about the origin that faces the camera, and clutter; the truth."""
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    inside = source @ (rotation * np.linalg.det(rotation)).T
    seen = np.flatnonzero(inside[:, 2] < 0.0)
    inside = inside[seen] + np.array([0.0, 0.0, 4.0])
    pixels = inside[:, :2] / inside[:, 2:] * 3000.0 + [2000.0, 1500.0] + rng.normal(scale=SIGMA, size=(len(seen), 2))
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    pixels = np.concatenate([pixels, rng.uniform(low, high, (clutter, 2))])
    order = rng.permutation(len(pixels))
    truth = np.full(len(source), -1)
    truth[seen] = np.argsort(order)[: len(seen)]
    return pixels[order], truth


def surface(n: int, seed: int) -> Points:
    """Points all over an ellipsoid."""
    normals = np.random.default_rng(seed).normal(size=(n, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True) * [1.0, 0.8, 0.6]


def search_of_points(source: Points, target: Points) -> LocalSearch:
    task = MatchingTask.of(rm.P3P(CAMERA), source, target, noise=SIGMA, options=MatchOptions())
    search = choose_search(task.sampling_task, GuidedOptions(), task.deadline)
    assert isinstance(search, LocalSearch)
    return search


@pytest.mark.parametrize("visible", [0.6, 0.2])
def test_local_tests_are_those_of_all_images_that_are_near(visible: float) -> None:
    """Where few points are visible the others are looked up along the points, not along the images."""
    target, _ = seen_from_one_side(surface(50, 0), 1, clutter=0)
    search = search_of_points(surface(50, 0), target)
    level = search.levels[1]
    points = np.ascontiguousarray(search._triples(level)[:6])
    others = nearest_other_points(points, search.neighbours)
    sets = prepare_sets(search.tables, points, others, np.zeros(len(points), np.int64))
    near = level.ring.near
    test = sequential_test(search.clutter, visible, 0, minimum=4, normals=False)
    assert (lookups_before_dropped(test, others.shape[1], 3) >= ALONG) == (visible < 0.5)
    survivors, ratios, counts = run_listed_tests(
        search.tables, search.grid, test, sets, level.ring, allowed=search.allowed, keep=500, chunks=2
    )
    arrangements = target_arrangements(search.n_target, 2)
    every, every_ratios, _ = run_sequential_tests(
        search.padded, search.grid, test, sets, arrangements, first=0, last=len(points) * len(arrangements),
        allowed=search.allowed, keep=5000, chunks=1,
    )  # fmt: skip
    of_images = {
        tuple(row): ratio
        for row, ratio in zip(every[0].tolist(), every_ratios[0], strict=True)
        if row[0] >= 0 and row[3] in near[row[2]] and row[4] in near[row[2]]
    }
    found = {
        tuple(row): ratio
        for row, ratio in zip(survivors.reshape(-1, 5).tolist(), ratios.reshape(-1), strict=True)
        if row[0] >= 0
    }
    assert counts[:, 0].sum() == len(points) * level.ring.cost
    assert 0 < len(found) == len(of_images)
    assert found == pytest.approx(of_images, abs=1e-9)


def test_hypotheses_verified_on_some_points_are_those_of_an_object_of_these_alone() -> None:
    source = surface(60, 6)
    target, _ = seen_from_one_side(source, 7, clutter=10)
    search = search_of_points(source, target)
    partly = PartialVerification(search.tables, search.positions, search.density, search.allowed)
    near = partly.nearest(5, 24)
    away = np.linalg.norm(search.positions - search.positions[5], axis=1)
    assert 5 in near
    assert away[near].max() < np.delete(away, near).min()
    rng = np.random.default_rng(0)
    own = np.array([rng.choice(24, 3, replace=False) for _ in range(200)])
    images = np.array([[rng.integers(4), *rng.choice(len(target), 3, replace=False)] for _ in range(200)])
    found = partly(near, near[own], images)
    alone = verification_of_these_alone(search, near)(np.arange(24), own, images)
    assert np.isfinite(found.evidence).sum() > 20
    np.testing.assert_allclose(found.evidence, alone.evidence, rtol=1e-9)
    np.testing.assert_array_equal(found.best[:, near], alone.best)
    np.testing.assert_array_equal(found.candidates[:, near], alone.candidates)
    rest = np.setdiff1d(np.arange(60), near)
    assert (found.best[:, rest] == -1).all()


def verification_of_these_alone(search: LocalSearch, near: NDArray[np.int64]) -> PartialVerification:
    """Verification of an object of some points alone, prepared from these."""
    tables = search.tables
    points, camera = tables.points[:, near].T, rm.P3P(CAMERA)
    pixels = (tables.rays[:2] / tables.rays[2]).T * 3000.0 + [2000.0, 1500.0]
    alone = camera.prepare(points, pixels, SIGMA)
    some = select_sources(tables, near, tables.points.shape[1])
    # lengths are in units of the object's own
    np.testing.assert_allclose(some.distance2 / some.distance2.mean(), alone.distance2 / alone.distance2.mean())
    return PartialVerification(alone, np.ascontiguousarray(alone.points.T), search.density, search.allowed)


@pytest.mark.usefixtures("_verified_in_parts_too")
def test_half_hidden_object_among_clutter_is_found_by_local_triples() -> None:
    source = surface(120, 2)
    target, truth = seen_from_one_side(source, 3, clutter=60)
    match = rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA)
    matched = match.assignment >= 0
    assert match.status is rm.Status.MATCHED
    assert (match.assignment == truth)[matched].mean() >= 0.98
    assert (match.assignment == truth)[truth >= 0].mean() >= 0.95
    # every image triple of one source triple is already more
    assert match.evaluated < 20 * len(target) ** 3


@pytest.mark.usefixtures("_verified_in_parts_too")
def test_object_that_looks_like_itself_is_ambiguous() -> None:
    half = surface(30, 4)
    source = np.concatenate([half, half * [-1.0, -1.0, 1.0]])
    target, _ = seen_from_one_side(source, 5, clutter=20)
    match = rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA)
    assert match.status is rm.Status.AMBIGUOUS


def test_everything_tried_leaves_nothing_missed_by_the_reckoning() -> None:
    source = surface(60, 6)
    target, _ = seen_from_one_side(source, 7, clutter=0)
    search = search_of_points(source, target)
    search.run()
    assert search.conclusive
    assert search.missed <= MISSED
    met = [search._met(search._triples(level), level.ring, search.best) for level in search.levels]
    assert search.shares.tolist() == met
    assert all(0.0 < share < 1.0 for share in met)


def seen_here_and_there(n: int, seen: int, seed: int) -> tuple[Points, Points, NDArray[np.int64]]:
    """Points of a box and detections of some of them, any; the truth."""
    rng = np.random.default_rng([seed, n, seen])
    source = rng.uniform(-0.5, 0.5, (n, 3)) * [1.0, 1.0, 0.6]
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    inside = source @ (rotation * np.linalg.det(rotation)).T + [0.0, 0.0, 4.0]
    order = rng.permutation(n)[:seen]
    pixels = CAMERA.project(inside[order]) + rng.normal(scale=SIGMA, size=(seen, 2))
    truth = np.full(n, -1)
    truth[order] = np.arange(seen)
    return source, pixels, truth


def test_few_of_many_points_are_found_by_wide_triples_before_all_local_ones_are_tried() -> None:
    found = [seen_here_and_there(60, 10, seed) for seed in range(4)]
    matches = [rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA) for source, target, _ in found]
    for match, (_, _, truth) in zip(matches, found, strict=True):
        assert match.status is rm.Status.MATCHED
        assert (match.assignment == truth).all()
    # all local triples alone are some hundred million evaluations of each
    assert sum(match.evaluated for match in matches) < 150_000_000


def test_rivals_are_sought_of_a_pose_that_too_few_local_triples_meet() -> None:
    source, target, truth = seen_here_and_there(60, 10, 0)
    task = MatchingTask.of(rm.P3P(CAMERA), source, target, noise=SIGMA)
    search = search_of_points(source, target)
    verify_known(search, truth[task.permutation][None])
    search.run()
    assert not search.wide
    tried = np.array([level.done for level in search.levels])
    assert np.prod((1.0 - (1.0 - FAILURE) * search.shares) ** tried) > MISSED
    assert search.missed <= RIVAL_MISSED


def test_search_begins_with_what_is_known_and_is_not_misled_by_it() -> None:
    source, target, truth = seen_here_and_there(60, 10, 1)
    task = MatchingTask.of(rm.P3P(CAMERA), source, target, noise=SIGMA)
    wrong = np.where(truth < 0, -1, (truth + 1) % 10)
    none, right, misled = (
        explain(replace(task, found_before=None if one is None else np.array(one)))
        for one in (None, [wrong, truth], [wrong])
    )
    for found in (none, right, misled):
        assert found.status is rm.Status.MATCHED
        assert (found.assignment == truth).all()
    assert right.evaluated < 0.5 * none.evaluated
    assert right.task.subset(np.arange(30), np.arange(10)).found_before is None


def test_only_local_triples_are_verified_near_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_search, "WHOLE", 32)
    monkeypatch.setattr(local_search, "VERIFIED", 24)
    verified, before = list[bool](), PartialVerification.__call__

    def watched(self: PartialVerification, some: Integers, points: Integers, images: Integers) -> Hypotheses:
        verified.append(bool(np.isin(points, some).all()))
        return before(self, some, points, images)

    monkeypatch.setattr(PartialVerification, "__call__", watched)
    target, _ = seen_from_one_side(surface(120, 2), 3, clutter=60)
    search = search_of_points(surface(120, 2), target)
    search.run()
    search.refine()
    assert len(verified) > 0
    assert all(verified)
