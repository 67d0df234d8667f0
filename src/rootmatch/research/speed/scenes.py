"""Benchmark scenes: the paper's, with clutter, at one pixel of noise."""

from __future__ import annotations

from typing import Any

from rootmatch.hypergraph.enumeration import farthest_point_order
from rootmatch.simulation import SCENES, Scene

NOISE = 1.0


def make_scene(problem: str, points: int, outliers: int, seed: int = 0) -> Scene:
    """A simulated scene of a problem."""
    return SCENES[problem](n=points, outliers=outliers, noise=NOISE, seed=seed)


def scene_and_tables(problem: str, points: int, outliers: int) -> tuple[Scene, Any]:
    """A scene and the tables of its exhaustive sweep."""
    scene = make_scene(problem, points, outliers)
    return scene, scene.problem.prepare(scene.source[farthest_point_order(scene.source)], scene.target, NOISE)
