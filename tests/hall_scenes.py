"""A cluster of markers, 10 cm wide, in a hall, 9 m or so from six cameras, with four strays in each image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm

Floats = NDArray[np.float64]
SIGMA, SIZE, CAMERA = 0.25, (1280, 960), rm.Camera(900.0, 900.0, 640.0, 480.0)
AWAY = np.array([0.0, 0.0, 9.0])
TURNS = [Rotation.from_euler("yx", [60.0 * k, -25.0], degrees=True).as_matrix().T for k in range(6)]
RIG = rm.Rig([(CAMERA, turn, AWAY) for turn in TURNS], sizes=[SIZE] * 6)


def cluster(rng: np.random.Generator, count: int) -> Floats:
    """So many markers."""
    return rng.uniform(-0.05, 0.05, (count, 3))


def images(
    rng: np.random.Generator, built: Floats, shown: float | Floats, pose: tuple[Floats, Floats] | None = None
) -> tuple[list[Floats], NDArray[np.int64]]:
    """Detections of each camera, and which of them (6, n) each marker has, −1 for none.

    ``shown``: chance (n,) of a marker to be seen, in each camera; ``pose``: of the cluster, a random one by default.
    """
    if pose is None:
        pose = Rotation.random(random_state=rng).as_matrix(), rng.uniform((-3.0, -1.0, -2.0), (3.0, 1.0, 2.0))
    R, t = pose
    target, truth, count = [], np.full((6, len(built)), -1), 0
    for k, turn in enumerate(TURNS):
        own = np.flatnonzero(rng.random(len(built)) < shown)
        image = CAMERA.project((built[own] @ R.T + t) @ turn.T + AWAY)
        seen = image + rng.normal(0.0, SIGMA, image.shape)
        target.append(np.vstack([seen, rng.uniform((0.0, 0.0), SIZE, (4, 2))]))
        truth[k, own] = count + np.arange(len(own))
        count += len(own) + 4
    return target, truth
