"""Seeded exact instances with their truth: generic ones, and ones at a stated distance from each degeneracy.

Nothing here uses the package. Frames: camera x right, y down, z forward, ``x_cam = R X + t``; pixels x right, y down.
Every point lies in front of the camera. ``strength`` is the distance from the degenerate configuration (0 = on it),
``inf`` for generic instances.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

STRENGTHS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
PAPER_INTRINSICS = (1000.0, 1000.0, 320.0, 240.0)


class Instance(NamedTuple):
    """One exact absolute-pose instance.

    ``source`` (m, 3) world points, ``target`` (m, 2) pixels, ``intrinsics`` (fx, fy, cx, cy), pose ``rotation`` (3, 3)
    and ``translation`` (3,), and the vertical as a unit vector in the camera and in the world (rotation @ world =
    camera).
    """

    family: str
    strength: float
    source: np.ndarray
    target: np.ndarray
    intrinsics: tuple[float, float, float, float]
    rotation: np.ndarray
    translation: np.ndarray
    vertical_camera: np.ndarray
    vertical_world: np.ndarray

    @property
    def camera_points(self) -> np.ndarray:
        """Points in the camera frame, (m, 3)."""
        return self.source @ self.rotation.T + self.translation

    @property
    def depths(self) -> np.ndarray:
        """Distances from the camera centre along the rays, (m,)."""
        return np.linalg.norm(self.camera_points, axis=1)


def project(points: np.ndarray, intrinsics: tuple[float, float, float, float]) -> np.ndarray:
    """Pixels of points given in the camera frame."""
    fx, fy, cx, cy = intrinsics
    return np.stack((fx * points[:, 0] / points[:, 2] + cx, fy * points[:, 1] / points[:, 2] + cy), axis=1)


def random_unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def axis_rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation by ``angle`` about the unit ``axis`` (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def shortest_arc(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The rotation about ``start x end`` that takes the unit vector ``start`` to ``end`` (not antiparallel ones)."""
    axis = np.cross(start, end)
    sine = float(np.linalg.norm(axis))
    if sine == 0.0:
        return np.eye(3)
    return axis_rotation(axis / sine, math.atan2(sine, float(start @ end)))


def look_at(centre: np.ndarray, aim: np.ndarray, down: np.ndarray) -> np.ndarray:
    """World-to-camera rotation of a camera at ``centre`` whose optical axis passes through ``aim``."""
    forward = (aim - centre) / np.linalg.norm(aim - centre)
    right = np.cross(down, forward)
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(forward, right), forward))


def _orthogonal(rng: np.random.Generator, v: np.ndarray) -> np.ndarray:
    w = np.cross(v, random_unit(rng))
    return w / np.linalg.norm(w)


def _ray(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """Unit ray whose angle to the optical axis lies between ``low`` and ``high`` degrees."""
    off, turn = math.radians(rng.uniform(low, high)), rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.sin(off) * math.cos(turn), math.sin(off) * math.sin(turn), math.cos(off)])


def _intrinsics(rng: np.random.Generator) -> tuple[float, float, float, float]:
    f = rng.uniform(500.0, 2000.0)
    return (f, f * rng.uniform(0.9, 1.1), rng.uniform(200.0, 500.0), rng.uniform(150.0, 400.0))


def _finish(
    family: str,
    strength: float,
    rng: np.random.Generator,
    source: np.ndarray,
    rotation: np.ndarray,
    translation: np.ndarray,
    vertical_camera: np.ndarray | None = None,
    vertical_world: np.ndarray | None = None,
    zoom: float = 1.0,
) -> Instance:
    """The pixels are computed from the rounded source points, so that the instance is exact to rounding."""
    fx, fy, cx, cy = _intrinsics(rng)
    intrinsics = (fx * zoom, fy * zoom, cx, cy)
    camera_points = source @ rotation.T + translation
    assert camera_points[:, 2].min() > 0.0
    y = np.array([0.0, 1.0, 0.0])
    vertical_camera = y if vertical_camera is None else vertical_camera
    vertical_world = rotation.T @ vertical_camera if vertical_world is None else vertical_world
    return Instance(
        family,
        strength,
        source,
        project(camera_points, intrinsics),
        intrinsics,
        rotation,
        translation,
        vertical_camera,
        vertical_world,
    )


