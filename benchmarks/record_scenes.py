"""The scenes of `record.py`, made from NumPy alone: no change of the package changes what it is asked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Scene = dict[str, Any]
Projection = Callable[[Floats], Floats]

FOCAL, CENTRE, SIZE = 1000.0, np.array([320.0, 240.0]), np.array([640.0, 480.0])
BROWN = (-0.28, 0.07, 1e-3, -5e-4, 0.0)
FISHEYE = (0.02, -0.01, 0.003, 0.0)
WIDE = 400.0
"""Focal length with a lens."""
RATE = 60.0
"""Frames a second."""


def pinhole(points: Floats, focal: float = FOCAL) -> Floats:
    """Pixels of points of the camera frame."""
    return focal * points[:, :2] / points[:, 2:] + CENTRE


def brown(points: Floats) -> Floats:
    """The same through Brown's lens."""
    k1, k2, p1, p2, k3 = BROWN
    x, y = (points[:, :2] / points[:, 2:]).T
    r = x * x + y * y
    radial = 1.0 + r * (k1 + r * (k2 + r * k3))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r + 2.0 * x * x)
    v = y * radial + p1 * (r + 2.0 * y * y) + 2.0 * p2 * x * y
    return WIDE * np.column_stack([u, v]) + CENTRE


def fisheye(points: Floats) -> Floats:
    """The same through Kannala and Brandt's."""
    k = FISHEYE
    across = np.linalg.norm(points[:, :2], axis=1)
    angle = np.arctan2(across, points[:, 2])
    square = angle * angle
    radius = angle * (1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
    return WIDE * radius[:, None] * points[:, :2] / np.where(across > 0.0, across, 1.0)[:, None] + CENTRE


def unit(points: Floats) -> Floats:
    """Unit rays to points."""
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def rotation(rng: np.random.Generator, upright: bool = False) -> Floats:
    """A random rotation, about y if upright."""
    if upright:
        return about_y(rng.uniform(-np.pi, np.pi))
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def about_y(angle: float) -> Floats:
    """The rotation about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def turned(vector: Floats) -> Floats:
    """The rotation about a vector by its length."""
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def absolute(seed: int, n: int, clutter: int, sigma: float, upright: bool = False, motions: int = 1) -> Scene:
    """Points in a cube and their image among clutter."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2.0, 2.0, (n, 3))
    pixels = np.empty((n, 2))
    for members in np.array_split(np.arange(n), motions):
        seen = points[members] @ rotation(rng, upright).T + np.array([*rng.uniform(-1, 1, 2), rng.uniform(10, 14)])
        pixels[members] = pinhole(seen)
    pixels += sigma * rng.normal(size=pixels.shape)
    pixels = np.vstack([pixels, rng.uniform((0, 0), (640, 480), (clutter, 2))])
    return {"source": points, "target": pixels[rng.permutation(len(pixels))], "rng": rng}


def views(seed: int, n: int, clutter: int, sigma: float, baseline: float, planar: bool = False) -> Scene:
    """Two images of points, the second rotated about y."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-3, -2, 8), (3, 2, 14), (n, 3))
    turn = about_y(rng.uniform(-0.4, 0.4))
    move = rng.normal(size=3) * (1, 0 if planar else 1, 1)
    moved = points @ turn.T + baseline * move / np.linalg.norm(move)
    first = pinhole(points) + sigma * rng.normal(size=(n, 2))
    second = pinhole(moved) + sigma * rng.normal(size=(n, 2))
    second = np.vstack([second, rng.uniform((0, 0), (640, 480), (clutter, 2))])
    return {"source": first, "target": second[rng.permutation(len(second))], "rng": rng, "seen": (points, moved)}


def flat(seed: int, n: int, clutter: int, sigma: float, dimension: int, scale: float) -> Scene:
    """Two point sets in one space, the second moved and scaled."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, dimension))
    turn = rotation(rng)
    if dimension == 2:
        c, s = np.cos(angle := rng.uniform(-np.pi, np.pi)), np.sin(angle)
        turn = np.array([[c, -s], [s, c]])
    other = scale * points @ turn.T + rng.normal(size=dimension) + sigma * rng.normal(size=points.shape)
    other = np.vstack([other, scale * rng.normal(size=(clutter, dimension))])
    return {"source": points, "target": other[rng.permutation(len(other))], "rng": rng}


def wide(seed: int, n: int, clutter: int, sigma: float, project: Projection, upright: bool = False) -> Scene:
    """Points before a camera with a lens, or rays to points all about it."""
    rng = np.random.default_rng(seed)
    rays = project is unit
    own = rng.uniform((-4, -4, -4) if rays else (-4, -3, 4), (4, 4, 4) if rays else (4, 3, 9), (n, 3))
    R, t = rotation(rng, upright), rng.uniform(-1.0, 1.0, 3)
    image = project(own)
    image = image + sigma * rng.normal(size=image.shape)
    lost = unit(rng.normal(size=(clutter, 3))) if rays else rng.uniform((0, 0), (640, 480), (clutter, 2))
    image = np.vstack([unit(image) if rays else image, lost])
    return {"source": (own - t) @ R, "target": image[rng.permutation(len(image))], "rng": rng}


def bodies(
    seed: int,
    shapes: Sequence[Floats],
    clutter: int,
    sigma: float = 0.3,
    distance: float = 4.0,
    seen: Sequence[bool] | None = None,
    upright: bool = False,
) -> Scene:
    """Several bodies in one image, each with its pose; those not seen leave nothing."""
    rng = np.random.default_rng(seed)
    poses = [
        (rotation(rng, upright), np.array([0.7 * k - 0.35 * (len(shapes) - 1), rng.uniform(-0.3, 0.3), distance]))
        for k in range(len(shapes))
    ]
    shown = [True] * len(shapes) if seen is None else seen
    pixels = [pinhole(X @ R.T + t) for X, (R, t), here in zip(shapes, poses, shown, strict=True) if here]
    image = np.vstack([*pixels, rng.uniform((0, 0), (640, 480), (clutter, 2))])
    image[: len(image) - clutter] += sigma * rng.normal(size=(len(image) - clutter, 2))
    order = rng.permutation(len(image))
    labels = np.repeat([("head", "left", "right")[k] for k in range(len(shapes))], [len(X) for X in shapes])
    return {"source": np.vstack(shapes), "target": image[order], "labels": labels, "poses": poses, "rng": rng}


def shape(seed: int, n: int = 7, size: float = 0.35) -> Floats:
    """Points of a body."""
    return np.random.default_rng([seed, 77]).uniform(-size, size, (n, 3))


def symmetric(seed: int) -> Floats:
    """Points of a body that looks nearly the same after half a turn about z."""
    rng = np.random.default_rng([seed, 78])
    half = rng.uniform((0.1, -0.3, -0.3), (0.35, 0.3, 0.3), (4, 3))
    return np.vstack([half, half * [-1.0, -1.0, 1.0] + 1e-4 * rng.normal(size=(4, 3))])


def surface(seed: int, n: int, clutter: int, sigma: float = 0.4) -> Scene:
    """Points all over an ellipsoid with their normals, of which one side is seen."""
    rng = np.random.default_rng(seed)
    outward = unit(rng.normal(size=(n, 3)))
    points, normals = outward * [1.0, 0.8, 0.6], unit(outward / [1.0, 0.8, 0.6])
    R, t = rotation(rng), np.array([*rng.uniform(-0.3, 0.3, 2), 5.0])
    own = points @ R.T + t
    seen = -(normals @ R.T * own).sum(axis=1) / np.linalg.norm(own, axis=1) > np.cos(np.radians(75.0))
    pixels = pinhole(own[seen])
    pixels += sigma * rng.normal(size=pixels.shape)
    pixels = np.vstack([pixels, rng.uniform(pixels.min(axis=0), pixels.max(axis=0), (clutter, 2))])
    target = pixels[rng.permutation(len(pixels))]
    return {"source": points, "target": target, "normals": normals, "poses": [(R, t)], "rng": rng}


def proposed(seed: int, count: int, upright: bool = False, motions: int = 2) -> Scene:
    """Proposed pairs, one a point, of which a fifth belongs to each motion."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(-1.0, 1.0, (count, 3))
    target = rng.uniform((0, 0), (640, 480), (count, 2))
    for k in range(motions):
        members = np.arange(k * count // 5, (k + 1) * count // 5)
        place = np.array([1.6 * (-1.0) ** k, 0.2, 12.0 + k])
        target[members] = pinhole(source[members] @ rotation(rng, upright).T + place)
        target[members] += rng.normal(size=(len(members), 2))
    order = rng.permutation(count)
    mask = np.zeros((count, count), np.bool_)
    mask[np.arange(count), np.argsort(order)] = True
    return {"source": source, "target": target[order], "mask": mask, "rng": rng}


def rig_views(count: int = 4) -> list[tuple[Floats, Floats]]:
    """Poses of cameras about the origin that look at it: ``x_camera = R x_rig + t``."""
    found = []
    for k in range(count):
        angle = 2.0 * np.pi * k / count
        centre = 5.0 * np.array([np.cos(angle), 0.3 * (-1) ** k, np.sin(angle)])
        z = -centre / np.linalg.norm(centre)
        x = np.cross([0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        R = np.array([x, np.cross(z, x), z])
        found.append((R, -R @ centre))
    return found


def rig(
    seed: int,
    shapes: Sequence[Floats],
    each: int | None,
    clutter: int,
    sigma: float = 0.5,
    cameras: int = 4,
    poses: Sequence[tuple[Floats, Floats]] | None = None,
) -> Scene:
    """Bodies amidst cameras, each of which sees ``each`` of the points, all if None: rows of x, y, camera."""
    rng = np.random.default_rng(seed)
    poses = poses or [
        (rotation(rng), np.array([0.9 * k - 0.45 * (len(shapes) - 1), *rng.uniform(-0.2, 0.2, 2)]))
        for k in range(len(shapes))
    ]
    placed = np.vstack([X @ R.T + t for X, (R, t) in zip(shapes, poses, strict=True)])
    order, rows = rng.permutation(len(placed)), []
    for k, (R, t) in enumerate(rig_views(cameras)):
        seen = order if each is None else order[k * each : (k + 1) * each]
        pixels = pinhole(placed[seen] @ R.T + t, WIDE)
        pixels = np.vstack([pixels + sigma * rng.normal(size=pixels.shape), rng.uniform((0, 0), SIZE, (clutter, 2))])
        rows.append(np.column_stack([pixels, np.full(len(pixels), float(k))]))
    target = np.vstack(rows)
    labels = np.repeat([("left", "right")[k] for k in range(len(shapes))], [len(X) for X in shapes])
    return {
        "source": np.vstack(shapes), "target": target[rng.permutation(len(target))], "labels": labels,
        "poses": list(poses), "rng": rng,
    }  # fmt: skip


def flown(seconds: float, start: int, place: Sequence[float], upright: bool = False) -> tuple[Floats, Floats]:
    """A pose on a smooth path."""
    first = rotation(np.random.default_rng([start, 5]), upright)
    turn = np.array([0.0 if upright else 0.5 * np.sin(2.0 * seconds), 0.8 * seconds, 0.0 if upright else 0.1])
    return turned(turn) @ first, np.array([0.2 * np.sin(3.0 * seconds), 0.1 * np.cos(2.0 * seconds), 0.0]) + place


def flight(
    seed: int,
    frames: int,
    shapes: Sequence[Floats],
    clutter: int = 2,
    sigma: float = 0.3,
    hidden: Sequence[int] = (),
    jump: int | None = None,
    upright: bool = False,
    normals: Floats | None = None,
) -> list[Floats]:
    """Images of bodies that move, frame after frame.

    ``hidden``: frames of clutter alone; ``jump``: the frame before which a second goes by; ``normals``: of one body.
    """
    images = []
    for k in range(frames):
        rng = np.random.default_rng([seed, k, 9])
        seconds = k / RATE + (1.0 if jump is not None and k >= jump else 0.0)
        pixels = []
        for b, X in enumerate(shapes):
            R, t = flown(seconds, 10 * seed + b, [0.7 * b - 0.35 * (len(shapes) - 1), 0.1, 4.0], upright)
            own = X @ R.T + t
            if normals is not None:
                own = own[-(normals @ R.T * own).sum(axis=1) / np.linalg.norm(own, axis=1) > np.cos(np.radians(70.0))]
            pixels.append(pinhole(own) + sigma * rng.normal(size=(len(own), 2)))
        image = np.vstack([*([] if k in hidden else pixels), rng.uniform((0, 0), (640, 480), (clutter, 2))])
        images.append(image[rng.permutation(len(image))])
    return images
