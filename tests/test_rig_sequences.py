"""Rigs with a predicted pose, followed from frame to frame, and with several bodies."""

from __future__ import annotations

import csv
import itertools
import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import oracles
import rootmatch as rm
from rig_scenes import LABELS, NOISE, VIEW, RigScene, controllers, four_about, frame, headset
from rootmatch.arrays import Integers
from rootmatch.cli import app
from rootmatch.errors import InputError
from rootmatch.explain import image_bodies
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.io import Calibration, PointSet, read_camera, write_camera, write_points, write_table
from rootmatch.model.clutter import clutter_areas
from rootmatch.report.json_record import match_record
from rootmatch.tracking.followed_body import MISSING

SPREAD = np.repeat([0.03, 0.01], 3)
RIG = headset()
POINTS, NORMALS, NAMES = controllers()
LEDS = len(POINTS) // 2
KNOWN: dict[str, Any] = {"noise": NOISE, "normals": NORMALS[:LEDS], "view_angle": np.radians(VIEW)}


def predicted(scene: RigScene, seed: int, spread: NDArray = SPREAD, body: int = 0) -> rm.Pose:
    """The pose of a body with errors of a spread."""
    error = spread * np.random.default_rng([seed, 5]).standard_normal(6)
    R, t = scene.poses[body]
    return rm.Pose(Rotation.from_rotvec(error[:3]).as_matrix() @ R, t + error[3:], np.diag(spread**2))


def kept(scene: RigScene, sightings: list[tuple[int, int]]) -> RigScene:
    """The scene with no other sightings than some of (camera, point); the clutter stays."""
    gone = np.setdiff1d(scene.truth[scene.truth >= 0], [scene.truth[one] for one in sightings])
    rows = np.setdiff1d(np.arange(len(scene.rows)), gone)
    place = np.full(len(scene.rows) + 1, -1)
    place[rows] = np.arange(len(rows))
    return scene._replace(rows=scene.rows[rows], truth=place[scene.truth])


def off(pose: rm.Pose, truth: tuple[NDArray, NDArray]) -> float:
    """Squared error of a pose over its covariance."""
    error = np.concatenate([Rotation.from_matrix(truth[0] @ pose.R.T).as_rotvec(), truth[1] - pose.t])
    return float(error @ np.linalg.solve(pose.covariance, error))


@pytest.mark.parametrize("seed", range(4))
def test_a_right_prediction_decides_with_all_cameras(seed: int) -> None:
    scene = frame(seed, 0, RIG)
    found = rm.match(scene.points, scene.rows, rm.P3P(RIG), prior=predicted(scene, seed), **KNOWN)
    assert found.status is rm.Status.MATCHED
    assert found.prior_holds
    assert found.evaluated == 0
    np.testing.assert_array_equal(found.sightings.assignment, scene.truth)
    # the first sighting of each point stands for it
    seen = (scene.truth >= 0).any(axis=0)
    np.testing.assert_array_equal(found.assignment >= 0, seen)
    assert (found.soft_assignment[seen].max(axis=1) > 0.9).all()
    cameras = scene.rows[found.sightings.assignment, 2]
    assert (cameras == np.arange(4)[:, None])[found.sightings.assignment >= 0].all()
    assert off(found.fused_pose, scene.poses[0]) < 30.0
    whole = found.poses[0]  # fitted by other code, to the bottom
    np.testing.assert_allclose(whole.t, found.fused_pose.t, atol=1e-4)
    np.testing.assert_allclose(np.diag(whole.covariance), np.diag(found.fused_pose.covariance), rtol=0.05)
    assert whole.dof == 2 * (scene.truth >= 0).sum()
    assert found.confidence.shape == (LEDS,)
    assert found.confidence[seen].min() > 0.9
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.sightings.assignment, scene.truth)
    json.dumps(match_record(found), allow_nan=False)
    with pytest.raises(InputError, match="several images"):
        found.report("page.html")