def _to_world(rng: np.random.Generator, camera_points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rotation = random_rotation(rng)
    translation = camera_points.mean(axis=0) + rng.uniform(-1.0, 1.0, 3)
    return (camera_points - translation) @ rotation, rotation, translation


# P3P: the first three points carry the degeneracy, the others are generic.


def _p3p_rays(rng: np.random.Generator, points: int, low: float = 0.0, high: float = 30.0) -> np.ndarray:
    return np.array([_ray(rng, low, high) * rng.uniform(5.0, 15.0) for _ in range(points)])


def p3p_generic(rng: np.random.Generator, points: int, strength: float = math.inf) -> Instance:
    return _finish("generic", strength, rng, *_to_world(rng, _p3p_rays(rng, points)))


def p3p_collinear(rng: np.random.Generator, points: int, strength: float) -> Instance:
    """The third point at a distance of strength times the length of the first two's segment from their line."""
    rays = _p3p_rays(rng, points)
    step = rays[1] - rays[0]
    rays[2] = rays[0] + rng.uniform(0.2, 0.8) * step + strength * np.linalg.norm(step) * _orthogonal(rng, step)
    return _finish("collinear", strength, rng, *_to_world(rng, rays))


def p3p_danger_cylinder(rng: np.random.Generator, points: int, strength: float) -> Instance:
    """The camera's centre near the cylinder over the triple's circumscribed circle: two solutions nearly coincide."""
    angles = rng.uniform(0.0, 2.0 * math.pi / 3.0, 3) * 0.8 + np.arange(3) * 2.0 * math.pi / 3.0
    radius = rng.uniform(1.0, 3.0)
    triple = radius * np.stack((np.cos(angles), np.sin(angles), np.zeros(3)), axis=1)
    others = rng.uniform(-radius, radius, (points - 3, 3))
    turn = rng.uniform(0.0, 2.0 * math.pi)
    height = rng.uniform(3.0, 6.0) * radius
    outward = radius * (1.0 + strength)
    centre = np.array([outward * math.cos(turn), outward * math.sin(turn), height])
    spin, offset = random_rotation(rng), rng.uniform(-2.0, 2.0, 3)
    source = np.concatenate((triple, others)) @ spin.T + offset
    centre = spin @ centre + offset
    rotation = look_at(centre, offset + rng.uniform(-0.3, 0.3, 3), random_unit(rng))
    return _finish("danger cylinder", strength, rng, source, rotation, -rotation @ centre)


def p3p_equal_bearings(rng: np.random.Generator, points: int, strength: float) -> Instance:
    """The bearings of two of the first three points differ by the angle strength; their depths differ."""
    rays = _p3p_rays(rng, points)
    first, second = rng.permutation(3)[:2]
    u = rays[first] / np.linalg.norm(rays[first])
    turned = axis_rotation(_orthogonal(rng, u), strength) @ u
    rays[second] = turned * np.linalg.norm(rays[first]) * rng.uniform(1.2, 1.5)
    return _finish("equal bearings", strength, rng, *_to_world(rng, rays))


def p3p_far(rng: np.random.Generator, points: int, strength: float) -> Instance:
    """An object of size 1 seen from 1 / strength through a lens as long: a field of view of about strength."""
    source = rng.uniform(-0.5, 0.5, (points, 3))
    rotation = random_rotation(rng)
    translation = np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), 1.0 / strength])
    return _finish("far", strength, rng, source, rotation, translation, zoom=0.5 / strength)


def p3p_wide(rng: np.random.Generator, points: int, strength: float = math.inf) -> Instance:
    return _finish("wide", strength, rng, *_to_world(rng, _p3p_rays(rng, points, 50.0, 65.0)))


# up2p: the first two points carry the degeneracy.


