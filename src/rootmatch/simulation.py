"""Simulated scenes of the paper's section "Experiments", seeded, with ground truth.

World frame: y points down, so that the vertical is (0, 1, 0) in the world and, for a levelled camera, in the camera
too.  Camera frame: x right, y down, z forward, ``x_cam = R X + t``.  Lengths are in the units of the cube (side 4),
image coordinates in pixels.

Each ingredient of a scene (points, camera, motions, outliers, noise, order) draws from a random stream of its own,
derived from the seed.  Scenes with the same seed therefore differ only where their parameters do: the noise at σ = 1 is
ten times the noise at σ = 0.1, and five outliers are the first five of ten.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import random_rotation, rotation_about_y
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.cameras.base import CameraModel
    from rootmatch.problems.base import Problem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Pose = tuple[Floats, Floats]

WIDTH, HEIGHT, FOCAL = 640.0, 480.0, 1000.0  # pixels
CUBE_SIDE = 4.0
CAMERA_RADIUS = 12.0
DOWN = (0.0, 1.0, 0.0)
TRIES = 100
"""Draws of outliers, of which those count that the camera shows."""


@dataclass(frozen=True)
class Scene:
    """One simulated instance of a problem.

    Attributes
    ----------
    problem : Problem
        The geometric problem, with its camera(s).
    source : (n, 3) or (n, 2) array
        World points (length units), or pixels of the first image for 3P1.
    target : (n', 2) array
        Pixels of the (second) image, outliers among them, in random order.
    truth : (n,) int64 array
        Index into ``target`` of each source point; −1 for one that has no image.
    motions : (n,) int64 array
        Rigid motion of each source point; −1 for one that has no image.
    noise : float
        σ of the Gaussian noise of each image coordinate, in pixels.
    poses : tuple of (R, t)
        One per motion, ``x_cam = R X + t`` with X of ``points``; R (3, 3), t (3,).
    cameras : tuple of CameraModel
        The camera, or both for 3P1.
    points : (n, 3) array
        The exact 3D points that ``poses`` act on: ``source`` itself, or for 3P1 the points in the frame of the
        first camera.
    seed : int
        Seed of the scene.
    """

    problem: Problem
    source: Floats
    target: Floats
    truth: Integers
    motions: Integers
    noise: float
    poses: tuple[Pose, ...]
    cameras: tuple[CameraModel, ...]
    points: Floats
    seed: int

    def accuracy(self, assignment: NDArray[np.integer]) -> float:
        """Fraction of the source points with an image that ``assignment`` (n,) matches correctly, 0 to 1."""
        visible = self.truth >= 0
        return float(np.mean(np.asarray(assignment)[visible] == self.truth[visible]))


class _Streams:
    """Independent random generators from one seed, one per ingredient of a scene."""

    INGREDIENTS = (
        "points", "camera", "motions", "outliers", "noise", "source noise", "outlier noise", "order", "hidden",
    )  # fmt: skip

    def __init__(self, seed: int) -> None:
        children = np.random.SeedSequence(seed).spawn(len(self.INGREDIENTS))
        self._children = dict(zip(self.INGREDIENTS, children, strict=True))

    def __getitem__(self, ingredient: str) -> np.random.Generator:
        return np.random.default_rng(self._children[ingredient])


def p3p_scene(
    n: int = 10,
    outliers: int = 0,
    noise: float = 0.0,
    seed: int = 0,
    motions: int = 1,
    hidden: int = 0,
    camera: CameraModel | None = None,
) -> Scene:
    """3D points and their image from anywhere on the sphere (paper, "P3P Simulation").

    The camera centre is uniform on the sphere of radius 12 and its optical axis passes through the origin; the roll
    about that axis is uniform.  The points of every motion but the first are rotated about the origin by a uniformly
    random rotation and translated by a random unit vector.

    Parameters
    ----------
    n : int
        Number of source points with an image, uniform in the cube of side 4 centred at the origin.
    outliers : int
        Image points without a source point, uniform in the 640 × 480 image.
    noise : float
        σ of the noise of every image coordinate, in pixels.
    seed : int
        Non-negative; the same seed gives the same scene.
    motions : int
        Number of rigid motions; the points are split into that many equal groups.
    hidden : int
        Additional source points, drawn likewise, without an image (``truth`` −1).
    camera : CameraModel, optional
        Another one than the paper's: with a lens, or ``Bearings()``, whose noise is in radians. Its outliers are
        uniform in the image from (0, 0) to (2 cx, 2 cy), as far as it shows something; bearings are uniform about the
        camera.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For counts, noise or seed out of range, or a camera that does not see the points.
    """
    from rootmatch.problems.p3p.problem import P3P

    _check(n=n, outliers=outliers, noise=noise, seed=seed, motions=motions, hidden=hidden)
    streams, camera = _Streams(seed), camera or _camera()
    rng = streams["camera"]
    pose = _look_at_origin(CAMERA_RADIUS * _unit(rng), roll=rng.uniform(0.0, 2.0 * np.pi))
    rng = streams["motions"]
    moves = [(np.eye(3), np.zeros(3))] + [(random_rotation(rng), _unit(rng)) for _ in range(motions - 1)]
    return _absolute(
        problem=P3P(camera),
        camera=camera,
        pose=pose,
        moves=moves,
        streams=streams,
        n=n,
        outliers=outliers,
        noise=noise,
        seed=seed,
        hidden=hidden,
    )


def up2p_scene(
    n: int = 10,
    outliers: int = 0,
    noise: float = 0.0,
    seed: int = 0,
    motions: int = 1,
    hidden: int = 0,
    camera: CameraModel | None = None,
) -> Scene:
    """3D points and their image from a levelled camera on the equator (paper, "Up2p Simulation").

    As `p3p_scene`, but the camera centre is uniform on the equator (the plane y = 0), the camera's y axis is the
    vertical, and the motions rotate about the vertical only.
    """
    from rootmatch.problems.up2p.problem import UP2P

    _check(n=n, outliers=outliers, noise=noise, seed=seed, motions=motions, hidden=hidden)
    streams, camera = _Streams(seed), camera or _camera()
    pose = _look_at_origin(CAMERA_RADIUS * _horizontal(streams["camera"]))
    rng = streams["motions"]
    moves = [(np.eye(3), np.zeros(3))]
    for _ in range(motions - 1):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        moves.append((rotation_about_y(np.cos(angle), np.sin(angle)), _unit(rng)))
    problem = UP2P(camera, vertical_camera=DOWN, vertical_world=DOWN)
    return _absolute(
        problem=problem,
        camera=camera,
        pose=pose,
        moves=moves,
        streams=streams,
        n=n,
        outliers=outliers,
        noise=noise,
        seed=seed,
        hidden=hidden,
    )


def three_plus_one_scene(
    n: int = 10,
    outliers: int = 0,
    noise: float = 0.0,
    seed: int = 0,
    baseline: float = 1.0,
    hidden: int = 0,
    camera: CameraModel | None = None,
) -> Scene:
    """Two images from levelled cameras in the equatorial plane (paper, "3P1 Simulation").

    The first camera centre is uniform on the equator of the sphere of radius 12; the second lies at distance
    ``baseline`` in a uniformly random direction of the equatorial plane; both optical axes pass through the origin.
    Both images are noisy, the outliers are in the second.  The one pose maps the frame of the first camera to that of
    the second; its translation has length ``baseline``.

    Other parameters and errors as in `p3p_scene`.  ``baseline`` lies strictly between 0 and the radius minus half the
    diagonal of the cube, beyond which points may fall behind the camera.
    """
    from rootmatch.problems.three_plus_one.problem import ThreePlusOne

    _check(n=n, outliers=outliers, noise=noise, seed=seed, motions=1, hidden=hidden)
    limit = CAMERA_RADIUS - CUBE_SIDE / np.sqrt(2.0)
    if not 0.0 < baseline < limit:
        raise InputError(f"baseline is {baseline!r}; expected a length between 0 and {limit:.2f}: give such a number")
    streams, camera = _Streams(seed), camera or _camera()
    rng = streams["camera"]
    centre = CAMERA_RADIUS * _horizontal(rng)
    centre2 = centre + baseline * _horizontal(rng)
    (R1, t1), (R2, t2) = _look_at_origin(centre), _look_at_origin(centre2)
    world, motions = _points(streams, n, hidden, np.zeros(n, dtype=np.int64))
    points = world @ R1.T + t1
    relative = R2 @ R1.T, t2 - R2 @ R1.T @ t1
    source = _detected(camera, points, noise * streams["source noise"].standard_normal((n + hidden, 2)))
    target, truth = _image(
        camera=camera, points=points, motions=motions, poses=[relative], streams=streams, outliers=outliers, noise=noise
    )
    problem = ThreePlusOne(camera, camera, axis=DOWN, axis2=DOWN)
    return Scene(
        problem=problem,
        source=source,
        target=target,
        truth=truth,
        motions=motions,
        noise=noise,
        poses=(relative,),
        cameras=(camera, camera),
        points=points,
        seed=seed,
    )


def _absolute(
    problem: Problem,
    camera: CameraModel,
    pose: Pose,
    moves: list[Pose],
    streams: _Streams,
    n: int,
    outliers: int,
    noise: float,
    seed: int,
    hidden: int,
) -> Scene:
    """Scene of 3D points: each group moved by one of ``moves``, then imaged by the camera at ``pose``."""
    labels = np.arange(n) * len(moves) // n
    points, motions = _points(streams, n, hidden, labels)
    R, t = pose
    poses = tuple((R @ rotation, R @ translation + t) for rotation, translation in moves)
    target, truth = _image(
        camera=camera, points=points, motions=motions, poses=poses, streams=streams, outliers=outliers, noise=noise
    )
    return Scene(
        problem=problem,
        source=points,
        target=target,
        truth=truth,
        motions=motions,
        noise=noise,
        poses=poses,
        cameras=(camera,),
        points=points,
        seed=seed,
    )


def _points(streams: _Streams, n: int, hidden: int, labels: Integers) -> tuple[Floats, Integers]:
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


def _image(
    camera: CameraModel,
    points: Floats,
    motions: Integers,
    poses: tuple[Pose, ...] | list[Pose],
    streams: _Streams,
    outliers: int,
    noise: float,
) -> tuple[Floats, Integers]:
    """Shuffled noisy image points (n', 2) of the visible points and the outliers, and the truth (n + hidden,)."""
    visible = np.flatnonzero(motions >= 0)
    moved = np.stack([poses[motions[i]][0] @ points[i] + poses[motions[i]][1] for i in visible])
    image = _detected(camera, moved, noise * streams["noise"].standard_normal((len(visible), 2)))
    clutter = _clutter(camera, streams["outliers"], outliers)
    shift = noise * streams["outlier noise"].standard_normal((outliers, 2))
    clutter = clutter + shift if camera.dimension == 2 else clutter
    order = streams["order"].permutation(len(visible) + outliers)
    truth = np.full(len(points), -1, dtype=np.int64)
    truth[visible] = np.argsort(order)[: len(visible)]
    return np.concatenate([image, clutter])[order], truth


def _detected(camera: CameraModel, points: Floats, shift: Floats) -> Floats:
    """Detections of points (m, 3) of the camera frame, moved by some noise (m, 2)."""
    if not np.all(camera.sees(points)):
        raise InputError("camera: it does not see all points of the scene; give one with a field of view of 30°")
    image = camera.project(points)
    if camera.dimension == 2:
        return image + shift
    rays, axes = camera.axes(image)
    return camera.bearings(rays + (axes @ shift[..., None])[..., 0])


def _clutter(camera: CameraModel, rng: np.random.Generator, count: int) -> Floats:
    """Detections (count, 2 or 3) anywhere in the image."""
    if camera.dimension == 3:
        return np.array([_unit(rng) for _ in range(count)]).reshape(count, 3)
    width, height = 2.0 * np.array([getattr(camera, "cx", WIDTH / 2.0), getattr(camera, "cy", HEIGHT / 2.0)])
    kept = np.empty((0, 2))
    for _ in range(TRIES):
        drawn = rng.uniform((0.0, 0.0), (width, height), (count, 2))
        kept = np.concatenate([kept, drawn[camera.shows(drawn)]])[:count]
        if len(kept) == count:
            return kept
    raise InputError("camera: hardly a pixel of its image shows anything; check its distortion")


def _camera() -> CameraModel:
    from rootmatch.cameras.pinhole import Camera

    return Camera(FOCAL, FOCAL, WIDTH / 2.0, HEIGHT / 2.0)


def _look_at_origin(centre: Floats, roll: float = 0.0) -> Pose:
    """Pose of a camera at ``centre`` whose axis passes through the origin; without roll its x axis is horizontal."""
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(DOWN, forward)
    right /= np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    c, s = np.cos(roll), np.sin(roll)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ level
    return R, -R @ centre


def _unit(rng: np.random.Generator) -> Floats:
    """Unit vector uniform on the sphere."""
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def _horizontal(rng: np.random.Generator) -> Floats:
    """Unit vector uniform on the circle y = 0."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), 0.0, np.sin(angle)])


def _check(n: int, outliers: int, noise: float, seed: int, motions: int, hidden: int) -> None:
    for name, value, least in (
        ("n", n, 1),
        ("outliers", outliers, 0),
        ("seed", seed, 0),
        ("motions", motions, 1),
        ("hidden", hidden, 0),
    ):
        if int(value) != value or value < least:
            raise InputError(f"{name} is {value!r}; expected a whole number of at least {least}: give such a number")
    if motions > n:
        raise InputError(
            f"{motions} motions for {n} points; expected at least one point per motion: give fewer motions"
        )
    if not (np.isfinite(noise) and noise >= 0.0):
        raise InputError(f"noise is {noise!r}; expected a finite σ ≥ 0 in pixels: give such a number")
