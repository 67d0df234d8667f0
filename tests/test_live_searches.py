"""What a tracker's frames search, and what they need not do twice."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.deadline import NEVER, Deadline
from rootmatch.explain import explain, predicted_pose
from rootmatch.samplers.guided.model_views import EVALUATIONS, ModelViews, model_views
from rootmatch.samplers.guided.triangle_shapes import NARROW
from rootmatch.tracking.followed_body import LONGEST
from rootmatch.tracking.tracker import TrackingOptions
from test_tracker import frame, tracker
from test_visibility import CAMERA, NOISE, ball, view


def scant(k: int, shown: int) -> tuple[np.ndarray, np.ndarray]:
    """A frame of some points of the body, the same for many frames, among clutter that could be the rest of it."""
    target, truth = frame(k)
    clutter = np.random.default_rng([k, 1]).uniform((0.0, 0.0), (640.0, 480.0), (12, 2))
    own = np.full(len(truth), -1)
    own[:shown] = np.arange(shown)
    return np.concatenate([target[truth[:shown]], clutter]), own


def test_searches_that_find_nothing_better_become_rare() -> None:
    one, every = tracker(tracking=TrackingOptions(search_every=2)), 2
    one.update(frame(0)[0])
    searched = []
    for k in range(1, 70):
        target, truth = scant(k, 5)
        match = one.update(target)
        assert match.status is rm.Status.MATCHED
        np.testing.assert_array_equal(match.assignment, truth)
        if match.evaluated > 0:
            searched.append(k)
    gaps = [second - first for first, second in pairwise(searched)]
    assert all(second >= first for first, second in pairwise(gaps[:3]))
    assert gaps[0] <= 2 * every + 1
    assert min(gaps[2:]) >= LONGEST * every


@pytest.mark.parametrize("of_rig", [False, True])
def test_a_frame_that_is_searched_looks_at_its_prediction_once(monkeypatch: pytest.MonkeyPatch, of_rig: bool) -> None:
    looked, searched = [0], [0]
    of_prediction, named = predicted_pose.propose_predicted, explain._propose

    def counted(model: Any) -> Any:
        looked[0] += 1
        return of_prediction(model)

    def search(task: Any) -> Any:
        searched[0] += 1
        return named(task)

    monkeypatch.setattr(predicted_pose, "propose_predicted", counted)
    monkeypatch.setattr(explain, "_propose", search)
    camera = rm.Camera(800.0, 780.0, 320.0, 240.0)
    problem = rm.P3P(rm.Rig([(camera, np.eye(3), np.zeros(3))])) if of_rig else rm.P3P(camera)
    one = rm.Tracker(tracker().matcher.source, problem, noise=0.2, tracking=TrackingOptions(search_every=2))
    for k in range(6):
        target, _ = frame(k) if k == 0 else scant(k, 5)
        one.update((target, np.zeros(len(target), int)) if of_rig else target)
        assert looked[0] == k
    assert searched[0] >= 1


def test_all_waves_together_are_the_waves_one_after_another() -> None:
    points, normals = ball(5)
    seen, facing, pixels, _ = view(5, 0)
    tables = rm.P3P(CAMERA).prepare(seen, pixels, NOISE, facing)
    views = model_views(points, normals)
    whole, every = views.every(tables, 10**9, NEVER, wide=True)
    assert every
    assert views.every(tables, 1, NEVER, wide=True)[0] is whole
    np.testing.assert_array_equal(whole.prepared.points, views.ordered)
    for number, (first, last) in enumerate(views.edges):
        wave = views.wave(number, tables)
        np.testing.assert_array_equal(whole.shapes[first:last], wave.shapes)
        np.testing.assert_array_equal(whole.prepared.coordinates[first:last], wave.prepared.coordinates)


def test_waves_are_prepared_as_frames_have_time() -> None:
    points, normals = ball(5)
    seen, facing, pixels, _ = view(5, 0)
    tables, views = rm.P3P(CAMERA).prepare(seen, pixels, NOISE, facing), ModelViews(points, normals)
    for count in range(1, 4):
        some, whole = views.every(tables, 1, NEVER, wide=False)
        assert not whole
        assert len(some.shapes) == views.edges[count - 1][1]
    late = Deadline(0.0)
    assert len(views.every(tables, 10**9, late, wide=False)[0].shapes) == views.edges[3][1]
    assert late.stopped_early
    ready = views.prepare(tables, 100 * EVALUATIONS, NEVER, wide=False)
    assert 100 <= views.edges[ready - 1][1] - views.edges[3][1] < 150
    # an image that is wide asks for more of each triple, and of all of them anew
    narrow, wide = views.wave(0, tables, wide=False).shapes.copy(), views.wave(0, tables, wide=True).shapes
    np.testing.assert_array_equal(narrow[:, :NARROW], wide[:, :NARROW])
    assert wide[:, NARROW:].sum() > narrow[:, NARROW:].sum()
    assert len(views.every(tables, 1, NEVER, wide=True)[0].shapes) == views.edges[0][1]
