"""Searches of a tracker that go on over frames, so that few take much longer than the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hall_scenes
import rootmatch as rm
from rootmatch.arrays import Integers
from rootmatch.cameras.brown import Brown
from rootmatch.explain import explain, image_bodies, image_hypotheses
from rootmatch.explain.body_labels import Label
from rootmatch.explain.image_hypotheses import NAMED, Candidate
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.proposals import Proposals
from rootmatch.samplers.base import SampledTensor
from rootmatch.tracking.followed_body import FollowedBody
from rootmatch.tracking.followed_pose import NarrowedPredictions
from rootmatch.tracking.search_schedule import (
    AMONG_ALL,
    LATELY,
    bodies_found_lately,
    bodies_tried,
    reorder_draws,
    unmet_chance,
)
from rootmatch.tracking.tracker import TRACKING

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)


def lamps(rng: np.random.Generator) -> np.ndarray:
    """Some sixty lamps of a ceiling, .8 m from each other and 10 cm off the grid."""
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(8)), axis=-1).reshape(-1, 2)
    every = np.column_stack([0.8 * grid + rng.normal(0.0, 0.1, grid.shape), rng.normal(2.5, 0.05, len(grid))])
    return every[rng.random(len(every)) < 0.85]


def test_no_frame_searches_much_longer_than_another_for_what_is_in_none() -> None:
    rng = np.random.default_rng(5)
    tracker = rm.Tracker(lamps(rng), rm.P3P(CAMERA), noise=0.4)
    tracker.update(np.empty((0, 2)))
    evaluated = [tracker.update(rng.uniform((0.0, 0.0), (1280.0, 960.0), (9, 2))).evaluated for _ in range(8)]
    assert max(evaluated) < 1.5 * TRACKING.search_budget


def seen(points: np.ndarray, k: int, rng: np.random.Generator, x: float = 0.0) -> np.ndarray:
    """Detections of all points of a body that turns slowly 1 m before the camera."""
    R = Rotation.from_rotvec([0.3, 0.01 * k, 0.1]).as_matrix()
    return CAMERA.project(points @ R.T + [x, 0.0, 1.0]) + rng.normal(0.0, 0.3, (len(points), 2))


def test_copies_are_looked_for_within_the_budget_of_a_frame() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.08, 0.08, (12, 3))
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3)
    evaluated = []
    for k in range(30):
        match = tracker.update(np.vstack([seen(points, k, rng, -0.2), seen(points, k, rng, 0.2)]))
        evaluated.append(match.evaluated)
        assert match.status is not rm.Status.MATCHED
    searches = [one for one in evaluated[1:] if one]
    assert searches
    assert max(searches) < 2.5 * TRACKING.search_budget


def test_a_frame_is_searched_once_and_the_next_one_with_more_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, searches, weighed = np.random.default_rng(2), list[int](), list[int]()
    points = rng.uniform(-0.08, 0.08, (10, 3))
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3)
    tracker.update(np.empty((0, 2)))
    work, propose = explain.sample, Candidate.proposals

    def counted(task: MatchingTask) -> SampledTensor:
        searches[-1] += 1
        return work(task)

    def proposed(body: Candidate, assignments: Sequence[Integers]) -> Proposals:
        weighed.append(len(assignments))
        return propose(body, assignments)

    monkeypatch.setattr(explain, "sample", counted)
    monkeypatch.setattr(Candidate, "proposals", proposed)
    louder = 0
    for k in range(30):
        searches.append(0)
        tracker.update(np.vstack([seen(points * (1.0, 1.0, -1.0), k, rng), rng.uniform(0.0, 900.0, (2, 2))]))
        louder += bool(tracker._noise.waiting)
    assert louder
    assert max(searches) == 1
    assert max(weighed) <= NAMED


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
    options = MatchOptions(seed=3)
    assert reorder_draws(options, 0) is options
    assert [reorder_draws(options, k).seed for k in range(1, 4)] == [4, 5, 6]


def test_a_search_that_max_seconds_ends_counts_as_cut_short() -> None:
    rng = np.random.default_rng(2)
    every = lamps(rng)
    tracker = rm.Tracker(every, rm.P3P(CAMERA), noise=0.3)
    for k in range(3):
        tracker.update(rng.uniform(0.0, 900.0, (20, 2)), time=0.1 * k, max_seconds=1e-4)
    assert tracker._cut == 3


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
    assert bodies_found_lately(bodies, bodies, 8, doubted=False) == [0, 1]
    assert bodies_found_lately(bodies, bodies, 8, doubted=True) == [0, 1, 2]
    assert bodies_found_lately(bodies, [1], 8, doubted=True) == [1]
    assert not bodies_found_lately(bodies, bodies, 7, doubted=True)  # which is searched


def test_a_missing_body_is_tried_on_what_the_other_of_its_shape_has_once_and_now_and_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng, among = np.random.default_rng(9), list[tuple[int, int]]()
    points, strays = rng.uniform(-0.2, 0.2, (8, 3)), 6
    both = np.vstack([points, points * (-1.0, 1.0, 1.0)])
    tracker = rm.Tracker(both, rm.P3P(CAMERA), noise=0.3, bodies=np.repeat([0, 1], 8))
    search = image_bodies._Body.search

    def counted(body: image_bodies._Body, task: MatchingTask, solve: image_bodies.Solve, budget: int) -> None:
        if body.number == 1:
            among.append((k, int(body.free.sum())))
        search(body, task, solve, budget)

    monkeypatch.setattr(image_bodies._Body, "search", counted)
    back = 2 * AMONG_ALL
    for k in range(back + 12):
        shown = [seen(points, k, rng, -0.35), rng.uniform((0.0, 0.0), (1280.0, 960.0), (strays, 2))]
        if k >= back:
            shown.append(seen(both[8:], k, rng, 0.35))
        match = tracker.update(np.vstack(shown))
        assert match.bodies is not None
        assert match.bodies[0].status is rm.Status.MATCHED
        assert k < back + 6 or match.bodies[1].status is rm.Status.MATCHED
    later = [count for k, count in among if 4 < k < back]
    every = [k for k, count in among if 4 < k < back and count == 8 + strays]
    assert len(later) > 20
    assert set(later) == {strays, 8 + strays}
    assert 1 <= len(every) <= 2


def test_bodies_are_left_out_where_a_search_has_tried_them() -> None:
    first, second = followed(0), followed(20)
    first.settled, first.since = True, 30
    second.tried, second.begun = 29, 35
    assert bodies_tried([first, second], second) == ()  # the first one was found since
    second.tried = 30
    assert bodies_tried([first, second], second) == (0,)
    first.settled = False
    assert bodies_tried([first, second], second) == ()
    first.settled, second.begun = True, 30 + AMONG_ALL
    assert bodies_tried([first, second], second) == ()  # it was long ago


def test_a_wide_prediction_is_narrowed_in_turn_with_searches() -> None:
    narrowed = NarrowedPredictions()
    assert [narrowed.of_frame(k, 2, searching=False) for k in range(5, 8)] == [(1,), (0,), (1,)]
    assert [narrowed.of_frame(k, 2, searching=True) for k in range(8, 12)] == [(), (0,), (), (1,)]


def test_of_several_predictions_no_more_is_weighed_than_of_one_but_two_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, weighed = np.random.default_rng(3), list[list[int]]()
    points = rng.uniform(-0.08, 0.08, (10, 3))
    tracker, join = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3), image_hypotheses.join_proposals
    tracker.update(seen(points, 0, rng))
    (body,) = tracker._bodies.values()
    filter_ = body.belief.best
    body.belief.poses += [
        copy_with(body.belief.poses[0], filter=filter_.turned(np.eye(3), np.array([x, 0.0, 0.0]))) for x in (0.01, 0.02)
    ]

    def joined(parts: Sequence[Proposals]) -> Proposals:
        weighed.append([len(one.assignments) for one in parts])
        return join(parts)

    monkeypatch.setattr(image_hypotheses, "join_proposals", joined)
    crowd = CAMERA.project(rng.uniform((-0.1, -0.1, 0.9), (0.1, 0.1, 1.1), (40, 3)))
    tracker.update(crowd, time=0.4)
    first = next(one for one in weighed if len(one) >= 3)
    assert max(first[:3]) <= image_hypotheses.MAX_PREDICTED // 3


def in_hall(rng: np.random.Generator, built: np.ndarray, k: int, shown: float) -> tuple[list[np.ndarray], np.ndarray]:
    """Detections of a cluster that drifts through the hall, and which of them (6, n) each marker has."""
    R, t = Rotation.from_rotvec([0.02 * k, 0.4, 0.01 * k]).as_matrix(), np.array([0.01 * k, 0.2, 0.0])
    return hall_scenes.images(rng, built, shown, (R, t))


def test_one_body_before_six_cameras_is_searched_for_in_one_of_them_a_frame() -> None:
    rng = np.random.default_rng(3)
    built = hall_scenes.cluster(rng, 5)
    tracker = rm.Tracker(built, rm.P3P(hall_scenes.RIG), noise=hall_scenes.SIGMA)
    body, back = tracker._bodies[None], []
    for k in range(60):
        target, truth = in_hall(rng, built, k, 0.85 if k < 5 or k >= 40 else 0.0)
        match = tracker.update(target)
        assert k == 0 or match.evaluated < 1.5 * TRACKING.search_budget
        assert body.served != k + 1 or len(body.looked) <= 6
        if k >= 40 and match:
            assert match.sightings is not None
            assert not ((match.sightings.assignment >= 0) & (match.sightings.assignment != truth)).any()
            back.append(k)
    assert back[0] <= 46
    assert len(back) >= 14


@pytest.mark.parametrize("looked", [[0], [0, 1], [5]])
def test_what_images_show_too_little_of_is_as_probable_as_in_draws(looked: list[int | None]) -> None:
    rng = np.random.default_rng(4)
    built = hall_scenes.cluster(rng, 5)
    target, _ = in_hall(rng, built, 0, 0.7)
    tracker = rm.Tracker(built, rm.P3P(hall_scenes.RIG), noise=hall_scenes.SIGMA)
    found = tracker.matcher.explained(target)
    assert found.posterior is not None
    visible = found.posterior.modes.visible[found.mode].reshape(6, 5).sum(axis=1).round().astype(int)
    sightings = np.repeat(np.arange(6), visible)
    matched = int((found.assignment >= 0).sum())
    draws = np.array([np.bincount(rng.permutation(sightings)[:matched], minlength=6) for _ in range(4000)])
    each = (draws[:, looked] <= 3).mean(axis=0)
    assert 0.02 < each.prod() < 0.98
    np.testing.assert_allclose(unmet_chance(found, looked), each.prod(), atol=0.03)


def test_a_body_that_is_followed_is_searched_for_with_half_the_budget() -> None:
    rng = np.random.default_rng(6)
    points = rng.uniform(-0.08, 0.08, (8, 3))
    tracker, searches = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3), list[tuple[bool, int]]()
    for k in range(30):
        clutter = rng.uniform((0.0, 0.0), (1280.0, 960.0), (40, 2))
        followed_before = tracker.state is rm.TrackingState.TRACKING
        match = tracker.update(np.vstack([seen(points, k, rng)[: 8 if k < 20 else 0], clutter]))
        if k and match.evaluated:
            searches.append((followed_before and bool(match), match.evaluated))
    half, whole = (max(count for held, count in searches if held is one) for one in (True, False))
    assert half < 0.7 * TRACKING.search_budget < whole
