"""Ingredients of a simulated scene, each drawn from a random stream of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.cameras.base import CameraModel

Pose = tuple[Floats, Floats]

WIDTH, HEIGHT, FOCAL = 640.0, 480.0, 1000.0  # pixels
CUBE_SIDE = 4.0
CAMERA_RADIUS = 12.0
DOWN = (0.0, 1.0, 0.0)
TRIES = 100
"""Draws of outliers, of which those count that the camera shows."""
MAXIMUM = 10_000_000
"""Points, or outliers, of a scene: gigabytes. A round value."""


@dataclass(frozen=True)
class Counts:
    """How much there is in a scene, as `rootmatch.simulation.p3p_scene` has it."""

    n: int
    outliers: int
    noise: float
    seed: int
    hidden: int

    def check(self, motions: int = 1) -> None:
        """Refuse counts, noise or a seed out of range."""
        given = (("n", self.n, 1), ("outliers", self.outliers, 0), ("seed", self.seed, 0), ("motions", motions, 1))
        for name, value, minimum in (*given, ("hidden", self.hidden, 0)):
            if int(value) != value or value < minimum:
                raise InputError(
                    f"{name} is {value!r}; expected a whole number of at least {minimum}: give such a number"
                )
            if name != "seed" and value > MAXIMUM:
                raise InputError(f"{name} is {value}; expected {MAXIMUM:,} at the most: give a smaller number")
        if motions > self.n:
            raise InputError(
                f"{motions} motions for {self.n} points; expected at least one point per motion: give fewer motions"
            )
        if not (np.isfinite(self.noise) and self.noise >= 0.0):
            raise InputError(f"noise is {self.noise!r}; expected a finite σ ≥ 0 in pixels: give such a number")


class Streams:
    """Independent random generators from one seed, one per ingredient of a scene."""

    INGREDIENTS = (
        "points", "camera", "motions", "outliers", "noise", "source noise", "outlier noise", "order", "hidden",
    )  # fmt: skip

    def __init__(self, seed: int) -> None:
        children = np.random.SeedSequence(seed).spawn(len(self.INGREDIENTS))
        self._children = dict(zip(self.INGREDIENTS, children, strict=True))

    def __getitem__(self, ingredient: str) -> np.random.Generator:
        return np.random.default_rng(self._children[ingredient])


def draw_points(streams: Streams, n: int, hidden: int, labels: Integers) -> tuple[Floats, Integers]:
    """World points (n + hidden, 3), the hidden ones at random positions among the others, and their labels."""
    half = CUBE_SIDE / 2.0
    visible = streams["points"].uniform(-half, half, (n, 3))
    rng = streams["hidden"]
    invisible = rng.uniform(-half, half, (hidden, 3))
    positions = np.sort(rng.permutation(n + hidden)[:n])
    points, motions = np.empty((n + hidden, 3)), np.full(n + hidden, -1, dtype=np.int64)
    points[positions], motions[positions] = visible, labels
    points[motions < 0] = invisible
    return points, motions


def draw_image(
    camera: CameraModel, points: Floats, motions: Integers, poses: tuple[Pose, ...], streams: Streams, *, counts: Counts
) -> tuple[Floats, Integers]:
    """Shuffled noisy image points (n', 2) of the visible points and the outliers, and the truth (n + hidden,)."""
    visible, outliers, noise = np.flatnonzero(motions >= 0), counts.outliers, counts.noise
    moved = np.stack([poses[motions[i]][0] @ points[i] + poses[motions[i]][1] for i in visible])
    image = detect_points(camera, moved, noise * streams["noise"].standard_normal((len(visible), 2)))
    clutter = draw_clutter(camera, streams["outliers"], outliers)
    shift = noise * streams["outlier noise"].standard_normal((outliers, 2))
    clutter = clutter + shift if camera.dimension == 2 else clutter
    order = streams["order"].permutation(len(visible) + outliers)
    truth = np.full(len(points), -1, dtype=np.int64)
    truth[visible] = np.argsort(order)[: len(visible)]
    return np.concatenate([image, clutter])[order], truth


def detect_points(camera: CameraModel, points: Floats, shift: Floats) -> Floats:
    """Detections of points (m, 3) of the camera frame, moved by some noise (m, 2)."""
    if not np.all(camera.sees(points)):
        raise InputError(
            "camera: it does not see all points of the scene; give one with a field of view of at least 30°"
        )
    image = camera.project(points)
    if camera.dimension == 2:
        return image + shift
    rays, axes = camera.axes(image)
    return camera.bearings(rays + (axes @ shift[..., None])[..., 0])


def draw_clutter(camera: CameraModel, rng: np.random.Generator, count: int) -> Floats:
    """Detections (count, 2 or 3) anywhere in the image."""
    if camera.dimension == 3:
        return np.array([random_direction(rng) for _ in range(count)]).reshape(count, 3)
    width, height = 2.0 * np.array([getattr(camera, "cx", WIDTH / 2.0), getattr(camera, "cy", HEIGHT / 2.0)])
    kept = np.empty((0, 2))
    for _ in range(TRIES):
        drawn = rng.uniform((0.0, 0.0), (width, height), (count, 2))
        kept = np.concatenate([kept, drawn[camera.shows(drawn)]])[:count]
        if len(kept) == count:
            return kept
    raise InputError("camera: hardly a pixel of its image shows anything; check its distortion")


def paper_camera() -> CameraModel:
    """The camera of the paper, 640 × 480 pixels."""
    from rootmatch.cameras.pinhole import Camera

    return Camera(FOCAL, FOCAL, WIDTH / 2.0, HEIGHT / 2.0)


def look_at_origin(centre: Floats, roll: float = 0.0) -> Pose:
    """Pose of a camera at ``centre`` whose axis passes through the origin; without roll its x axis is horizontal."""
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(DOWN, forward)
    right /= np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    c, s = np.cos(roll), np.sin(roll)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ level
    return R, -R @ centre


def random_direction(rng: np.random.Generator) -> Floats:
    """Unit vector uniform on the sphere."""
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def random_horizontal(rng: np.random.Generator) -> Floats:
    """Unit vector uniform on the circle y = 0."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), 0.0, np.sin(angle)])
