"""What a predicted frame has compiled of its own, each against a slow computation in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rootmatch.cameras.base import CameraModel
from rootmatch.model.views import rays_of
from test_compiled_model import FISHEYE, PINHOLE, SIZES, rig

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
