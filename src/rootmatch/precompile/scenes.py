"""A small scene of every problem that the package exports; what is compiled depends on types, not on the points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import rotation_about_y
from rootmatch.cameras.pinhole import Camera
from rootmatch.problems import problem_class
from rootmatch.problems.base import Problem
from rootmatch.simulation import SCENES

CAMERA = Camera(1000.0, 1000.0, 320.0, 240.0)


@dataclass(frozen=True)
class Sample:
    """Points of two sets, and their problem."""

    source: NDArray[np.float64]
    target: NDArray[np.float64]
    problem: Problem
    noise: float


def simulate_sample(name: str, points: int, outliers: int, **more: Any) -> Sample:
    """A scene of the paper."""
    scene = SCENES[name](points, outliers, 0.5, 1, **more)
    return Sample(scene.source, scene.target, scene.problem, scene.noise)


def _rotate(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points turned about the second axis."""
    return np.asarray(points @ rotation_about_y(np.cos(0.3), np.sin(0.3)).T)


def _planar() -> Sample:
    points = np.random.default_rng(1).uniform((-3.0, -2.0, 6.0), (3.0, 2.0, 14.0), (7, 3))
    seen = CAMERA.project(points), CAMERA.project(_rotate(points) + np.array([-2.0, 0.0, 1.0]))
    return Sample(*seen, problem_class("planar")(CAMERA, axis=(0, 1, 0)), 0.1)


def _unknown_zoom() -> Sample:
    points = np.random.default_rng(2).uniform(-2.0, 2.0, (7, 3))
    seen = CAMERA.project(_rotate(points) + np.array([0.3, -0.2, 9.0]))
    return Sample(points, seen, problem_class("up2pf")((320.0, 240.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)), 0.1)


def _point_set(name: str) -> Sample:
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (8, 3))
    plane = [0, 2]  # in which `_rotated` rotates
    return Sample(points[:, plane], _rotate(points)[:, plane], problem_class(name)(2), 0.01)


OWN: dict[str, Callable[[], Sample]] = {
    "planar": _planar,
    "up2pf": _unknown_zoom,
    "similarity": lambda: _point_set("similarity"),
    "rigid": lambda: _point_set("rigid"),
}
"""Scenes of the problems that the paper has not."""


def sample(name: str) -> Sample:
    """A small scene of the problem of that name."""
    return OWN[name]() if name in OWN else simulate_sample(name, 8, 2)
