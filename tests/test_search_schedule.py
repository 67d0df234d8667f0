"""Searches of a tracker that go on over frames, and become longer where they find nothing."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.cameras.brown import Brown
from rootmatch.explain.body_labels import Label
from rootmatch.explain.match_options import MatchOptions
from rootmatch.tracking.followed_body import FollowedBody
from rootmatch.tracking.search_schedule import LATELY, LONGEST_SEARCH, SearchLength, found_lately, luby
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
