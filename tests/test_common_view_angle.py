"""A view angle that is not given is unknown, but the same for all points of a body."""

from __future__ import annotations

import numpy as np

import rootmatch as rm
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_poses

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
POSITION = np.array([0.0, 0.0, 1.0])


def gain_of_the_last(cosines: list[float]) -> float:
    """Log-odds of a match of the last point, whose detection lies where it belongs, against none.

    ``cosines``: of the normals of the others; only those that face the camera within 30° are detected.
    """
    rng = np.random.default_rng(1000)
    cosine = np.array([*cosines, 0.15])
    points = rng.uniform(-0.1, 0.1, (len(cosine), 3))
    rays = (points + POSITION) / np.linalg.norm(points + POSITION, axis=1, keepdims=True)
    across = np.cross(rays, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    normals = -cosine[:, None] * rays + np.sqrt(1.0 - cosine[:, None] ** 2) * across
    seen = np.flatnonzero(cosine > np.cos(np.radians(30.0)))
    shown = CAMERA.project(points[[*seen, len(points) - 1]] + POSITION)
    target = np.concatenate([shown, rng.uniform((0.0, 0.0), (1280.0, 960.0), (5, 2))])
    model = DetectionModel(CAMERA, points, target, np.full(len(target), 0.4), normals=normals)
    without = np.full(len(points), -1)
    without[seen] = np.arange(len(seen))
    whole = without.copy()
    whole[-1] = len(seen)
    position = POSITION + model.centre
    found, _ = weigh_poses(model, np.array([whole, without]), np.tile(np.eye(3), (2, 1, 1)), np.tile(position, (2, 1)))
    return float(found.log_odds[0] - found.log_odds[1])


def test_a_point_at_the_margin_is_not_seen_while_others_that_face_the_camera_more_are_not() -> None:
    """Two points with cosines of .3 and .4 are missed, so one of .15 is hardly detected: that is clutter."""
    hidden = gain_of_the_last([0.95] * 6 + [0.3, 0.4])
    away = gain_of_the_last([0.95] * 6 + [-0.6, -0.8])
    assert hidden < away - 1.5
