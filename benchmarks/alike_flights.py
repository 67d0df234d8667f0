"""Flights before which a tracker must not decide by chance: two objects of the same kind, and lamps on a regular grid.

``twins``: two rings of 12 LEDs, .3 to 1 m apart, of which the first is the body. By the seed both stay in view, the
second one leaves, both are hidden for a second, or they cross. ``named``: the same, and the first frame has a prior of
the first one. ``ceiling``: a camera with a measured vertical moves 1.6 m below lamps on a grid of 6 by 4, a fifth of
them missing and some dark; what it sees has rivals a period away.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.tracking.motion_filter import MotionOptions

Floats = NDArray[np.float64]

LEDS, SIGMA = 12, 1.0 / 3.0
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
HIDDEN, LEAVES = range(50, 110), 60
"""Frames in which both are hidden, and from which one is gone."""
HALL_CAMERA = rm.Camera(250.0, 250.0, 640.0, 480.0)
SPACING = np.array([1.2, 1.8])


def ring() -> Floats:
    """Unevenly spaced LEDs of a ring of 11 cm that is not quite flat."""
    rng = np.random.default_rng(3)
    angle, height = np.sort(rng.uniform(0.0, 2.0 * np.pi, LEDS)), rng.uniform(-0.015, 0.015, LEDS)
    return np.column_stack([0.055 * np.cos(angle), 0.055 * np.sin(angle), height])


def hall() -> Floats:
    """Lamps 2.6 m above the floor."""
    grid = SPACING * np.stack(np.meshgrid(np.arange(6), np.arange(4)), axis=-1).reshape(-1, 2)
    lamps = np.column_stack([grid, np.full(len(grid), 2.6)])
    return lamps[np.random.default_rng(1).random(len(lamps)) < 0.8]


RING, LAMPS = ring(), hall()


def alike_tracker(family: str) -> rm.Tracker:
    """The tracker of a family."""
    if family != "ceiling":
        return rm.Tracker(RING, rm.P3P(CAMERA), noise=SIGMA)
    down = (0.0, 0.0, 1.0)
    problem = rm.UP2P(HALL_CAMERA, vertical_camera=down, vertical_world=down, vertical_noise=0.002)
    walk = MotionOptions(velocity=0.2, acceleration=0.5, angular_velocity=1.0, angular_acceleration=5.0)
    return rm.Tracker(LAMPS, problem, noise=SIGMA, tracking=rm.TrackingOptions(interval=1.0 / 30.0, motion=walk))


def twins_flight(seed: int, frames: int, named: bool = False) -> Iterator[dict[str, Any]]:
    """Two objects of the same kind."""
    rng = np.random.default_rng([seed, 17])
    kind, gap, knots = seed % 4, rng.uniform(0.3, 1.0), np.linspace(-0.2, frames / 60.0 + 0.2, 6)
    middle = np.column_stack([(-gap / 2.0, gap / 2.0), (0.0, 0.0), rng.uniform(0.8, 1.3, 2)])
    paths = middle[:, None] + rng.normal(0.0, 0.03, (2, 6, 3))
    if kind == 3:
        paths += np.linspace(0.0, 1.0, 6)[:, None] * np.array([[[gap, 0.0, 0.0]], [[-gap, 0.0, 0.0]]])
    place = [CubicSpline(knots, path) for path in paths]
    first = [Rotation.random(random_state=rng) for _ in place]
    turn = [CubicSpline(knots, rng.uniform(-0.6, 0.6, (6, 3))) for _ in place]
    lamps = rng.uniform((0.0, 0.0), (1280.0, 300.0), (3, 2))
    for k in range(frames):
        poses = [
            ((Rotation.from_rotvec(w(k / 60.0)) * R).as_matrix(), t(k / 60.0))
            for w, R, t in zip(turn, first, place, strict=True)
        ]
        pixels, owners = [lamps], [np.full((3, 2), -1)]
        for number, (R, t) in enumerate(poses):
            seen = np.flatnonzero(rng.random(LEDS) < 0.95)
            gone = (kind == 1 and number == 1 and k >= LEAVES) or (kind == 2 and k in HIDDEN)
            seen = seen[: 0 if gone else None]
            pixels.append(CAMERA.project(RING[seen] @ R.T + t))
            owners.append(np.column_stack([np.full(len(seen), number), seen]))
        known = {"prior": rm.Pose(*poses[0], np.diag([0.03] * 3 + [0.02] * 3) ** 2)} if named and k == 0 else {}
        yield _frame(rng, np.concatenate(pixels), np.concatenate(owners), k / 60.0, poses) | known


def ceiling_flight(seed: int, frames: int) -> Iterator[dict[str, Any]]:
    """Lamps of which a camera that moves below sees some."""
    rng = np.random.default_rng([seed, 23])
    dark, knots = rng.random(len(LAMPS)) < 0.1, np.linspace(-0.2, frames / 30.0 + 0.2, 5)
    walk = rng.uniform(0.2, 0.8, 2) * SPACING * (6, 4) + rng.normal(0.0, 0.25, (5, 2)).cumsum(axis=0)
    place = CubicSpline(knots, np.column_stack([walk, 1.0 + rng.normal(0.0, 0.03, 5)]))
    angle = CubicSpline(knots, rng.uniform(-np.pi, np.pi) + rng.normal(0.0, 0.2, 5).cumsum())
    for k in range(frames):
        R = Rotation.from_euler("z", -angle(k / 30.0)).as_matrix()
        t = -R @ place(k / 30.0)
        pixels = HALL_CAMERA.project(LAMPS @ R.T + t)
        seen = np.linalg.norm(pixels - (640.0, 480.0), axis=1) < 480.0
        (seen,) = np.nonzero(seen & ~dark & (rng.random(len(LAMPS)) < 0.98))
        target = np.concatenate([pixels[seen], rng.uniform((160.0, 0.0), (1120.0, 960.0), (1, 2))])
        owner = np.concatenate([np.column_stack([np.zeros(len(seen), int), seen]), [[-1, -1]]])
        yield _frame(rng, target, owner, k / 30.0, [(R, t)])


def _frame(
    rng: np.random.Generator, target: Floats, owner: NDArray[np.int64], time: float, poses: list[tuple[Floats, Floats]]
) -> dict[str, Any]:
    """A frame of flights.py: noisy detections in the image, in random order, and the body and point of each."""
    inside = ((target > 0.0) & (target < (1280.0, 960.0))).all(axis=1)
    order = rng.permutation(np.flatnonzero(inside))
    target = target + rng.normal(0.0, SIGMA, target.shape)
    return {
        "target": target[order], "camera": np.zeros(len(order), int), "owner": owner[order], "time": time,
        "poses": poses,
    }  # fmt: skip
