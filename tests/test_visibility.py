"""Objects that hide most of their points: the order of minimal sets, what a search has missed, and whole matches."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rootmatch.samplers.guided.detection_grid import local_density
from rootmatch.samplers.guided.model_views import model_views
from rootmatch.samplers.guided.visibility import (
    LOST,
    LOST_OF_ALL,
    MISSED,
    TriedSets,
    covering_waves,
    detected_views,
    facing_points,
    random_miss_probability,
    sets_within_views,
    sphere,
    unmet_probability,
    views_of_parts,
)

CAMERA = rm.Camera(800.0, 800.0, 640.0, 480.0)
NOISE = 0.3


def ball(seed: int, n: int = 30) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points near the surface of a ball of 10 cm, and their normals."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals * rng.uniform(0.08, 0.12, (n, 1)), normals


def view(
    seed: int, clutter: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Points, normals, pixels and truth: what lies within 70 degrees of its normal is visible.

    Three objects, as what is worked out for an object alone takes longest and is kept.
    """
    points, normals = ball(seed % 3)
    rng = np.random.default_rng([seed, 1])
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    seen = points @ rotation.T + [0.05, -0.03, 0.6]
    cosine = -((normals @ rotation.T) * seen).sum(axis=1) / np.linalg.norm(seen, axis=1)
    visible = np.flatnonzero(cosine > np.cos(np.radians(70.0)))
    pixels = CAMERA.project(seen[visible]) + NOISE * rng.normal(size=(len(visible), 2))
    pixels = np.vstack([pixels, rng.uniform((0, 0), (1280, 960), (clutter, 2))])
    order = rng.permutation(len(pixels))
    truth = np.full(len(points), -1)
    truth[visible] = np.argsort(order)[: len(visible)]
    return points, normals, pixels[order], truth


def test_the_first_sets_are_visible_from_everywhere() -> None:
    points, normals = ball(0)
    views = facing_points(normals)
    wave = np.concatenate(list(itertools.islice(covering_waves(points, normals, 3), 4)))
    assert len(wave) == 8 + 16 + 32 + 64
    assert len(np.unique(wave, axis=0)) == len(wave)
    covered = sets_within_views(wave, views).sum(axis=1)
    assert np.median(covered) >= 5
    # of as many random sets few are visible from any one direction
    rng = np.random.default_rng(1)
    random = np.array([rng.choice(len(points), 3, replace=False) for _ in wave])
    assert np.median(sets_within_views(random, views).sum(axis=1)) < np.median(covered)


def test_all_sets_come_once() -> None:
    points, normals = ball(2, n=9)
    every = np.concatenate(list(covering_waves(points, normals, 3)))
    assert sorted(map(tuple, every.tolist())) == list(itertools.combinations(range(9), 3))


def test_missed_falls_with_sets_and_with_points() -> None:
    points, normals = ball(3)
    tried = TriedSets(partial(detected_views, normals=normals))
    assert tried.missed(8) == 1.0
    before = 1.0
    for wave in itertools.islice(covering_waves(points, normals, 3), 6):
        tried.add(wave)
        assert tried.missed(8) <= before
        before = tried.missed(8)
    assert before < 0.5
    assert tried.missed(12) < tried.missed(8) < tried.missed(5)


@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_a_plate_is_not_missed_from_behind(bend: float) -> None:
    """From there it shows less than the pose matches, and no set of points could have met it."""
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (30, 2)), np.zeros(30)])
    normals = np.column_stack([bend * points[:, :2], np.ones(30)])
    views = model_views(points, normals / np.linalg.norm(normals, axis=1, keepdims=True))
    tried = TriedSets(partial(detected_views, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True)))
    enough = next(k for k in range(len(views.edges) + 1) if views.missed(12, k) <= MISSED)
    assert views.edges[enough - 1][1] < 0.2 * len(views.ordered)
    tried.add(views.ordered[: views.edges[enough - 1][1]])
    assert tried.missed(12) < 0.05
    seen = detected_views(12, views.normals)
    assert (seen.sum(axis=1) == 12).all()
    assert (detected_views(40, views.normals).sum(axis=1) == 30).all()  # at most what is shown


def test_parts_are_near_one_another_in_every_second_view() -> None:
    """Of a row of lamps a part is a run of neighbours, cut out of any place; in the other views it is any of them."""
    row = np.column_stack([np.arange(40.0), np.zeros((40, 2))])
    views = views_of_parts(8, row)
    assert (views.sum(axis=1) == 8).all()
    extent = np.array([np.ptp(np.flatnonzero(view)) for view in views])
    assert (extent[::2] == 7).all()
    assert np.median(extent[1::2]) > 25
    assert len({int(np.flatnonzero(view)[0]) for view in views[::2]}) > 15


def test_directions_are_even() -> None:
    some = sphere(200)
    assert np.allclose(np.linalg.norm(some, axis=1), 1.0)
    assert np.abs(some.mean(axis=0)).max() < 0.01


def test_far_clutter_does_not_thin_out_a_cluster() -> None:
    rng = np.random.default_rng(4)
    cluster = rng.uniform(0.0, 0.05, (2, 12))
    alone = local_density(cluster, 1e-4)
    among = local_density(np.concatenate([cluster, [[0.9, -0.8, 0.7], [0.6, 0.9, -0.9]]], axis=1), 1e-4)
    assert np.median(among[:12]) > 0.4 * np.median(alone)
    assert among[12:].max() < 0.01 * np.median(alone)


@pytest.mark.parametrize(("matched", "lost"), [(4, LOST), (5, LOST), (6, LOST_OF_ALL)])
def test_missed_at_random_is_how_often_random_sets_all_fail(matched: int, lost: float) -> None:
    rng = np.random.default_rng(matched)
    every = np.array(list(itertools.combinations(range(6), 3)))
    tried = every[rng.integers(len(every), size=(20_000, 3))]
    failing = (tried >= matched).any(axis=2) | (rng.random((20_000, 3)) < lost)
    expected = failing.all(axis=1).mean()
    assert random_miss_probability(matched, 6, 3, 3) == pytest.approx(expected, abs=0.015)
    assert random_miss_probability(6, 6, 3, 2) <= MISSED < random_miss_probability(5, 6, 3, 2)


def test_unmet_is_the_mean_over_how_many_points_may_be_shown() -> None:
    each = [random_miss_probability(shown, 12, 3, 40) for shown in range(11)]
    assert unmet_probability(5, 10, 12, 3, 40) == pytest.approx(sum(each[5:]) / 11)
    assert unmet_probability(5, 10, 12, 3, 400) < unmet_probability(5, 10, 12, 3, 40) < each[5]


@pytest.mark.parametrize("clutter", [0, 5])
def test_objects_that_hide_themselves(clutter: int) -> None:
    trusted = scenes = 0
    for seed in range(12):
        points, normals, pixels, truth = view(seed, clutter)
        if (truth >= 0).sum() < 8:
            continue
        scenes += 1
        match = rm.match(points, pixels, rm.P3P(CAMERA), noise=NOISE, normals=normals)
        claimed = match.assignment >= 0
        if match.status is rm.Status.MATCHED:
            trusted += 1
            assert np.array_equal(match.assignment[claimed], truth[claimed]), seed
            assert claimed.sum() >= 0.9 * (truth >= 0).sum(), seed
    assert scenes >= 5
    assert trusted >= scenes - 1
