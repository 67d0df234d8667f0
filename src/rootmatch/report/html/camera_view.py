"""The camera of a pose in the frame of the points: its centre, and its image with the detections."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.cameras.pinhole import Camera

if TYPE_CHECKING:
    from rootmatch.problems.pose_fit.pose import Pose
    from rootmatch.result import Match


NEARNESS = 2.5
"""Distance of the drawn image from the centre of the points, in units of their radius: in front of them all."""
NEAREST = 0.25
"""Depth of the drawn image, of the distance to the points, at least: so near to a camera among the points."""
MARGIN = 0.12
"""Width of the rim around the detections, of the larger side of the drawn image."""
STEEPEST = 0.25
"""Cosine of the angle to the optical axis beyond which a ray does not reach the drawn image."""
USUAL = np.array([(-0.45, -0.33), (0.45, -0.33), (0.45, 0.33), (-0.45, 0.33)])
"""Corners at depth 1 of the image of a camera that has not been described."""


def camera_view(match: Match, pose: Pose) -> dict[str, Any]:
    """The camera of a pose, every length true.

    ``frustum`` is the centre and the four corners of the image, clockwise from the upper left; ``seen`` has the place
    of each detection on the image, None for one outside of it. The image is moved along the lines of sight to just in
    front of the points, so that a ray through a detection ends at its point.
    """
    centre = -pose.R.T @ pose.t
    middle = match.source.mean(axis=0)
    distance = max(float(np.linalg.norm(middle - centre)), 1e-12)
    radius = float(np.linalg.norm(match.source - middle, axis=1).max())
    depth = max(NEAREST * distance, distance - NEARNESS * radius)
    flat = _project_to_plane(match, pose)
    drawn: Bools = np.all(np.isfinite(flat), axis=1)
    corners = USUAL
    if drawn.any():
        low, high = flat[drawn].min(axis=0), flat[drawn].max(axis=0)
        rim = MARGIN * max(float((high - low).max()), radius / distance)
        (left, top), (right, bottom) = low - rim, high + rim
        corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])

    def placed(points: Floats) -> list[list[float]]:
        found: list[list[float]] = (
            (depth * np.column_stack([points, np.ones(len(points))]) - pose.t) @ pose.R
        ).tolist()
        return found

    seen = [place if on else None for place, on in zip(placed(np.where(drawn[:, None], flat, 0.0)), drawn, strict=True)]
    return {"frustum": [centre.tolist(), *placed(corners)], "seen": seen, "distance": distance}


def _project_to_plane(match: Match, pose: Pose) -> Floats:
    """Detections (m, 2) on the plane at depth 1; NaN where their rays miss it."""
    nowhere = np.full((len(match.target), 2), np.nan)
    camera = getattr(match.problem, "camera", None)
    if camera is None and pose.focal is not None:
        centre = getattr(match.problem, "centre", None)
        camera = None if centre is None else Camera(pose.focal, pose.focal, float(centre[0]), float(centre[1]))
    if camera is None:
        return nowhere
    rays = camera.seen_bearings(match.target)
    z = rays[:, 2:]
    return np.where(z > STEEPEST, rays[:, :2] / np.where(z > STEEPEST, z, 1.0), np.nan)
