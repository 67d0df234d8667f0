"""Parts of point sets in space: rows of `together.py`.

``part``: of 100 to 300 points in a box the 10 to 20 nearest to a place are measured, among up to 20 others.
``scaled``: the same of 100 points, with an unknown scale. ``stars``: directions in a cap of 20° to 35°, of which those
within 10° of its middle are seen. ``pipe``: bolts in rings of eight, two fifths of them missing, of which a section is
measured among up to 15 others. ``stations``: two sets of 150 points, 50 of them in common, at one side. ``small``: half
of 20 points, the nearest to a place, among 150 others. ``coarse``: eight of 20 points, the nearest to a place, among
32, with a noise of .75 % of the extent. ``moving``: three bodies of seven points that nobody told apart, a tenth
hidden, and two others.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Scene(NamedTuple):
    """Points, what is measured, the truth (n,), and what is told."""

    source: Floats
    target: Floats
    truth: Integers
    told: dict[str, Any]


def scene(rng: np.random.Generator, source: Floats, shown: Integers, others: int, sigma: float, **told: Any) -> Scene:
    """Some of the points, moved anywhere and measured, among others where those are."""
    told = {"problem": rm.Rigid(), "noise": (0.0, sigma), **told}
    scale = 1.0 if isinstance(told["problem"], rm.Rigid) else rng.uniform(0.5, 2.0)
    moved = scale * source[shown] @ Rotation.random(random_state=rng).as_matrix().T + rng.normal(size=3)
    measured = moved + rng.normal(0.0, sigma, moved.shape)
    every = np.concatenate([measured, rng.uniform(moved.min(axis=0), moved.max(axis=0), (others, 3))])
    order = rng.permutation(len(every))
    truth = np.full(len(source), -1)
    truth[shown] = np.argsort(order)[: len(shown)]
    return Scene(source, every[order], truth, told)


def nearest(rng: np.random.Generator, source: Floats, count: int) -> Integers:
    """The points nearest to a place among them."""
    place = source[rng.integers(len(source))]
    return np.argsort(np.linalg.norm(source - place, axis=1))[:count]


def part(rng: np.random.Generator, maximum: int = 300, **told: Any) -> Scene:
    """A part of a large set."""
    source = rng.uniform(-1.0, 1.0, (rng.integers(100, maximum + 1), 3))
    return scene(rng, source, nearest(rng, source, rng.integers(10, 21)), rng.integers(21), 0.0005, **told)


def stars(rng: np.random.Generator) -> Scene:
    """Directions."""
    sky = rng.normal(size=(2500, 3))
    sky /= np.linalg.norm(sky, axis=1)[:, None]
    catalogue = sky[sky[:, 2] > np.cos(np.radians(rng.uniform(20.0, 35.0)))]
    return scene(rng, catalogue, np.flatnonzero(catalogue[:, 2] > np.cos(np.radians(10.0))), 0, 0.0002)


def pipe(rng: np.random.Generator) -> Scene:
    """A section of a pipe."""
    z, angle = (grid.ravel() for grid in np.meshgrid(0.5 * np.arange(12), np.pi / 4.0 * np.arange(8)))
    bolts = np.column_stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), z]) + rng.normal(0.0, 0.004, (96, 3))
    bolts = bolts[rng.random(96) < 0.6]
    low, high = rng.uniform(0.0, 2.0), rng.uniform(3.5, 5.6)
    inside = (bolts[:, 2] >= low) & (bolts[:, 2] <= high) & (rng.random(len(bolts)) < 0.85)
    return scene(rng, bolts, np.flatnonzero(inside), rng.integers(16), 0.001, noise=(0.0005, 0.001))


def stations(rng: np.random.Generator) -> Scene:
    """Two sets that overlap at one side."""
    source = rng.uniform(-1.0, 1.0, (250, 3)) * (5.0, 5.0, 2.0)
    source = source[np.argsort(source[:, 0])]
    seen = scene(rng, source, np.arange(100, 250), 0, 0.002)
    return seen._replace(source=source[:150], truth=seen.truth[:150])


def small(rng: np.random.Generator) -> Scene:
    """Half of a small set in wide clutter."""
    source = rng.uniform(-0.1, 0.1, (20, 3))
    made = scene(rng, source, nearest(rng, source, 10), 0, 0.0005)
    return made._replace(target=np.concatenate([made.target, made.target.mean(axis=0) + rng.uniform(-1, 1, (150, 3))]))


def coarse(rng: np.random.Generator) -> Scene:
    """A part of a small set with much noise."""
    source = rng.uniform(-1.0, 1.0, (20, 3))
    return scene(rng, source, nearest(rng, source, 8), 32, 0.015)


def moving(rng: np.random.Generator) -> Scene:
    """Three bodies in one set."""
    points, measured = [], []
    for k in range(3):
        body = rng.uniform(-0.1, 0.1, (7, 3))
        points.append(body + np.array([0.3 * k, 0.0, 0.0]))
        measured.append(body @ Rotation.random(random_state=rng).as_matrix().T + (0.3 * k, 0.0, 1.0))
    source, every = np.concatenate(points), np.concatenate(measured)
    shown = np.flatnonzero(rng.random(21) < 0.9)
    target = every[shown] + rng.normal(0.0, 0.0005, (len(shown), 3))
    target = np.concatenate([target, rng.uniform(every.min(axis=0), every.max(axis=0), (2, 3))])
    truth = np.full(21, -1)
    truth[shown] = np.arange(len(shown))
    return Scene(source, target, truth, {"problem": rm.Rigid(), "noise": (0.0, 0.0005), "motions": 3})


KINDS = {
    "part": part, "scaled": lambda rng: part(rng, 100, problem=rm.Similarity()), "stars": stars, "pipe": pipe,
    "stations": stations, "small": small, "coarse": coarse, "moving": moving,
}  # fmt: skip