def _up2p_pose(rng: np.random.Generator, angle: float, any_vertical: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation whose angle about the vertical is ``angle`` after both verticals went to y by the shortest arc."""
    y = np.array([0.0, 1.0, 0.0])
    camera, world = (random_unit(rng), random_unit(rng)) if any_vertical else (y, y)
    rotation = shortest_arc(camera, y).T @ axis_rotation(y, angle) @ shortest_arc(world, y)
    return rotation, camera, world


def _up2p(
    family: str,
    rng: np.random.Generator,
    points: int,
    strength: float,
    angle: float,
    any_vertical: bool,
    second: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Instance:
    rotation, camera, world = _up2p_pose(rng, angle, any_vertical)
    while True:
        rays = _p3p_rays(rng, points)
        if second is not None:
            rays[1] = second(rays[0], camera)
        if rays[1, 2] > 1.0 and np.linalg.norm(rays[1, :2]) < 2.0 * rays[1, 2]:
            break
    translation = rays.mean(axis=0) + rng.uniform(-1.0, 1.0, 3)
    return _finish(family, strength, rng, (rays - translation) @ rotation, rotation, translation, camera, world)


def up2p_generic(
    rng: np.random.Generator, points: int, strength: float = math.inf, any_vertical: bool = True
) -> Instance:
    return _up2p("generic", rng, points, strength, rng.uniform(-math.pi, math.pi), any_vertical)


def up2p_vertical_line(rng: np.random.Generator, points: int, strength: float, any_vertical: bool = True) -> Instance:
    """Both points nearly on one vertical line: the quadratic vanishes as a whole."""

    def second(first: np.ndarray, vertical: np.ndarray) -> np.ndarray:
        height = rng.uniform(1.0, 3.0) * rng.choice((-1.0, 1.0))
        return first + height * (vertical + strength * _orthogonal(rng, vertical))

    return _up2p("vertical line", rng, points, strength, rng.uniform(-math.pi, math.pi), any_vertical, second)


def up2p_same_height(rng: np.random.Generator, points: int, strength: float, any_vertical: bool = True) -> Instance:
    """Both points nearly at one height: gamma is nearly 0 and the two angles nearly half a turn apart."""

    def second(first: np.ndarray, vertical: np.ndarray) -> np.ndarray:
        return first + rng.uniform(1.0, 3.0) * (_orthogonal(rng, vertical) + strength * vertical)

    return _up2p("same height", rng, points, strength, rng.uniform(-math.pi, math.pi), any_vertical, second)


def up2p_angle_zero(rng: np.random.Generator, points: int, strength: float, any_vertical: bool = True) -> Instance:
    return _up2p("angle 0", rng, points, strength, strength * rng.choice((-1.0, 1.0)), any_vertical)


def up2p_angle_pi(rng: np.random.Generator, points: int, strength: float, any_vertical: bool = True) -> Instance:
    return _up2p("angle pi", rng, points, strength, math.pi - strength * rng.choice((-1.0, 1.0)), any_vertical)


P3P_DEGENERATE = (p3p_collinear, p3p_danger_cylinder, p3p_equal_bearings, p3p_far)
UP2P_DEGENERATE = (up2p_vertical_line, up2p_same_height, up2p_angle_zero, up2p_angle_pi)


def p3p_instances(
    points: int = 3,
    generic: int = 200,
    wide: int = 60,
    repeats: int = 10,
    strengths: tuple[float, ...] = STRENGTHS,
    seed: int = 0,
) -> list[Instance]:
    """Generic and wide instances, and ``repeats`` of every degenerate family at every strength."""
    rng = np.random.default_rng(seed)
    made = [p3p_generic(rng, points) for _ in range(generic)] + [p3p_wide(rng, points) for _ in range(wide)]
    made += [make(rng, points, s) for make in P3P_DEGENERATE for s in strengths for _ in range(repeats)]
    return made


def up2p_instances(
    points: int = 2, generic: int = 300, repeats: int = 10, strengths: tuple[float, ...] = STRENGTHS, seed: int = 0
) -> list[Instance]:
    """As ``p3p_instances``; every second instance has its verticals along y, the others any verticals."""
    rng = np.random.default_rng(seed)
    made = [up2p_generic(rng, points, any_vertical=k % 2 == 0) for k in range(generic)]
    made += [
        make(rng, points, s, any_vertical=k % 2 == 0)
        for make in UP2P_DEGENERATE
        for s in strengths
        for k in range(repeats)
    ]
    return made


# The paper's scenes (section "Experiments"), with the points in the order of their pixels.


def paper_scene(problem: str, rng: np.random.Generator, n: int = 10) -> Instance:
    """Points in a 4 x 4 x 4 cube seen from a distance of 12; the camera anywhere ("p3p") or on the equator ("up2p")."""
    source = rng.uniform(-2.0, 2.0, (n, 3))
    down = np.array([0.0, 1.0, 0.0])
    if problem == "p3p":
        centre, hint = 12.0 * random_unit(rng), random_unit(rng)
    else:
        turn = rng.uniform(0.0, 2.0 * math.pi)
        centre, hint = 12.0 * np.array([math.cos(turn), 0.0, math.sin(turn)]), down
    rotation = look_at(centre, np.zeros(3), hint)
    translation = -rotation @ centre
    pixels = project(source @ rotation.T + translation, PAPER_INTRINSICS)
    return Instance(f"paper {problem}", math.inf, source, pixels, PAPER_INTRINSICS, rotation, translation, down, down)


class PairInstance(NamedTuple):
    """Two views of one scene: ``first``, ``second`` (n, 2) pixels, poses ``x_k = rotation_k X + translation_k``."""

    first: np.ndarray
    second: np.ndarray
    intrinsics: tuple[float, float, float, float]
    rotation_first: np.ndarray
    rotation_second: np.ndarray
    translation_first: np.ndarray
    translation_second: np.ndarray


def paper_pair(rng: np.random.Generator, baseline: float, n: int = 10) -> PairInstance:
    """The paper's 3P1 scene: both cameras on the equatorial plane, ``baseline`` apart, both aimed at the origin."""
    source = rng.uniform(-2.0, 2.0, (n, 3))
    turn, side = rng.uniform(0.0, 2.0 * math.pi, 2)
    centres = [12.0 * np.array([math.cos(turn), 0.0, math.sin(turn)])]
    centres.append(centres[0] + baseline * np.array([math.cos(side), 0.0, math.sin(side)]))
    down = np.array([0.0, 1.0, 0.0])
    rotations = [look_at(c, np.zeros(3), down) for c in centres]
    translations = [-r @ c for r, c in zip(rotations, centres, strict=True)]
    images = [project(source @ r.T + t, PAPER_INTRINSICS) for r, t in zip(rotations, translations, strict=True)]
    return PairInstance(images[0], images[1], PAPER_INTRINSICS, *rotations, *translations)
