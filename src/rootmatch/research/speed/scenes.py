"""Benchmark scenes: the paper's, with clutter, at one pixel of noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rootmatch.hypergraph.enumeration import wide_first
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

SCENES: dict[str, Callable[..., Scene]] = {"p3p": p3p_scene, "up2p": up2p_scene, "3p1": three_plus_one_scene}
NOISE = 1.0


def make_scene(problem: str, points: int, outliers: int, seed: int = 0) -> Scene:
    """A simulated scene of a problem."""
    return SCENES[problem](n=points, outliers=outliers, noise=NOISE, seed=seed)


def scene_and_tables(problem: str, points: int, outliers: int) -> tuple[Scene, Any]:
    """A scene and the tables of its exhaustive sweep."""
    scene = make_scene(problem, points, outliers)
    return scene, scene.problem.prepare(scene.source[wide_first(scene.source)], scene.target, NOISE)