def test_the_fit_is_that_of_least_squares() -> None:
    """Detections of all cameras and the prediction, each over its σ, minimised by SciPy."""
    scene = frame(1, 0, RIG)
    prior = predicted(scene, 1)
    found = rm.match(scene.points, scene.rows, rm.P3P(RIG), prior=prior, **KNOWN)
    pairs = [tuple(one) for one in np.argwhere(found.sightings.assignment >= 0)]

    def residuals(step: NDArray) -> NDArray:
        R, t = Rotation.from_rotvec(step[:3]).as_matrix() @ prior.R, prior.t + oracles.moved_along_arc(step)
        parts = [step / SPREAD]
        for k, i in pairs:
            camera, rotation, place = RIG.views[k]
            pixel = camera.project(np.array(rotation) @ (R @ scene.points[i] + t) + place)
            parts.append((pixel - scene.rows[found.sightings.assignment[k, i], :2]) / NOISE)
        return np.concatenate(parts)

    slow = least_squares(residuals, np.zeros(6), xtol=1e-12, ftol=1e-12)
    pose = found.poses[0]
    # the fit's derivatives of the prior are of first order in how far it turns: it ends a thousandth of a σ aside
    np.testing.assert_allclose(pose.R, Rotation.from_rotvec(slow.x[:3]).as_matrix() @ prior.R, atol=2e-6)
    np.testing.assert_allclose(pose.t, prior.t + oracles.moved_along_arc(slow.x), atol=2e-6)
    assert pose.chi2 == pytest.approx(2.0 * slow.cost, rel=1e-4)
    turned, moved = Rotation.from_rotvec(slow.x[:3]), oracles.moved_along_arc(slow.x)
    from_fit = np.empty((6, 6))  # the errors of a pose are counted from the fit, not from what was predicted
    for a, step in enumerate(1e-6 * np.eye(6)):
        after = slow.x + step
        from_fit[:3, a] = (Rotation.from_rotvec(after[:3]) * turned.inv()).as_rotvec() / 1e-6
        from_fit[3:, a] = (oracles.moved_along_arc(after) - moved) / 1e-6
    covariance = from_fit @ np.linalg.inv(slow.jac.T @ slow.jac) @ from_fit.T
    np.testing.assert_allclose(np.diag(pose.covariance), np.diag(covariance), rtol=0.02)


def test_a_rig_of_one_camera_is_that_camera() -> None:
    """What is decided there for one camera, the same code decides for the copies of a rig."""
    rng = np.random.default_rng(3)
    camera = rm.Camera(800.0, 780.0, 320.0, 240.0)
    points, t = rng.uniform(-0.5, 0.5, (9, 3)), np.array([0.1, -0.2, 3.0])
    R = Rotation.random(random_state=np.random.RandomState(3)).as_matrix()
    pixels = np.concatenate([camera.project(points @ R.T + t), rng.uniform(0, 480, (4, 2))]) + rng.normal(
        0, 0.3, (13, 2)
    )
    prior = rm.Pose(Rotation.from_rotvec([0.02, 0.0, -0.01]).as_matrix() @ R, t + 0.02, np.diag([0.02**2] * 6))
    one = rm.match(points, pixels, rm.P3P(camera), noise=0.3, prior=prior)
    rig = rm.Rig([(camera, np.eye(3), np.zeros(3))])
    other = rm.match(points, (pixels, np.zeros(13)), rm.P3P(rig), noise=0.3, prior=prior)
    np.testing.assert_array_equal(other.assignment, one.assignment)
    assert other.status is one.status
    assert other.score == pytest.approx(one.score, abs=1e-9)
    assert other.probability == pytest.approx(one.probability, abs=1e-9)
    np.testing.assert_allclose(other.poses[0].R, one.poses[0].R, atol=1e-7)


