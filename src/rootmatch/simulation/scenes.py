"""Scenes of the paper: of points in space and of two levelled views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import random_rotation, rotation_about_y
from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError
from rootmatch.simulation.ingredients import (
    CAMERA_RADIUS,
    CUBE_SIDE,
    DOWN,
    Counts,
    Pose,
    Streams,
    detect_points,
    draw_image,
    draw_points,
    look_at_origin,
    paper_camera,
    random_direction,
    random_horizontal,
)

if TYPE_CHECKING:
    from rootmatch.cameras.base import CameraModel
    from rootmatch.problems.base import Problem
    from rootmatch.problems.p3p.problem import P3P
    from rootmatch.problems.three_plus_one.problem import ThreePlusOne
    from rootmatch.problems.up2p.problem import UP2P


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

    counts = Counts(n, outliers, noise, seed, hidden)
    counts.check(motions)
    streams, camera = Streams(seed), camera or paper_camera()
    rng = streams["camera"]
    pose = look_at_origin(CAMERA_RADIUS * random_direction(rng), roll=rng.uniform(0.0, 2.0 * np.pi))
    rng = streams["motions"]
    moves = [(np.eye(3), np.zeros(3))] + [(random_rotation(rng), random_direction(rng)) for _ in range(motions - 1)]
    return _make_absolute_scene(P3P(camera), pose, moves, streams, counts)


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

    counts = Counts(n, outliers, noise, seed, hidden)
    counts.check(motions)
    streams, camera = Streams(seed), camera or paper_camera()
    pose = look_at_origin(CAMERA_RADIUS * random_horizontal(streams["camera"]))
    rng = streams["motions"]
    moves = [(np.eye(3), np.zeros(3))]
    for _ in range(motions - 1):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        moves.append((rotation_about_y(np.cos(angle), np.sin(angle)), random_direction(rng)))
    return _make_absolute_scene(UP2P(camera, vertical_camera=DOWN, vertical_world=DOWN), pose, moves, streams, counts)


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

    counts = Counts(n, outliers, noise, seed, hidden)
    counts.check()
    limit = CAMERA_RADIUS - CUBE_SIDE / np.sqrt(2.0)
    if not 0.0 < baseline < limit:
        raise InputError(f"baseline is {baseline!r}; expected a length between 0 and {limit:.2f}: give such a number")
    streams, camera = Streams(seed), camera or paper_camera()
    rng = streams["camera"]
    centre = CAMERA_RADIUS * random_horizontal(rng)
    centre2 = centre + baseline * random_horizontal(rng)
    (R1, t1), (R2, t2) = look_at_origin(centre), look_at_origin(centre2)
    world, motions = draw_points(streams, n, hidden, np.zeros(n, dtype=np.int64))
    points = world @ R1.T + t1
    relative = R2 @ R1.T, t2 - R2 @ R1.T @ t1
    source = detect_points(camera, points, noise * streams["source noise"].standard_normal((n + hidden, 2)))
    problem = ThreePlusOne(camera, camera, axis=DOWN, axis2=DOWN)
    return _make_scene(problem, points, motions, (relative,), streams, counts=counts, source=source)


def _make_absolute_scene(problem: P3P | UP2P, pose: Pose, moves: list[Pose], streams: Streams, counts: Counts) -> Scene:
    """Scene of 3D points: each group moved by one of ``moves``, then imaged by the camera at ``pose``."""
    points, motions = draw_points(streams, counts.n, counts.hidden, np.arange(counts.n) * len(moves) // counts.n)
    R, t = pose
    poses = tuple((R @ rotation, R @ translation + t) for rotation, translation in moves)
    return _make_scene(problem, points, motions, poses, streams, counts=counts)


def _make_scene(
    problem: P3P | UP2P | ThreePlusOne,
    points: Floats,
    motions: Integers,
    poses: tuple[Pose, ...],
    streams: Streams,
    *,
    counts: Counts,
    source: Floats | None = None,
) -> Scene:
    """Scene of the image of points by the problem's camera; ``source`` where that is the image of another one."""
    cameras = (problem.camera,) if source is None else (problem.camera, problem.camera)
    target, truth = draw_image(problem.camera, points, motions, poses, streams, counts=counts)
    return Scene(
        problem=problem,
        source=points if source is None else source,
        target=target,
        truth=truth,
        motions=motions,
        noise=counts.noise,
        poses=poses,
        cameras=cameras,
        points=points,
        seed=counts.seed,
    )


SCENES: dict[str, Callable[..., Scene]] = {"p3p": p3p_scene, "up2p": up2p_scene, "3p1": three_plus_one_scene}
"""The paper's scenes by the names of their problems."""
