"""Points that have nothing to do with each other, for every problem that fits poses: rows of `together.py`.

Points are uniform in a box, detections in an image of 640 × 480 pixels; n, n' and σ are drawn for each scene.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import rootmatch as rm

CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
DOWN = (0.0, 1.0, 0.0)
SIZE = (640.0, 480.0)
Scene = tuple[Any, Any, dict[str, Any]]


def image(problem: rm.Problem, minimum: int) -> Callable[[np.random.Generator], Scene]:
    """Points in space and detections."""

    def drawn(rng: np.random.Generator) -> Scene:
        n, m = (int(rng.integers(minimum, maximum)) for maximum in (21, 31))
        told = {"problem": problem, "noise": float(rng.choice([0.25, 0.5, 1.0]))}
        return rng.uniform(-2.0, 2.0, (n, 3)), rng.uniform((0.0, 0.0), SIZE, (m, 2)), told

    return drawn


def images(problem: rm.Problem) -> Callable[[np.random.Generator], Scene]:
    """Two images."""

    def drawn(rng: np.random.Generator) -> Scene:
        n, m = int(rng.integers(8, 21)), int(rng.integers(8, 31))
        told = {"problem": problem, "noise": float(rng.choice([0.25, 0.5, 1.0]))}
        return rng.uniform((0.0, 0.0), SIZE, (n, 2)), rng.uniform((0.0, 0.0), SIZE, (m, 2)), told

    return drawn


def sets(problem: Callable[[int], rm.Problem], dimension: int) -> Callable[[np.random.Generator], Scene]:
    """Two point sets, of coordinates in a box of side 200 and σ as millimetres would have it."""

    def drawn(rng: np.random.Generator) -> Scene:
        n, m = int(rng.integers(4, 13)), int(rng.integers(4, 17))
        told = {"problem": problem(dimension), "noise": float(rng.choice([0.1, 0.3, 1.0]))}
        return rng.uniform(-100.0, 100.0, (n, dimension)), rng.uniform(-100.0, 100.0, (m, dimension)), told

    return drawn


PROBLEMS: dict[str, Callable[[np.random.Generator], Scene]] = {
    "p3p": image(rm.P3P(CAMERA), 8),
    "p3p, few points": image(rm.P3P(CAMERA), 4),
    "up2p": image(rm.UP2P(CAMERA, DOWN, DOWN), 8),
    "up2pf": image(rm.UP2PF((320.0, 240.0), DOWN, DOWN), 4),
    "3p1": images(rm.ThreePlusOne(CAMERA, axis=DOWN, axis2=DOWN)),
    "planar": images(rm.PlanarMotion(CAMERA, axis=DOWN)),
    "rigid, 3": sets(rm.Rigid, 3),
    "rigid, 2": sets(rm.Rigid, 2),
    "similarity, 3": sets(rm.Similarity, 3),
    "similarity, 2": sets(rm.Similarity, 2),
}