def test_three_points_in_three_cameras_are_enough() -> None:
    scene = frame(2, 0, RIG, clutter=0)
    chosen: list[tuple[int, int]] = []
    for k in range(3):
        chosen.append((k, next(i for i in np.flatnonzero(scene.truth[k] >= 0) if i not in [j for _, j in chosen])))
    scene = kept(scene, chosen)
    assert len(scene.rows) == 3
    prior = predicted(scene, 2, SPREAD / 5.0)
    found = rm.match(scene.points, scene.rows, rm.P3P(RIG), prior=prior, detection_rate=0.3, **KNOWN)
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.sightings.assignment, scene.truth)
    assert off(found.poses[0], scene.poses[0]) < 30.0
    alone = kept(scene, chosen[:2])
    found = rm.match(scene.points, alone.rows, rm.P3P(RIG), prior=prior, **KNOWN)
    assert found.status is rm.Status.UNTRUSTED
    assert "do not confirm" in found.advice


def test_a_wrong_prediction_is_noticed() -> None:
    scene = frame(0, 0, RIG)
    wrong = rm.Pose(
        Rotation.from_rotvec([0.6, 0.0, 0.8]).as_matrix() @ scene.poses[0][0], scene.poses[0][1], np.diag(SPREAD**2)
    )
    found = rm.match(scene.points, scene.rows, rm.P3P(RIG), prior=wrong, **KNOWN)
    assert found.status is rm.Status.MATCHED
    assert found.prior_holds is False
    assert "this pose contradicts the prior" in found.advice
    assert found.evaluated > 0
    np.testing.assert_array_equal(found.sightings.assignment, scene.truth)
    assert found.fused_pose is None
    assert off(found.poses[0], scene.poses[0]) < 30.0
    other = np.random.default_rng(1).uniform(-0.05, 0.05, (LEDS, 3))
    assert not rm.match(other, scene.rows, rm.P3P(RIG), prior=wrong, **KNOWN).status


def test_what_a_predicted_pose_projects() -> None:
    """Pixels, their derivatives and what is visible, each copy by itself."""
    scene = frame(3, 0, RIG)
    prior = predicted(scene, 3)
    task = MatchingTask.of(rm.P3P(RIG), scene.points, scene.rows, prior=prior, **KNOWN)
    model = make_detection_model(task)
    whole = model.linearise_about(*(one[None] for one in model.centred(prior.R, prior.t)))
    pixels, jacobian, shown_by = whole.pixels[0], whole.jacobian[0], model.visibility(whole, np.zeros(1))[0]
    arm = prior.R @ model.centre
    offsets = RIG.offsets(scene.rows)
    step = 1e-6 * np.eye(6)
    for copy in range(0, 4 * LEDS, 7):
        k, i = divmod(copy, LEDS)
        camera, rotation, place = RIG.views[k]

        def pixel(R: NDArray, t: NDArray, camera=camera, rotation=rotation, place=place, i=i, k=k) -> NDArray:
            return camera.project(np.array(rotation) @ (R @ scene.points[i] + t) + place) + offsets[k]

        position = np.array(rotation) @ (prior.R @ scene.points[i] + prior.t) + place
        cosine = -position @ (np.array(rotation) @ prior.R @ NORMALS[i]) / np.linalg.norm(position)
        shown = camera.sees(position) and cosine > np.cos(np.radians(VIEW)) + 0.3
        own = pixel(prior.R, prior.t) - offsets[k]
        if shown and (own > 40).all() and (own < (600, 440)).all():
            assert shown_by[copy] > 0.99
        if not camera.sees(position) or (own < -40).any() or (own > (680, 520)).any():
            assert shown_by[copy] < 1e-6
            continue
        np.testing.assert_allclose(pixels[copy], pixel(prior.R, prior.t), atol=1e-9)
        turns = [Rotation.from_rotvec(s[:3]).as_matrix() for s in step]  # about the centre of the points
        moved = [pixel(T @ prior.R, prior.t + s[3:] + arm - T @ arm) for T, s in zip(turns, step, strict=True)]
        np.testing.assert_allclose(jacobian[copy].T, (np.array(moved) - pixels[copy]) / 1e-6, rtol=1e-3, atol=0.05)


