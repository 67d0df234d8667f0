"""Scenes of rigs: points amidst four cameras, and a headset whose four cameras see two controllers, with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import instances
import rootmatch as rm

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LENS = rm.Camera.from_opencv([[800.0, 0.0, 640.0], [0.0, 800.0, 480.0], [0.0, 0.0, 1.0]], [-0.1, 0.02, 0.0, 0.0])
VIEW, NOISE, RATE = 70.0, 0.3, 60.0
"""Of the headset's scenes: degrees within which an LED is seen, px, and frames a second."""
SIZE = (640, 480)
LABELS = ("left", "right")


class RigScene(NamedTuple):
    """Points, detections (rows of x, y, camera), the rig, what each camera sees (C, n), and the poses of the bodies."""

    points: Floats
    rows: Floats
    rig: rm.Rig
    truth: Integers
    poses: list[tuple[Floats, Floats]]


def four_about(n: int = 20, each: int = 5, clutter: int = 2, seed: int = 0, sigma: float = 0.5) -> RigScene:
    """Points amidst four cameras, each of which sees others of them."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (n, 3))
    R, t = instances.random_rotation(rng), rng.uniform(-0.3, 0.3, 3)
    views, rows, truth, order = [], [], np.full((4, n), -1), rng.permutation(n)
    for k in range(4):
        angle = 0.5 * np.pi * k
        centre = 5.0 * np.array([np.cos(angle), 0.3 * (-1) ** k, np.sin(angle)])
        rotation = instances.look_at(centre, np.zeros(3), np.array([0.0, 1.0, 0.0]))
        views.append((LENS, rotation, -rotation @ centre))
        seen = order[k * each : (k + 1) * each]
        pixels = LENS.project((points[seen] @ R.T + t) @ rotation.T + views[-1][2])
        truth[k, seen] = len(rows) + np.arange(len(seen))
        pixels = np.concatenate(
            [pixels + sigma * rng.standard_normal(pixels.shape), rng.uniform(300, 800, (clutter, 2))]
        )
        rows += [(*pixel, k) for pixel in pixels.tolist()]
    shuffled = rng.permutation(len(rows))
    place = np.argsort(shuffled)
    return RigScene(points, np.array(rows)[shuffled], rm.Rig(views), np.where(truth >= 0, place[truth], -1), [(R, t)])


def controller(leds: int = 22, seed: int = 7) -> tuple[Floats, Floats]:
    """Points (m) and unit normals: LEDs irregularly on a ring 9 cm wide, every fourth facing inwards."""
    rng = np.random.default_rng(seed)
    angle = (np.arange(leds) + rng.uniform(-0.3, 0.3, leds)) * (2.0 * np.pi / leds)
    radius, height = 0.045 + rng.uniform(-0.004, 0.004, leds), rng.uniform(-0.014, 0.014, leds)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    outward = np.where(np.arange(leds) % 4 == 3, -1.0, 1.0)
    normals = np.column_stack([outward * np.cos(angle), outward * np.sin(angle), rng.uniform(-0.8, 0.8, leds)])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def controllers() -> tuple[Floats, Floats, NDArray[np.str_]]:
    """Points, normals and labels of two of them, mirror images of each other."""
    points, normals = controller()
    mirror = np.array([-1.0, 1.0, 1.0])
    return (
        np.concatenate([points, points * mirror]),
        np.concatenate([normals, normals * mirror]),
        np.repeat(LABELS, len(points)),
    )


def headset() -> rm.Rig:
    """Four cameras on the front of a headset, as wide as they are: two look ahead, two down and outwards."""
    camera = rm.Camera.from_opencv(
        [[300.0, 0.0, 320.0], [0.0, 300.0, 240.0], [0.0, 0.0, 1.0]], [-0.05, 0.005, 0.0, 0.0]
    )
    views = []
    for x, y, yaw, pitch in (
        (-0.06, -0.03, -10, 0),
        (0.06, -0.03, 10, 0),
        (-0.07, 0.03, -40, 35),
        (0.07, 0.03, 40, 35),
    ):
        # x right, y down, z forward: to the right about y, down about x
        R = Rotation.from_euler("YX", [yaw, -pitch], degrees=True).as_matrix().T
        views.append((camera, R, -R @ np.array([x, y, 0.0])))
    return rm.Rig(views, sizes=[SIZE] * 4)


@dataclass(frozen=True)
class Hand:
    """The motion of a controller before a headset: amplitudes, frequencies (Hz) and phases (6, 3)."""

    amplitude: Floats
    frequency: Floats
    phase: Floats
    start: Rotation
    place: Floats

    @classmethod
    def of(cls, seed: int, side: float) -> Hand:
        """That of one seed, on the left (−1) or on the right (1)."""
        rng = np.random.default_rng([seed, 31 + int(side)])
        amplitude = rng.uniform(0.2, 1.0, (6, 3))
        amplitude *= (np.array([0.9] * 3 + [0.15, 0.15, 0.15]) / amplitude.sum(axis=1))[:, None]
        frequency, phase = rng.uniform(0.05, 1.0, (6, 3)), rng.uniform(0.0, 2.0 * np.pi, (6, 3))
        start = Rotation.random(random_state=np.random.RandomState(2 * seed + int(side > 0)))
        return cls(amplitude, frequency, phase, start, np.array([0.15 * side, 0.15, 0.45]))

    def pose(self, seconds: float) -> tuple[Floats, Floats]:
        """Rotation and translation at a time."""
        moved = (self.amplitude * np.sin(2.0 * np.pi * self.frequency * seconds + self.phase)).sum(axis=1)
        return (Rotation.from_rotvec(moved[:3]) * self.start).as_matrix(), moved[3:] + self.place


def frame(seed: int, k: int, rig: rm.Rig, hands: int = 1, clutter: int = 2, covered: tuple[int, ...] = ()) -> RigScene:
    """Frame k of a flight: what the four cameras see of one controller or of both, and clutter in each image.

    ``covered``: cameras that see clutter alone.
    """
    rng = np.random.default_rng([seed, k, 33])
    points, normals, _ = controllers()
    points, normals = points[: 22 * hands], normals[: 22 * hands]
    poses = [Hand.of(seed, side).pose(k / RATE) for side in (-1.0, 1.0)[:hands]]
    X = np.concatenate([p @ R.T + t for p, (R, t) in zip(np.split(points, hands), poses, strict=True)])
    n = np.concatenate([p @ R.T for p, (R, _) in zip(np.split(normals, hands), poses, strict=True)])
    rows, truth = [], np.full((len(rig.views), len(points)), -1)
    for c, (camera, rotation, t) in enumerate(zip(rig.cameras, rig.rotations, rig.translations, strict=True)):
        own = X @ rotation.T + t
        pixels = camera.project(own)
        cosine = -(n @ rotation.T * own).sum(axis=1) / np.linalg.norm(own, axis=1)
        seen = camera.sees(own) & (cosine > np.cos(np.radians(VIEW)))
        seen &= (pixels > 0).all(axis=1) & (pixels < SIZE).all(axis=1) & (c not in covered)
        index = np.flatnonzero(seen)
        truth[c, index] = len(rows) + np.arange(len(index))
        every = np.concatenate(
            [pixels[index] + rng.normal(0.0, NOISE, (len(index), 2)), rng.uniform(0, SIZE, (clutter, 2))]
        )
        rows += [(*pixel, c) for pixel in every.tolist()]
    order = rng.permutation(len(rows))
    return RigScene(
        points, np.array(rows).reshape(-1, 3)[order], rig, np.where(truth >= 0, np.argsort(order)[truth], -1), poses
    )
