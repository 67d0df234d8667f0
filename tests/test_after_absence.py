"""What a body that was away for long leaves open: a search that met nothing, and how much shows in a pose elsewhere."""

from __future__ import annotations

import math
from collections.abc import Container

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.shown_in_part import most_visible

Floats = NDArray[np.float64]
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
ACROSS = np.array([(-0.15, 0.02, 0.75), (0.15, -0.03, 0.7)])


def trusted(seed: int, frames: int, shown: tuple[Container[int], Container[int]]) -> list[str]:
    """What is trusted in each frame of a flight of a body and a copy: "body", "copy", or "" for neither.

    ``shown``: the frames that show the body, and those that show the copy.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.06, 0.06, (9, 3))
    first, rate = Rotation.random(2, rng=rng), rng.normal(0.0, 0.5, (2, 3))
    tracker, out = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3), []
    for k in range(frames):
        pixels, owner = [rng.uniform((0, 0), (1280, 960), (3, 2))], [np.full(3, -1)]
        turns = [(Rotation.from_rotvec(rate[one] * k / 60.0) * first[one]).as_matrix() for one in range(2)]
        for one in range(2):
            seen = np.flatnonzero((rng.random(9) < 0.95) & (k in shown[one]))
            pixels.append(CAMERA.project(points[seen] @ turns[one].T + ACROSS[one]))
            owner.append(np.full(len(seen), one))
        of, every = np.concatenate(owner), np.concatenate(pixels)
        match = tracker.update(every + rng.normal(0.0, 0.3, every.shape), time=k / 60.0)
        whose = of[match.assignment[match.assignment >= 0]]
        out.append("" if not match else "body" if (whose == 0).all() else "copy")
    return out


@pytest.mark.parametrize("seed", [4, 8])
def test_the_body_that_is_back_after_seconds_is_weighed_against_what_was_found_in_its_absence(seed: int) -> None:
    """A search that met nothing tells of the body as of a copy: neither was in view then, and each came since."""
    found = trusted(seed, 220, ([*range(20), *range(200, 1000)], range(170, 1000)))
    assert "copy" in found, "nothing tells the copy from the body while it is alone"
    assert "copy" not in found[210:]


def test_a_pose_elsewhere_may_show_more_points_than_the_one_that_is_followed() -> None:
    """Of a cube's corners with outward normals four face a camera before a side, and as many as seven one before it."""
    corners = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) / 10.0
    target, sigma = np.zeros((4, 2)), np.ones(4)
    assert most_visible(DetectionModel(CAMERA, corners, target, sigma)) == 8
    narrow, wide = (
        DetectionModel(
            CAMERA, corners, target, sigma, normals=corners, view_cosine=np.full(8, math.cos(math.radians(a)))
        )
        for a in (60.0, 75.0)
    )
    assert most_visible(narrow) == 1
    assert most_visible(wide) == 4
