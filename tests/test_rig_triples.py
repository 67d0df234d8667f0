"""Poses of a rig from three sightings in one camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

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


def test_without_normals_three_are_not_searched_for() -> None:
    scene = three_each(0)
    found = rm.match(POINTS[:LEDS], scene.rows, rm.P3P(RIG), noise=NOISE)
    assert found.status is not rm.Status.MATCHED
