"""The protocols of blind PnP: points and detections without pairs, and the true pose.

* ``outliers``: as the globally optimal methods are tested. Thirty points in a cube; a share of the model has no image
  (3D outliers), and a share of the detections is clutter (2D outliers).
* ``surface``: as the learned methods are tested. Hundreds of points of a closed surface, all of them projected whether
  they face the camera or not, and clutter.
* ``real``: measured targets, of the files of `rootmatch.research.real`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rootmatch.algebra.rotation import random_rotation
from rootmatch.arrays import Floats
from rootmatch.errors import InputError

FOCAL, WIDTH, HEIGHT = 800.0, 640.0, 480.0
NOISE = 2.0
"""Standard deviation of an image coordinate in pixels, in both simulated protocols."""
POINTS = 30
OUTLIERS = ((0.0, 0.0), (0.0, 0.25), (0.0, 0.5), (0.0, 0.75), (0.25, 0.0), (0.5, 0.0), (0.75, 0.0), (0.5, 0.5))
"""Shares of the model without an image, and of the detections that are clutter."""
SURFACES = ((100, 0.0), (100, 0.5), (300, 0.0), (300, 0.5), (1000, 0.0), (1000, 0.5))
"""Points of a surface, and the share of the detections that is clutter."""
REAL = ("targets", "film", "facade-upright")
"""Protocols of `rootmatch.research.real` with one camera, of which the pose alone is asked here."""
NEAREST, FARTHEST = 5.0, 9.0
"""Distance of the camera, for a model within a ball of radius 1.8."""


@dataclass(frozen=True, eq=False)
class BlindScene:
    """The input of a method, and the true pose ``x_cam = R X + t``."""

    name: str
    """Protocol and row, as the table has them."""
    seed: int
    source: Floats
    target: Floats
    """(n, 3) and (n', 2)."""
    noise: float
    """In pixels."""
    K: Floats
    """(3, 3) of a camera without distortion, or of what the detections were undistorted to."""
    R: Floats
    t: Floats
    """(3, 3) and (3,)."""


def intrinsics(focal: float = FOCAL) -> Floats:
    """The camera of the simulated protocols."""
    return np.array([[focal, 0.0, WIDTH / 2.0], [0.0, focal, HEIGHT / 2.0], [0.0, 0.0, 1.0]])


def project_points(K: Floats, R: Floats, t: Floats, points: Floats) -> Floats:
    """Pixels (n, 2) of points (n, 3)."""
    image = (points @ R.T + t) @ K.T
    return np.asarray(image[:, :2] / image[:, 2:])


def _pose(points: Floats, K: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """A random pose in which all points are inside the image."""
    while True:
        R = random_rotation(rng)
        t = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(NEAREST, FARTHEST)])
        image = project_points(K, R, t, points)
        if np.all((image > 0.0) & (image < (WIDTH, HEIGHT))):
            return R, t


def _scene(name: str, seed: int, points: Floats, *, seen: int, clutter: int, rng: np.random.Generator) -> BlindScene:
    """The first points are seen, with noise; all is shuffled."""
    K = intrinsics()
    R, t = _pose(points, K, rng)
    image = project_points(K, R, t, points[:seen]) + NOISE * rng.standard_normal((seen, 2))
    target = np.concatenate([image, rng.uniform((0.0, 0.0), (WIDTH, HEIGHT), (clutter, 2))])
    source, target = rng.permutation(points), rng.permutation(target)
    return BlindScene(name=name, seed=seed, source=source, target=target, noise=NOISE, K=K, R=R, t=t)


def outlier_scene(unseen: float, clutter: float, seed: int) -> BlindScene:
    """Thirty points of a cube of side 2, shares of them unseen and of the detections clutter."""
    rng = np.random.default_rng([seed, 1])
    seen = round(POINTS * (1.0 - unseen))
    false = round(seen * clutter / (1.0 - clutter))
    points = rng.uniform(-1.0, 1.0, (POINTS, 3))
    return _scene(f"outliers, 3D {unseen:g}, 2D {clutter:g}", seed, points, seen=seen, clutter=false, rng=rng)


def surface_scene(count: int, clutter: float, seed: int) -> BlindScene:
    """Points of a bumpy closed surface, all of them projected."""
    rng = np.random.default_rng([seed, 2])
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    waves, phases = 3.0 * rng.standard_normal((6, 3)), rng.uniform(0.0, 2.0 * np.pi, 6)
    radius = 1.0 + 0.1 * np.sin(direction @ waves.T + phases).sum(axis=1)
    points = radius[:, None] * direction * rng.uniform(0.5, 1.0, 3)
    false = round(count * clutter / (1.0 - clutter))
    return _scene(f"surface, {count} points, 2D {clutter:g}", seed, points, seen=count, clutter=false, rng=rng)


def simulated_scenes(seeds: range, protocols: tuple[str, ...] = ("outliers", "surface")) -> Iterator[BlindScene]:
    """All simulated scenes of these seeds, row after row."""
    if "outliers" in protocols:
        yield from (outlier_scene(*row, seed) for row in OUTLIERS for seed in seeds)
    if "surface" in protocols:
        yield from (surface_scene(*row, seed) for row in SURFACES for seed in seeds)


def real_scenes(folder: Path, count: int) -> Iterator[BlindScene]:
    """The first scenes of each real protocol; lens distortion is removed from the detections.

    Their true pose is that of the true pairs, by this library's pose fit.
    """
    from rootmatch.problems.p3p import P3P
    from rootmatch.problems.points import PointSets
    from rootmatch.research.real.methods import make_problem
    from rootmatch.research.real.scenes import all_scenes, protocols

    there = [protocol.name for protocol in protocols() if (folder / f"{protocol.file}.npz").is_file()]
    taken = {name: 0 for name in REAL if name in there}
    if not taken:
        raise InputError(f"data: {folder} holds no file of {', '.join(REAL)}; give the folder of the measured targets")
    for scene in all_scenes(folder, list(taken)):
        if taken[scene.protocol] == count or scene.truth is None:
            continue
        taken[scene.protocol] += 1
        source, target = (np.array(scene.request[name], dtype=float) for name in ("source", "target"))
        camera, noise = make_problem(scene.request).camera, float(scene.request["noise"])
        K, rays = camera.matrix, camera.bearings(target)
        straight = (rays[:, :2] / rays[:, 2:]) * (K[0, 0], K[1, 1]) + K[:2, 2]
        problem = P3P(type(camera)(*camera.numbers))
        points = PointSets(source, straight, np.zeros(len(source)), np.full(len(straight), noise))
        (pose,) = problem.poses(points, scene.truth[None])
        if pose is None:
            raise InputError(f"{scene.name}: the true pairs have no pose; fetch the data again")
        name = f"real, {scene.protocol}"
        yield BlindScene(
            name=name, seed=scene.number, source=source, target=straight, noise=noise, K=K, R=pose.R, t=pose.t
        )