def test_the_density_of_detections_is_that_of_their_image() -> None:
    rng = np.random.default_rng(0)
    target, sigma = rng.uniform(0.0, 300.0, (12, 2)), np.full(12, 0.5)
    images = [np.arange(5), np.arange(5, 9), np.array([9, 10]), np.array([11]), np.empty(0, np.int64)]
    areas = [float(clutter_areas(target[own], sigma[own])[0]) for own in images[:2]]
    # those with two or fewer are as large as the others in the mean
    np.testing.assert_allclose(clutter_areas(target, sigma, images), [*areas, *[np.mean(areas)] * 3])
    lone = [np.array([k]) for k in range(12)]
    np.testing.assert_array_equal(clutter_areas(target, sigma, lone, focal=300.0), 300.0**2)


def test_a_flight_with_an_occlusion() -> None:
    tracker = rm.Tracker(POINTS[:LEDS], rm.P3P(RIG), **KNOWN)
    right = searched = 0
    for k in range(60):
        covered = (0, 1, 2, 3) if 30 <= k < 38 else (0, 1) if k >= 52 else ()
        scene = frame(11, k, RIG, covered=covered)
        found = tracker.update((scene.rows[:, :2], scene.rows[:, 2].astype(int)))
        sightings = found.sightings.assignment
        matched = sightings >= 0
        assert not found.status or (sightings == scene.truth)[matched].all()
        right += bool(found.status) and matched.sum() >= 0.9 * (scene.truth >= 0).sum()
        searched += found.evaluated > 0
        if len(covered) == 4:
            assert not found.status
            assert tracker.state is rm.TrackingState.COASTING
    assert right >= 49  # where two cameras are covered, a match beside what is hidden may be left out
    assert searched <= 3
    assert off(found.fused_pose, scene.poses[0]) < 30.0
    tracker.reset()
    assert tracker.state is rm.TrackingState.LOST


def test_frames_that_show_nothing() -> None:
    tracker = rm.Tracker(POINTS[:LEDS], rm.P3P(RIG), **KNOWN)
    scene = frame(0, 0, RIG)
    assert tracker.update(scene.rows).status is rm.Status.MATCHED
    for rows in (np.empty((0, 3)), np.repeat(scene.rows[:1], 2, axis=0), scene.rows[:1]):
        found = tracker.update(rows)
        assert found.status is rm.Status.UNTRUSTED
        assert (found.sightings.assignment == -1).all()
        assert found.sightings.assignment.shape == (4, LEDS)
    with pytest.raises(InputError, match="camera 9"):
        tracker.update((scene.rows[:, :2], np.full(len(scene.rows), 9)))
    later = frame(0, 4, RIG)
    assert tracker.update(later.rows).prior_holds


