"""Poses of a rig from three sightings in one camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rig_scenes import NOISE, VIEW, RigScene, controllers, frame, headset
from rootmatch.explain.image_hypotheses import model_of
from rootmatch.explain.rig_copies import copies_task
from rootmatch.explain.task import MatchingTask
from rootmatch.model.compiled.rig_gathering import gather_sightings
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import poses_of_sets

RIG = headset()
POINTS, NORMALS, _ = controllers()
LEDS = len(POINTS) // 2
KNOWN: dict[str, Any] = {"noise": NOISE, "normals": NORMALS[:LEDS], "view_angle": np.radians(VIEW)}
GATE, RATE, HIDDEN = 5.0, 0.7, 0.1


def three_each(seed: int, clutter: int = 2) -> RigScene:
    """A frame in which no camera shows more than three of the LEDs, and three of them do."""
    scene = frame(seed, 0, RIG, clutter=clutter)
    rng, truth = np.random.default_rng([seed, 8]), scene.truth.copy()
    for row in truth:
        seen = np.flatnonzero(row >= 0)
        row[rng.permutation(seen)[3:]] = -1
    gone = np.setdiff1d(scene.truth[scene.truth >= 0], truth[truth >= 0])
    rows = np.setdiff1d(np.arange(len(scene.rows)), gone)
    place = np.full(len(scene.rows) + 1, -1)
    place[rows] = np.arange(len(rows))
    return scene._replace(rows=scene.rows[rows], truth=place[truth])


def gathered(model: DetectionModel, sources: NDArray, at: Any, visible: NDArray) -> tuple[NDArray, float]:
    """What `gather_sightings` finds of one pose, without any of its code."""
    own = np.flatnonzero(sources >= 0)
    A = sum(at.jacobian[0, i].T @ at.jacobian[0, i] / model.sigma[sources[i]] ** 2 for i in own)
    covariance = np.linalg.inv(A)
    out, total, n = sources.copy(), 0.0, model.shape[0] // len(model.images)
    for camera, detections in enumerate(model.images):
        part, hit = 0.0, False
        for i in range(camera * n, (camera + 1) * n):
            chance = min(RATE * visible[0, i], 0.999)
            if visible[0, i] <= HIDDEN:
                continue
            if sources[i] >= 0:
                part, hit = part + np.log(chance), True
                continue
            values = {}
            for j in detections:
                if j in out:
                    continue
                spread = at.jacobian[0, i] @ covariance @ at.jacobian[0, i].T + model.sigma[j] ** 2 * np.eye(2)
                off = model.target[j] - at.pixels[0, i]
                squared = float(off @ np.linalg.solve(spread, off))
                value = np.log(chance / (1.0 - chance)) - 0.5 * squared - 0.5 * np.log(np.linalg.det(spread))
                if squared <= GATE**2:
                    values[j] = value - np.log(2.0 * np.pi) - model.clutter.log_density[j]
            best = max(values, key=values.__getitem__, default=None)
            part += np.log1p(-chance)
            if best is not None and values[best] > 0.0:
                out[i], part, hit = best, part + values[best], True
        total += part if hit else 0.0
    return out, total


@pytest.mark.parametrize("seed", range(4))
def test_what_a_pose_gathers_is_what_first_order_predicts(seed: int) -> None:
    scene = three_each(seed)
    model = model_of(copies_task(MatchingTask.of(rm.P3P(RIG), POINTS[:LEDS], scene.rows, **KNOWN)))
    camera = int(np.argmax((scene.truth >= 0).sum(axis=1)))
    rows = np.full((2, *scene.truth.shape), -1)
    rows[:, camera] = scene.truth[camera]
    seen = np.flatnonzero(scene.truth[camera] >= 0)
    rows[1, camera, seen] = np.roll(scene.truth[camera, seen], 1)  # a false one
    _, poses = poses_of_sets(model, rows.reshape(2, -1), 3)
    at = model.linearised(poses.rotation, poses.position)
    visible = model.visibility(at, np.zeros(len(at.seen)))
    out = np.empty(poses.assignments.shape, np.int64), np.empty(len(poses.assignments))
    target, sigma, *_ = model.image_for_kernels
    gather_sightings(
        (at.pixels, at.jacobian, visible),
        poses.assignments,
        (target, sigma, np.array(model.clutter.log_density), np.array(model.image_of), 4),
        (GATE**2, RATE, HIDDEN),
        out,
    )
    compared = 0
    for k, sources in enumerate(poses.assignments):
        if (visible[k, sources >= 0] <= HIDDEN).any():
            assert out[1][k] == -np.inf
            continue
        one = at.take(np.array([k]))
        assignment, gain = gathered(model, sources, one, visible[[k]])
        np.testing.assert_array_equal(out[0][k], assignment)
        assert out[1][k] == pytest.approx(gain, rel=1e-6, abs=1e-6)
        compared += 1
    assert compared >= 1


@pytest.mark.parametrize("seed", range(6))
def test_three_leds_in_each_of_several_cameras_are_found(seed: int) -> None:
    scene = three_each(seed)
    found = rm.match(POINTS[:LEDS], scene.rows, rm.P3P(RIG), **KNOWN)
    assert (scene.truth >= 0).sum(axis=1).max() == 3
    if (scene.truth >= 0).sum() < 6 or (scene.truth >= 0).any(axis=0).sum() < 4:
        assert found.status is not rm.Status.MATCHED or np.array_equal(found.sightings.assignment, scene.truth)
        return
    same = (found.sightings.assignment == scene.truth)[scene.truth >= 0]
    assert found.status is rm.Status.MATCHED
    assert same.mean() >= 0.8
    assert not ((found.sightings.assignment >= 0) & (found.sightings.assignment != scene.truth)).any()


def test_a_vertical_goes_with_them() -> None:
    scene = three_each(3)
    down = np.array([0.0, 1.0, 0.0])
    problem = rm.UP2P(RIG, tuple(scene.poses[0][0] @ down), tuple(down), 0.01)
    found = rm.match(POINTS[:LEDS], scene.rows, problem, **KNOWN)
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.sightings.assignment, scene.truth)


def test_without_normals_three_are_not_searched_for() -> None:
    scene = three_each(0)
    found = rm.match(POINTS[:LEDS], scene.rows, rm.P3P(RIG), noise=NOISE)
    assert found.status is not rm.Status.MATCHED
