"""Hypotheses of one camera of a rig that gather something wrong in another one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from hall_scenes import RIG, SIGMA, cluster, images

CAMERA = rm.Camera(1000.0, 1000.0, 640.0, 512.0)
SIDE = Rotation.from_euler("y", -90.0, degrees=True).as_matrix()
VIEWS = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, SIDE, -SIDE @ np.array([-3.5, 0.0, 3.5]))]


@pytest.mark.parametrize("seed", [104])
def test_two_sightings_among_strays_go_with_five_of_another_camera(seed: int) -> None:
    """A pose by three points of 20 cm, 3.5 m away, leaves several detections of the other camera for each point."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.12, 0.12, (12, 3))
    R, t = Rotation.random(random_state=rng).as_matrix(), np.array([0.0, 0.0, 3.5]) + rng.uniform(-0.2, 0.2, 3)
    target, camera, truth, count = [], [], np.full((2, 12), -1), 0
    for k, ((_, turn, shift), shown, strays) in enumerate(zip(VIEWS, (5, 2), (3, 6), strict=True)):
        own, image = rng.permutation(12)[:shown], CAMERA.project((points @ R.T + t) @ turn.T + shift)
        target.append(image[own] + rng.normal(0.0, 0.3, (shown, 2)))
        target.append(image.mean(axis=0) + rng.normal(0.0, 40.0, (strays, 2)))
        camera.append(np.full(shown + strays, k))
        truth[k, own] = count + np.arange(shown)
        count += shown + strays
    match = rm.match(points, (np.concatenate(target), np.concatenate(camera)), rm.P3P(rm.Rig(VIEWS)), noise=0.3)
    assert match.sightings is not None
    np.testing.assert_array_equal(match.sightings.assignment, truth)


@pytest.mark.parametrize("seed", [1010, 1022, 1029])
def test_a_pose_that_gathers_something_wrong_is_narrowed_though_another_one_fits(seed: int) -> None:
    """Four or five sightings of one camera tell the rotation to some degrees: others gather wrong matches at once."""
    rng = np.random.default_rng(seed)
    points = cluster(rng, 5)
    target, truth = images(rng, points, 0.45)
    match = rm.match(points, target, rm.P3P(RIG), noise=SIGMA)
    assert match
    assert match.sightings is not None
    np.testing.assert_array_equal(match.sightings.assignment, truth)
