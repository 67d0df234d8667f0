"""Poses of a rig from three sightings in one camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rig_scenes import NOISE, VIEW, RigScene, controllers, frame, headset

RIG = headset()
POINTS, NORMALS, _ = controllers()
LEDS = len(POINTS) // 2
KNOWN: dict[str, Any] = {"noise": NOISE, "normals": NORMALS[:LEDS], "view_angle": np.radians(VIEW)}


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


def test_of_many_leds_without_normals_three_are_not_searched_for() -> None:
    scene = three_each(0)
    found = rm.match(POINTS[:LEDS], scene.rows, rm.P3P(RIG), noise=NOISE)
    assert found.status is not rm.Status.MATCHED


def four_markers(seed: int, clutter: int) -> tuple[np.ndarray, rm.Rig, np.ndarray, np.ndarray]:
    """A tool of four markers without normals before three cameras half a metre apart, of which each shows three."""
    rng = np.random.default_rng([seed, 9])
    points, sigma = rng.uniform(-0.08, 0.08, (4, 3)), 0.3
    camera, views = rm.Camera(1200.0, 1200.0, 640.0, 480.0), []
    for k in range(3):
        turn = Rotation.from_euler("y", 0.35 * (k - 1)).as_matrix()
        views.append((camera, turn, -turn @ (0.5 * (k - 1), 0.0, 0.0)))
    R, t = Rotation.random(random_state=seed).as_matrix(), rng.uniform((-0.2, -0.2, 1.2), (0.2, 0.2, 1.8))
    rows, owners = [], []
    for k, (_, turn, shift) in enumerate(views):
        for i in rng.permutation(4)[:3].tolist():
            pixel = camera.project((R @ points[i] + t) @ turn.T + shift) + rng.normal(0.0, sigma, 2)
            rows.append((*pixel, k))
            owners.append((k, i))
        rows += [(*rng.uniform((0, 0), (1280, 960)), k) for _ in range(clutter)]
        owners += [None] * clutter
    order, truth = rng.permutation(len(rows)), np.full((3, 4), -1)
    for place, k in enumerate(order.tolist()):
        if (owner := owners[k]) is not None:
            truth[owner] = place
    return points, rm.Rig(views, sizes=[(1280, 960)] * 3), np.array(rows)[order], truth


@pytest.mark.parametrize("clutter", [0, 2])
def test_a_few_markers_without_normals_are_found_by_three_in_each_camera(clutter: int) -> None:
    right, matched = 0, 0
    for seed in range(10):
        points, cameras, rows, truth = four_markers(seed, clutter)
        found = rm.match(points, rows, rm.P3P(cameras), noise=0.3)
        assert found.sightings is not None
        own = found.sightings.assignment
        right += bool(np.array_equal(own[truth >= 0], truth[truth >= 0]))
        if found.status is rm.Status.MATCHED:
            matched += 1
            assert not ((own >= 0) & (own != truth)).any()
    assert right >= 9
    assert matched >= 8


def test_too_many_triples_without_normals_are_not_looked_at() -> None:
    """With ten detections in each camera the answer is a search for four, which three sightings do not have."""
    points, cameras, rows, _ = four_markers(0, clutter=20)
    found = rm.match(points, rows, rm.P3P(cameras), noise=0.3)
    assert found.status is not rm.Status.MATCHED


def test_candidates_hold_for_triples_without_normals() -> None:
    points, cameras, rows, truth = four_markers(0, clutter=2)
    wrong = np.ones((4, len(rows)), bool)
    own = truth[:, 0][truth[:, 0] >= 0]
    wrong[0, own] = False
    found = rm.match(points, rows, rm.P3P(cameras), noise=0.3, candidates=wrong)
    assert found.sightings is not None
    assert not np.isin(found.sightings.assignment[:, 0], own).any()
