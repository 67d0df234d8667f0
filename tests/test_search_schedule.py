"""Searches of a tracker that go on over frames, and become longer where they find nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.cameras.brown import Brown
from rootmatch.explain import image_bodies
from rootmatch.explain.body_labels import Label
from rootmatch.explain.match_options import MatchOptions
from rootmatch.tracking.followed_body import MISSING, FollowedBody
from rootmatch.tracking.search_schedule import LATELY, LONGEST_SEARCH, SearchLength, found_lately, luby, sought_first
from rootmatch.tracking.tracker import TRACKING

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)


def lamps(rng: np.random.Generator) -> np.ndarray:
    """Some sixty lamps of a ceiling, .8 m from each other and 10 cm off the grid."""
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(8)), axis=-1).reshape(-1, 2)
    every = np.column_stack([0.8 * grid + rng.normal(0.0, 0.1, grid.shape), rng.normal(2.5, 0.05, len(grid))])
    return every[rng.random(len(every)) < 0.85]


def test_the_sequence_of_luby() -> None:
    every = [1]
    while len(every) < 1000:
        every = [*every, *every, 2 * every[-1]]
    assert [luby(k + 1) for k in range(1000)] == every[:1000]


def test_searches_become_longer_until_something_is_found() -> None:
    length, factors = SearchLength(), []
    for _ in range(63):
        factors.append(length.factor)
        length.take(found=False, cut=True)
    assert factors[:7] == [1, 1, 2, 1, 1, 2, 4]
    assert max(factors) == LONGEST_SEARCH
    length.take(found=False, cut=False)  # nothing was left to search
    assert length.failures == 63
    length.take(found=True, cut=True)
    assert length.factor == 1


def test_a_tracker_searches_longer_for_what_is_in_no_frame() -> None:
    rng = np.random.default_rng(5)
    tracker = rm.Tracker(lamps(rng), rm.P3P(CAMERA), noise=0.4)
    tracker.update(np.empty((0, 2)))
    evaluated = [tracker.update(rng.uniform((0.0, 0.0), (1280.0, 960.0), (9, 2))).evaluated for _ in range(7)]
    assert evaluated[6] > 1.8 * evaluated[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_map_is_followed_from_the_second_frame_on(seed: int) -> None:
    """Where its speed is not known yet, a camera may have gone anywhere; most probably it has hardly moved."""
    rng = np.random.default_rng(seed)
    source = lamps(rng)
    tracker = rm.Tracker(source, rm.P3P(CAMERA), noise=0.4, tracking=rm.TrackingOptions(interval=1.0 / 30.0))
    followed = 0
    for k in range(12):
        pixels = CAMERA.project(source - (3.2 + 0.5 * k / 30.0, 2.8, 0.3))
        seen = np.flatnonzero(((pixels > 0.0) & (pixels < (1280.0, 960.0))).all(axis=1))
        target = np.concatenate([pixels[seen], rng.uniform((0.0, 0.0), (1280.0, 960.0), (4, 2))])
        match = tracker.update(target + rng.normal(0.0, 0.4, target.shape))
        points, detections = match.pairs.T
        followed += bool(match) and len(points) >= 0.8 * len(seen)
        assert not match or (np.append(seen, [-1] * 4)[detections] == points).all()
    assert followed >= 10


def test_a_search_that_was_cut_short_is_not_repeated_as_it_was() -> None:
    length, options = SearchLength(), MatchOptions(seed=3)
    assert length.reordered(options) is options
    for k in range(1, 4):
        length.take(found=False, cut=True)
        assert length.reordered(options).seed == 3 + k
    length.take(found=True, cut=True)
    assert length.reordered(options) is options


def test_a_search_that_max_seconds_ends_counts_as_cut_short() -> None:
    rng = np.random.default_rng(2)
    every = lamps(rng)
    tracker = rm.Tracker(every, rm.P3P(CAMERA), noise=0.3)
    for k in range(3):
        tracker.update(rng.uniform(0.0, 900.0, (20, 2)), time=0.1 * k, max_seconds=1e-4)
    assert tracker._length.failures == 3


def test_the_rays_of_a_frame_are_worked_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = rm.Camera.from_opencv([[900.0, 0.0, 640.0], [0.0, 900.0, 480.0], [0.0, 0.0, 1.0]], [-0.1, 0.01, 0.0, 0.0])
    calls, rays = [], Brown.rays
    monkeypatch.setattr(Brown, "rays", lambda lens, image: calls.append(1) or rays(lens, image))
    pixels = np.random.default_rng(5).uniform(0.0, 900.0, (6, 2))
    first = camera.bearings(pixels)
    first[:] = 0.0  # it is the caller's
    np.testing.assert_allclose(np.linalg.norm(camera.bearings(pixels), axis=1), 1.0)
    assert len(calls) == 1


def followed(missed: int, *, served: int = 0, searched: int = 0, failures: int = 0) -> FollowedBody:
    """A body that was missed in so many frames."""
    body = FollowedBody(np.random.default_rng(0).normal(size=(6, 3)), TRACKING)
    body.missed, body.served, body.searched, body.failures = missed, served, searched, failures
    return body


def test_more_noise_is_asked_for_only_of_what_was_found_lately() -> None:
    bodies: dict[Label | None, FollowedBody] = {0: followed(0), 1: followed(LATELY - 1), 2: followed(LATELY, served=7)}
    assert found_lately(bodies, bodies, 8, doubted=False) == [0, 1]
    assert found_lately(bodies, bodies, 8, doubted=True) == [0, 1, 2]
    assert found_lately(bodies, [1], 8, doubted=True) == [1]
    assert not found_lately(bodies, bodies, 7, doubted=True)  # which is searched


def test_a_frame_seeks_the_missed_body_whose_turn_it_is() -> None:
    bodies: dict[Label | None, FollowedBody] = {0: followed(0), 1: followed(3, served=5), 2: followed(3, served=4)}
    for body in bodies.values():
        body.waiting = [None]
    assert sought_first(bodies, 9) is bodies[2]
    bodies[2].waiting = []
    assert sought_first(bodies, 9) is bodies[1]
    bodies[1].waiting = []
    assert sought_first(bodies, 9) is None
    late = followed(9, searched=20, failures=9)
    due = [frame for frame in range(20, 30) if late.is_sought(frame)]
    assert due == [20 + MISSING]  # unless it is searched for then, its prediction is looked about as well


def test_a_frame_that_searches_for_a_missed_body_looks_about_its_prediction_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng, calls, thorough, sought = np.random.default_rng(5), list[bool](), list[bool](), list[bool]()
    points = rng.uniform(-0.2, 0.2, (2, 8, 3))
    tracker = rm.Tracker(points.reshape(-1, 3), rm.P3P(CAMERA), noise=0.3, bodies=np.repeat([0, 1], 8))
    work = image_bodies.proposals_by_prediction

    def looked(model: Any, *, thorough: bool = True) -> Any:
        calls.append(thorough)
        return work(model, thorough)

    monkeypatch.setattr(image_bodies, "proposals_by_prediction", looked)
    for k in range(25):
        R = Rotation.from_rotvec([0.1, 0.01 * k, 0.2]).as_matrix()
        pixels = [CAMERA.project(one @ R.T + [x, 0.0, 1.5]) for one, x in zip(points, (0.0, 0.7), strict=True)]
        if k > 5:
            pixels[1] = rng.uniform((0.0, 0.0), (1280.0, 960.0), (9, 2))
        calls.clear()
        tracker.update(np.vstack(pixels) + rng.normal(0.0, 0.3, (len(np.vstack(pixels)), 2)), time=k / 60.0)
        if k > 7 and len(calls) == 2:
            assert calls[0]
            (sought if tracker._bodies[1].served == tracker._frame else thorough).append(calls[1])
    assert sought
    assert np.mean(sought) < 0.3
    assert all(thorough)
