"""What a predicted frame has compiled of its own, each against a slow computation in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.rig_image import RigImage
from rootmatch.model.depth_reversal import reversed_in_depth
from rootmatch.model.proposals import Proposals
from rootmatch.model.views import rays_of
from rootmatch.problems.pose_fit.starts import reflected
from test_compiled_model import FISHEYE, PINHOLE, SIZES, rig, scene

Floats = NDArray[np.float64]
GATE, TRIED = 16.0, 8


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_rays_of_a_camera(camera: CameraModel) -> None:
    target = np.random.default_rng(1030).uniform((-300.0, -300.0), (1600.0, 1300.0), (200, 2))
    target[0] = 640.0, 480.0  # the principal point
    shown = camera.shows(target)
    rays = rays_of(camera, target)
    np.testing.assert_allclose(rays[shown], camera.bearings(target[shown]), atol=1e-14)
    assert np.isnan(rays[~shown]).all()
    assert shown.all() == (camera is PINHOLE)


def test_rays_of_a_rig() -> None:
    image = rig(SIZES)
    target = (
        np.random.default_rng(1031).uniform((400.0, 300.0), (900.0, 700.0), (9, 2)) + image.offsets[image.camera_of]
    )
    for ray, pixel, camera in zip(rays_of(image, target), target, image.camera_of, strict=True):
        bearing = image.rig.cameras[camera].bearings(pixel - image.offsets[camera])
        np.testing.assert_allclose(ray, bearing, atol=1e-14)


@pytest.mark.parametrize("flatness", [1.0, 1e-3, 0.0])
@pytest.mark.parametrize("camera", [PINHOLE, rig()], ids=["camera", "rig"])
def test_reversed_depth(camera: CameraModel, flatness: float) -> None:
    """As in NumPy about the centre of the camera with most matches."""
    model, R, position = scene(camera, seed=1032)
    rng = np.random.default_rng(1033)
    turn = Rotation.random(random_state=1034).as_matrix()
    n, cameras = len(model.points), 2 if isinstance(camera, RigImage) else 1
    model.points[:] = np.tile(rng.uniform(-0.06, 0.06, (n // cameras, 3)) * (1.0, 1.0, flatness) @ turn, (cameras, 1))
    assignments = np.where(rng.random((len(R), n)) < 0.8, rng.integers(0, 9, (len(R), n)), -1)
    found = reversed_in_depth(model, Proposals(assignments, R, position))
    centre = np.zeros((len(R), 3))
    if isinstance(camera, RigImage):
        most = (assignments >= 0).reshape(len(R), cameras, -1).sum(axis=2).argmax(axis=1)
        centre = camera.rig.centres[most]
        assert len(set(most.tolist())) == 2
    points = np.broadcast_to(model.points - model.centre, (len(R), n, 3))
    rotation, place = reflected((R, position - centre), points, (assignments >= 0).astype(float))
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found.position, place + centre, atol=1e-9)
    np.testing.assert_array_equal(found.assignments, assignments)
