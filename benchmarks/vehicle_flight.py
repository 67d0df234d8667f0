"""A vehicle in a hall that localises itself by reflectors on a map, with a laser scanner: a drive in a plane."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rootmatch as rm

HALL = np.array([60.0, 35.0])
"""Metres."""
MAP_NOISE, RANGE_NOISE, BEARING_NOISE = 0.01, 0.015, np.radians(0.085)
RATE, SPEED, REACH, MAXIMUM = 15.0, 1.5, 22.0, 14
"""Scans and metres a second; how far reflectors are seen, and how many, the nearest."""
BEHIND = range(40, 48)
"""Scans in which somebody stands before the scanner: two reflectors are seen."""


def _mount_reflectors() -> NDArray[np.float64]:
    """Where reflectors (40, 2) are: half of them on the posts of two racks, 3 m apart to 2 cm, the others on walls."""
    rng = np.random.default_rng(8)
    racks = np.array([(6.0 + 3.0 * k, y) for y in (10.0, 15.5) for k in range(10)]) + rng.normal(0.0, 0.02, (20, 2))
    on_walls = rng.uniform((0.0, 0.0), HALL, (20, 2))
    wall = rng.integers(0, 4, 20)
    on_walls[wall < 2, 1] = np.where(wall[wall < 2] == 0, 0.0, HALL[1])
    on_walls[wall > 1, 0] = np.where(wall[wall > 1] == 2, 0.0, HALL[0])
    return np.concatenate([racks, on_walls])


REFLECTORS = _mount_reflectors()
MAP = REFLECTORS + np.random.default_rng(9).normal(0.0, MAP_NOISE, REFLECTORS.shape)
"""As it was surveyed."""


def vehicle_tracker() -> rm.Tracker:
    """A tracker of the map, which moves before the vehicle; lengths are in radii of the map."""
    radius = float(np.sqrt(((MAP - MAP.mean(axis=0)) ** 2).sum(axis=1).mean()))
    motion = rm.MotionOptions(
        velocity=SPEED / radius, acceleration=1.0 / radius, angular_velocity=0.5, angular_acceleration=1.0
    )
    return rm.Tracker(
        MAP, rm.Rigid(), noise=(MAP_NOISE, 0.02), tracking=rm.TrackingOptions(interval=1.0 / RATE, motion=motion)
    )


def vehicle_flight(seed: int, frames: int) -> Iterator[dict[str, Any]]:
    """A drive; of the reflectors in reach nine tenths are seen where no shelf hides them, and steel posts beside them.

    A scan's coordinates are off by .015 m along the ray and up to .033 m across.
    """
    rng = np.random.default_rng([seed, 41])
    place, heading, hidden = (
        rng.uniform((10.0, 6.0), HALL - (10.0, 6.0)),
        rng.uniform(-np.pi, np.pi),
        rng.uniform(-np.pi, np.pi, 4),
    )
    posts = rng.uniform((0.0, 0.0), HALL, (12, 2))
    for k in range(frames):
        near_wall = ((place < 4.0) | (place > HALL - 4.0)).any()
        heading += (1.2 if near_wall else 0.4 * np.sin(0.5 * k / RATE)) / RATE
        place = np.clip(place + SPEED / RATE * np.array([np.cos(heading), np.sin(heading)]), 1.0, HALL - 1.0)
        R = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        away, bearing = _polar((REFLECTORS - place) @ R.T)
        behind = np.abs(np.mod(bearing[:, None] + heading - hidden - 0.1 * k / RATE + np.pi, 2.0 * np.pi) - np.pi) < 0.4
        seen = np.flatnonzero((away < REACH) & ~(behind.any(axis=1) & (away > 4.0)) & (rng.random(len(away)) < 0.9))
        seen = seen[np.argsort(away[seen])][: 2 if k in BEHIND else MAXIMUM]
        stray = _polar((posts - place) @ R.T)
        others = np.flatnonzero((stray[0] < 12.0) & (rng.random(len(posts)) < 0.7))
        ranges = np.concatenate([away[seen], stray[0][others], rng.uniform(1.0, 15.0, 1)])
        bearings = np.concatenate([bearing[seen], stray[1][others], rng.uniform(-np.pi, np.pi, 1)])
        ranges = ranges + rng.normal(0.0, RANGE_NOISE, len(ranges))
        bearings = bearings + rng.normal(0.0, BEARING_NOISE, len(ranges))
        owner = np.full((len(ranges), 2), -1)
        owner[: len(seen)] = np.column_stack([np.zeros(len(seen), int), seen])
        order = rng.permutation(len(ranges))
        yield {
            "target": np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])[order],
            "camera": np.zeros(len(ranges), int), "owner": owner[order], "time": k / RATE, "poses": [(R, -R @ place)],
        }  # fmt: skip


def _polar(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances and bearings of points (n, 2)."""
    return np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
