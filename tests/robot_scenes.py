"""Seeded scenes of the problems that the paper does not have: a robot on a floor, an upright camera of unknown zoom.

Nothing here uses the package. Frames: camera x right, y down, z forward, ``x_cam = R X + t``; pixels x right, y down.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from instances import axis_rotation, project

INTRINSICS = (600.0, 600.0, 320.0, 240.0)
DOWN = np.array([0.0, 1.0, 0.0])


class Scene(NamedTuple):
    """Points to match and everything that is true of them.

    ``source`` (n, 2 | 3), ``target`` (n', 2), ``truth`` (n,); ``angle`` of the turn about the vertical; ``rotation``
    and ``translation`` of the camera (of the second view against the first); ``vertical`` in the camera; the points in
    the first camera's (or the world's) frame; ``focal`` length.
    """

    source: np.ndarray
    target: np.ndarray
    truth: np.ndarray
    angle: float
    rotation: np.ndarray
    translation: np.ndarray
    vertical: np.ndarray
    points: np.ndarray
    focal: float


def _shuffled(
    rng: np.random.Generator, image: np.ndarray, outliers: int, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    clutter = rng.uniform((0.0, 0.0), (640.0, 480.0), (outliers, 2))
    order = rng.permutation(len(image) + outliers)
    noisy = image + noise * rng.normal(size=image.shape)
    return np.concatenate((noisy, clutter))[order], np.argsort(order)[: len(image)]


def robot(
    n: int = 10,
    outliers: int = 0,
    noise: float = 0.0,
    seed: int = 0,
    step: float = 1.0,
    tilt: float = 0.0,
    angle: float | None = None,
) -> Scene:
    """Two views of a robot that turned and drove ``step``; its camera looks down by ``tilt`` radians."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-0.5, 0.5) if angle is None else angle
    heading = rng.uniform(-0.7, 0.7)
    mount = axis_rotation(np.array([1.0, 0.0, 0.3]) / np.hypot(1.0, 0.3), tilt)  # levelled frame to camera frame
    turn = axis_rotation(DOWN, theta)
    move = step * np.array([np.sin(heading), 0.0, np.cos(heading)])
    rotation, translation = mount @ turn @ mount.T, mount @ move
    points: list[np.ndarray] = []
    while len(points) < n:
        point = mount @ np.array([rng.uniform(-4.0, 4.0), rng.uniform(-2.0, 1.5), rng.uniform(3.0, 12.0)])
        moved = rotation @ point + translation
        if min(point[2], moved[2]) < 1.0:
            continue
        seen = project(np.stack((point, moved)), INTRINSICS)
        if np.all((seen > 0.0) & (seen < (640.0, 480.0))):
            points.append(point)
    first = np.array(points)
    source = project(first, INTRINSICS) + noise * rng.normal(size=(n, 2))
    target, truth = _shuffled(rng, project(first @ rotation.T + translation, INTRINSICS), outliers, noise)
    return Scene(source, target, truth, theta, rotation, translation, mount @ DOWN, first, INTRINSICS[0])


def zoomed(
    n: int = 8, outliers: int = 0, noise: float = 0.0, seed: int = 0, tilt: float = 0.3, depth: float = 8.0
) -> Scene:
    """An upright camera of random focal length, looking down by up to ``tilt``, at points in a box ``depth`` away."""
    rng = np.random.default_rng(seed)
    focal = rng.uniform(500.0, 1500.0)
    theta = rng.uniform(-np.pi, np.pi)
    mount = axis_rotation(np.array([1.0, 0.0, 0.0]), rng.uniform(0.0, tilt)) @ axis_rotation(
        np.array([0.0, 0.0, 1.0]), rng.uniform(-0.1, 0.1)
    )
    rotation = mount @ axis_rotation(DOWN, theta)
    points = rng.uniform(-2.0, 2.0, (n, 3))
    translation = mount @ np.array([0.0, 0.0, depth])
    intrinsics = (focal, focal, 320.0, 240.0)
    image = project(points @ rotation.T + translation, intrinsics)
    target, truth = _shuffled(rng, image, outliers, noise)
    return Scene(points, target, truth, theta, rotation, translation, mount @ DOWN, points, focal)


def moved_points(
    dimension: int,
    n: int = 10,
    outliers: int = 0,
    noise: float = 0.0,
    seed: int = 0,
    scale: float = 1.0,
    mirror: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, dimension), the same turned, scaled and moved among outliers, and the truth; both sets are noisy."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (n, dimension))
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix() if dimension == 3 else _plane_turn(rng)
    if mirror:
        turn = turn @ np.diag([-1.0] + [1.0] * (dimension - 1))
    target = scale * points @ turn.T + rng.normal(size=dimension)
    clutter = rng.uniform(target.min(axis=0), target.max(axis=0), (outliers, dimension))
    order = rng.permutation(n + outliers)
    every = np.concatenate((target + noise * rng.normal(size=target.shape), clutter))[order]
    return points + noise * rng.normal(size=points.shape), every, np.argsort(order)[:n]


def _plane_turn(rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