def test_a_callers_prediction_counts_instead() -> None:
    """Of few sightings, in no camera four: a pose of its own they do not have."""
    scene = frame(2, 0, RIG, clutter=0)
    seen = [np.flatnonzero(scene.truth[k] >= 0) for k in range(3)]
    scene = kept(scene, [(k, own[j]) for k, own in enumerate(seen) for j in (0, len(own) // 2, -1)])
    tracker = rm.Tracker(POINTS[:LEDS], rm.P3P(RIG), detection_rate=0.4, **KNOWN)
    found = tracker.update(scene.rows, prior=predicted(scene, 4, SPREAD / 3.0))
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.sightings.assignment, scene.truth)
    assert tracker.state is rm.TrackingState.TRACKING
    assert tracker.update(scene.rows).prior_holds


def test_one_led_in_three_cameras_is_one_match() -> None:
    """Three sightings of it fix no rotation, however well their rays meet."""
    scene = frame(0, 0, RIG, clutter=0)
    counts = (scene.truth >= 0).sum(axis=0)
    led = int(np.argmax(counts))
    assert counts[led] >= 3
    scene = kept(scene, [(k, led) for k in np.flatnonzero(scene.truth[:, led] >= 0)])
    found = rm.match(POINTS[:LEDS], scene.rows, rm.P3P(RIG), prior=predicted(scene, 4, SPREAD / 3.0), **KNOWN)
    assert found.status is not rm.Status.MATCHED
    assert (found.sightings.assignment >= 0).sum() <= 3


def test_a_body_that_no_frame_is_sure_of_for_half_a_second_counts_as_lost() -> None:
    """One LED keeps its prediction alive, but the prediction is no longer worth the trust of a match."""
    tracker = rm.Tracker(POINTS[:LEDS], rm.P3P(RIG), **KNOWN)
    states = []
    for k in range(46):
        scene = frame(0, k, RIG, clutter=0)
        if k >= 5:
            led = int(np.argmax((scene.truth >= 0).sum(axis=0)))
            scene = kept(scene, [(c, led) for c in np.flatnonzero(scene.truth[:, led] >= 0)])
        assert (tracker.update(scene.rows, time=k / 60.0).status is rm.Status.MATCHED) == (k < 5)
        states.append(tracker.state)
    assert states[4] is rm.TrackingState.TRACKING
    assert states[20] is not rm.TrackingState.LOST
    assert states[40] is rm.TrackingState.LOST


def test_a_lost_body_is_searched_for_soon_then_ever_more_rarely_a_camera_a_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of two bodies one is followed; the other is not there."""
    scene = frame(2, 0, RIG, hands=1, clutter=6)
    tracker = rm.Tracker(POINTS, rm.P3P(RIG), bodies=NAMES, **KNOWN | {"normals": NORMALS})
    parts = []
    search = image_bodies._Body.search

    def counted(body: Any, task: MatchingTask, *given: Any) -> None:
        if task.search_camera is not None:  # in the first frame all of it is searched
            parts.append((tracker._frame, body.number, task.search_camera))
        search(body, task, *given)

    monkeypatch.setattr(image_bodies._Body, "search", counted)
    for k in range(60):
        found = tracker.update(scene.rows)
        assert found.bodies["left"].status is rm.Status.MATCHED
        assert found.bodies["right"].status is not rm.Status.MATCHED, k
    frames = [number for number, body, _ in parts if body == 1]
    rounds = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    cameras = [camera for number, body, camera in parts if body == 1 and number in rounds[-1]]
    assert frames[0] == 2
    assert len(set(frames)) == len(frames)
    assert len(set(cameras)) == len(cameras) == len(rounds[-1])
    pauses = [int(after[0] - before[-1]) for before, after in itertools.pairwise(rounds)]
    assert pauses == sorted(pauses)
    assert pauses[-1] == MISSING


def test_a_search_that_a_tracker_asks_for_meets_all_but_other_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a wrong pose that shares detections with the right one keeps them for good."""
    scene = frame(3, 0, RIG, hands=2)
    free = []
    monkeypatch.setattr(image_bodies._Body, "search", lambda body, *_: free.append(body.free))
    matcher = rm.Matcher(POINTS, rm.P3P(RIG), bodies=NAMES, **KNOWN | {"normals": NORMALS})
    prior = {label: predicted(scene, 3, SPREAD / 5.0, body) for body, label in enumerate(LABELS)}
    found = matcher.explained(scene.rows, prior=prior, searching=lambda _: image_bodies.SearchPart(0, 1))
    np.testing.assert_array_equal(found.assignment.reshape(scene.truth.shape), scene.truth)
    of_right = scene.truth[:, LEDS:][scene.truth[:, LEDS:] >= 0]
    np.testing.assert_array_equal(np.flatnonzero(~free[0]), np.sort(of_right))


def test_a_body_found_elsewhere_is_weighed_against_those_that_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """No body takes detections before all others that may have them were tried on them."""
    scene = frame(2, 0, RIG, hands=2)
    calls: list[tuple[int, Integers]] = []
    search = image_bodies._Body.search

    def noted(body: image_bodies._Body, *rest: Any) -> None:
        calls.append((body.number, np.flatnonzero(body.free)))
        search(body, *rest)

    monkeypatch.setattr(image_bodies._Body, "search", noted)
    matcher = rm.Matcher(POINTS, rm.P3P(RIG), bodies=NAMES, **KNOWN | {"normals": NORMALS})
    found = matcher.explained(scene.rows, searching=lambda _: image_bodies.SearchPart(0, 1))
    assert found.parts is not None
    own = found.parts["left"].assignment
    assert [number for number, _ in calls] == [0, 1]
    np.testing.assert_array_equal(calls[1][1], np.sort(own[own >= 0]))
    calls.clear()
    prior = {"right": predicted(scene, 3, SPREAD / 5.0, 1)}  # what is predicted competes by itself
    matcher.explained(scene.rows, prior=prior, searching=lambda _: image_bodies.SearchPart(0, 1))
    assert [number for number, _ in calls] == [0]


def test_two_bodies_share_no_detection() -> None:
    scene = frame(2, 0, RIG, hands=2)
    known = KNOWN | {"normals": NORMALS}
    found = rm.match(POINTS, scene.rows, rm.P3P(RIG), bodies=NAMES, **known)
    assert found.status is rm.Status.MATCHED
    used = found.sightings.assignment[found.sightings.assignment >= 0]
    assert len(np.unique(used)) == len(used)
    assert list(found.bodies) == list(LABELS)
    assert found.probability == pytest.approx(np.prod([body.probability for body in found.bodies.values()]))
    np.testing.assert_array_equal(found.motion_labels[found.assignment >= 0], (NAMES == "right")[found.assignment >= 0])
    for k, (label, body) in enumerate(found.bodies.items()):
        np.testing.assert_array_equal(body.sightings.assignment, scene.truth[:, label == NAMES])
        np.testing.assert_array_equal(body.sightings.assignment, found.sightings.assignment[:, label == NAMES])
        assert off(body.poses[0], scene.poses[k]) < 30.0
        np.testing.assert_allclose(found.poses[k].t, body.poses[0].t, atol=1e-6)
    json.dumps(match_record(found), allow_nan=False)
    # predicted poses, one of them wrong
    wrong = rm.Pose(scene.poses[1][0], scene.poses[1][1] + (0.2, 0.0, 0.0), np.diag(SPREAD**2))
    found = rm.match(
        POINTS, scene.rows, rm.P3P(RIG), bodies=NAMES, prior={"left": predicted(scene, 2), "right": wrong}, **known
    )
    np.testing.assert_array_equal(found.sightings.assignment, scene.truth)
    assert found.bodies["left"].prior_holds
    assert found.bodies["left"].evaluated == 0
    assert not found.bodies["right"].prior_holds


def test_a_predicted_body_in_doubt_keeps_what_is_believed() -> None:
    """A detection beside one of its sightings leaves that one out, and neither the body nor the other one in doubt."""
    scene = frame(3, 1, RIG, hands=2)
    k, i = np.argwhere(scene.truth[:, :LEDS] >= 0)[4]
    beside = scene.rows[scene.truth[k, i]] + np.array([0.8 * NOISE, 0.0, 0.0])
    prior = {label: predicted(scene, 3, SPREAD / 5.0, body) for body, label in enumerate(LABELS)}
    known = KNOWN | {"normals": NORMALS}
    found = rm.match(POINTS, np.vstack([scene.rows, beside]), rm.P3P(RIG), bodies=NAMES, prior=prior, **known)
    assert found.evaluated == 0
    assert found.bodies["left"].status is rm.Status.MATCHED
    assert found.bodies["left"].prior_holds
    assert found.bodies["right"].status is rm.Status.MATCHED
    assert np.argwhere(found.sightings.assignment != scene.truth).tolist() == [[k, i]]
    assert found.sightings.assignment[k, i] == -1


def test_a_mirror_image_in_front_of_all_cameras_is_told_apart() -> None:
    """Left and right are congruent but for a reflection: where one is in view, the other is not found in its place."""
    scene = frame(4, 0, RIG)
    rows = scene.rows
    found = rm.match(POINTS, rows, rm.P3P(RIG), bodies=NAMES, **(KNOWN | {"normals": NORMALS}))
    assert found.bodies["left"].status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.bodies["left"].sightings.assignment, scene.truth)
    assert not found.bodies["right"].status


def test_two_bodies_are_followed() -> None:
    tracker = rm.Tracker(POINTS, rm.P3P(RIG), bodies=NAMES, **(KNOWN | {"normals": NORMALS}))
    for k in range(8):
        scene = frame(3, k, RIG, hands=2)
        found = tracker.update(scene.rows)
        np.testing.assert_array_equal(found.sightings.assignment, scene.truth)
        assert (found.evaluated > 0) == (k == 0)
    assert {state.name for state in tracker.states.values()} == {"TRACKING"}


def test_sizes_of_images() -> None:
    expected = RIG.expects(0, np.array([[320.0, 240.0], [0.0, 100.0], [-16.0, 100.0], [-40.0, 100.0], [639.0, 490.0]]))
    np.testing.assert_allclose(expected, [1.0, 0.5, 0.25, 0.0, 0.5 - 10.0 / 64.0])
    assert rm.Rig(RIG.views).expects(0, np.array([[-1e6, 0.0]])) == 1.0
    assert rm.Rig(RIG.views) != RIG
    assert RIG.sizes is not None
    views = [(replace(camera, size=size), R, t) for (camera, R, t), size in zip(RIG.views, RIG.sizes, strict=True)]
    assert rm.Rig(views) == RIG
    assert rm.Rig([*views[:3], RIG.views[3]]).sizes is None
    for sizes in ([(640, 480)] * 3, [(640, 0)] * 4, "large", [(640, 480)] * 3 + [(640,)]):
        with pytest.raises(InputError, match="size"):
            rm.Rig(RIG.views, sizes=sizes)


def test_without_sizes_frames_are_followed_too() -> None:
    rig = rm.Rig(RIG.views)
    tracker = rm.Tracker(POINTS[:LEDS], rm.P3P(rig), **KNOWN)
    for k in range(6):
        scene = frame(5, k, rig)
        found = tracker.update(scene.rows)
        assert found.status is rm.Status.MATCHED
        assert (found.sightings.assignment == scene.truth)[found.sightings.assignment >= 0].all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"prior": rm.Pose(np.eye(3), np.zeros(3))}, "covariance"),
        ({"prior": {"left": rm.Pose(np.eye(3), np.zeros(3), np.eye(6))}}, "pose itself"),
        ({"prior": rm.Pose(np.eye(3), np.zeros(3), np.eye(6)), "bodies": ["a"] * 10 + ["b"] * 10}, "dict"),
        ({"bodies": ["a"] * 18 + ["b"] * 2}, "give it at least 4"),
        ({"prior": rm.Pose(np.eye(3), np.zeros(3), np.eye(6)), "motions": 2}, "motions"),
    ],
)
def test_what_cannot_be_used(options: dict[str, Any], words: str) -> None:
    scene = four_about()
    with pytest.raises(InputError, match=words) as error:
        rm.match(scene.points, scene.rows, rm.P3P(scene.rig), noise=0.5, **options)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="only P3P and UP2P"):
        rm.ThreePlusOne(scene.rig)


def test_a_flight_of_bodies_on_the_command_line(tmp_path: Path) -> None:
    model, camera, frames = tmp_path / "model.csv", tmp_path / "rig.json", tmp_path / "frames.csv"
    write_points(model, PointSet(POINTS, None, NORMALS, tuple(NAMES.tolist())))
    write_camera(camera, Calibration(RIG))
    assert read_camera(camera).camera == RIG
    scenes = [frame(3, k, RIG, hands=2) for k in range(3)]
    write_table(
        frames,
        ("frame", "x", "y", "camera"),
        [(k, x, y, int(c)) for k, scene in enumerate(scenes) for x, y, c in scene.rows.tolist()],
    )
    common = ["--problem", "p3p", "--camera", str(camera), "--noise", str(NOISE), "--view-angle", str(VIEW)]
    result = CliRunner().invoke(app, ["track", str(model), str(frames), *common])
    assert result.exit_code == 0, result.stderr
    rows = list(csv.DictReader(result.stdout.splitlines()))
    assert [(row["frame"], row["body"], row["status"]) for row in rows] == [
        (str(k), label, "matched") for k in range(3) for label in LABELS
    ]
    for row, (_, t) in zip(rows, [pose for scene in scenes for pose in scene.poses], strict=True):
        np.testing.assert_allclose([float(row[key]) for key in ("tx", "ty", "tz")], t, atol=2e-3)

    write_points(tmp_path / "one.csv", PointSet(POINTS[:LEDS], None, NORMALS[:LEDS]))
    scene = frame(1, 0, RIG)
    write_table(tmp_path / "image.csv", ("x", "y", "camera"), [(x, y, int(c)) for x, y, c in scene.rows.tolist()])
    prior = predicted(scene, 1)
    (tmp_path / "prior.json").write_text(
        json.dumps({"R": prior.R.tolist(), "t": prior.t.tolist(), "covariance": prior.covariance.tolist()})
    )
    image = ["match", str(tmp_path / "one.csv"), str(tmp_path / "image.csv"), *common, "--json"]
    result = CliRunner().invoke(app, [*image, "--prior", str(tmp_path / "prior.json")])
    assert result.exit_code == 0, result.stderr
    record = json.loads(result.stdout)
    assert record["sightings"] == scene.truth.tolist()
    assert record["evaluated"] == 0

    measured = ",".join(f"{part:.9f}" for part in (scene.poses[0][0] @ [0.0, 1.0, 0.0]).tolist())
    vertical = ["--vertical-world", "0,1,0", "--vertical-camera", measured, "--vertical-noise", ".1"]
    result = CliRunner().invoke(app, [*image, "--problem", "up2p", *vertical])  # the last --problem counts
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["sightings"] == scene.truth.tolist()

    output = tmp_path / "matches.csv"
    result = CliRunner().invoke(app, [*image[:-1], "--prior", str(tmp_path / "prior.json"), "--output", str(output)])
    assert result.exit_code == 0, result.stderr
    listed = list(csv.DictReader(output.read_text().splitlines()))
    assert [int(row["source"]) for row in listed] == np.flatnonzero((scene.truth >= 0).any(axis=0)).tolist()
    for row in listed:  # of the first camera that sees the point
        first = scene.truth[:, int(row["source"])]
        assert int(row["target"]) == first[first >= 0][0]
        assert float(row["residual"]) < 5.0 * NOISE
    for option in ("--plot", "--report"):
        result = CliRunner().invoke(
            app, [*image, option, str(tmp_path / ("x.png" if option == "--plot" else "x.html"))]
        )
        assert result.exit_code == 2
        assert "several images" in result.stderr

    write_table(frames, ("frame", "x", "y"), [(0, 1.0, 2.0)])
    result = CliRunner().invoke(app, ["track", str(model), str(frames), *common])
    assert result.exit_code == 2
    assert "camera" in result.stderr
    write_table(frames, ("frame", "x", "y", "camera"), [(0, float(k), 2.0, 7) for k in range(5)])
    result = CliRunner().invoke(app, ["track", str(model), str(frames), *common])
    assert result.exit_code == 2
    assert "camera 7" in result.stderr


def test_a_pixel_that_a_lens_cannot_show_stops_no_flight() -> None:
    """It is left out where a frame is searched and where one is predicted."""
    lens = rm.Camera.from_opencv([[800.0, 0.0, 320.0], [0.0, 780.0, 240.0], [0.0, 0.0, 1.0]], [-0.4, 0.0, 0.0, 0.0])
    rig = rm.Rig([(lens, np.eye(3), np.zeros(3)), (lens, np.eye(3), np.array([-0.3, 0.0, 0.0]))])
    points = np.random.default_rng(5).uniform(-0.5, 0.5, (8, 3))
    pixels = [
        lens.project(points + np.array([0.1, 0.0, 4.0])),
        lens.project(points + np.array([-0.2, 0.0, 4.0])),
        [[1500.0, 240.0]],
    ]
    index = np.array([0] * 8 + [1] * 9)
    tracker = rm.Tracker(points, rm.P3P(rig), noise=0.3)
    found = tracker.update((np.concatenate(pixels), index))
    np.testing.assert_array_equal(found.sightings.assignment, np.arange(16).reshape(2, 8))
    found = tracker.update((np.concatenate(pixels), index))
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.sightings.assignment, np.arange(16).reshape(2, 8))
