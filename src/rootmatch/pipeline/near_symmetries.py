"""Near symmetries of a body: rotations that put many of its points onto others of it, as half a turn does a headset's.

From some side a pose and the same pose after such a motion show nearly the same image. A search that is cut short may
find either alone; knowing the motions, the other one is asked for.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.pipeline.motion_filter import body_radius
from rootmatch.samplers.point_sets.motions import fitted_motions

Floats = NDArray[np.float64]

TOLERANCE = 0.01
"""Distance between a point's image and another point, over the body's radius, up to which they are the same. A round
value: the radius of a headset is 10 cm, and the halves of the one in benchmarks/tracking.py differ by 0.22 mm."""
LEAST, SHARE = 6, 0.25
"""Points that have to be mapped, and part of all: with fewer hardly a side shows nothing else. Round values."""
ANGLE = 0.2
"""Least angle, in radians, of a motion that is not the identity. A round value."""
FACING = 0.8
"""Least cosine between the normals of a point's image and of the point there. A round value."""
THIRDS = 3
"""Third points that are tried with each pair; one of them should be mapped as well. A round value."""
MOST_POINTS = 64
"""Points beyond which none are sought: the pairs of pairs grow with their fourth power."""


def near_symmetries(source: Floats, normals: Floats | None, most: int) -> list[tuple[Floats, Floats]]:
    """Motions (R, t), x' = R x + t, that map a quarter of a body's points onto others, those that map most first.

    Each pair of points is laid onto each pair as far apart, a third point tells the angle about them, and what fits is
    counted and fitted again.

    Parameters
    ----------
    source : (n, 3) array
    normals : (n, 3) array, optional
        A point is mapped onto one that faces alike only.
    most : int
        Motions that are returned.
    """
    n = len(source)
    if not LEAST <= n <= MOST_POINTS:
        return []
    radius = body_radius(source)
    near, least = TOLERANCE * radius, max(LEAST, SHARE * n)
    distance = np.linalg.norm(source[:, None] - source, axis=2)
    first, second = np.nonzero(np.triu(distance > 0.5 * radius))
    rows = []
    rng = np.random.default_rng(0)
    for _ in range(THIRDS):
        third = rng.integers(0, n, len(first))
        for a, b, c in zip(first.tolist(), second.tolist(), third.tolist(), strict=True):
            if distance[a, c] < 0.5 * radius or distance[b, c] < 0.5 * radius:
                continue
            k, j = np.nonzero(np.abs(distance - distance[a, b]) < near)
            here, m = np.nonzero(
                (np.abs(distance[k] - distance[a, c]) < near) & (np.abs(distance[j] - distance[b, c]) < near)
            )
            rows.append(np.column_stack([np.broadcast_to((a, b, c), (len(m), 3)), k[here], j[here], m]))
    triples = np.concatenate(rows) if rows else np.empty((0, 6), np.int64)
    triples = triples[(triples[:, :3] != triples[:, 3:]).any(axis=1)]
    motions = fitted_motions(source[triples[:, :3]], source[triples[:, 3:]], scaled=False, mirror=False)
    found: list[tuple[int, Floats, Floats]] = []
    for rotation, shift in zip(motions.linear, motions.shift, strict=True):
        if _alike(rotation, np.eye(3)) or any(_alike(rotation, one) for _, one, _ in found):
            continue
        count, image = _mapped(source, normals, rotation, shift, near)
        if count < least:
            continue
        own = np.flatnonzero(image >= 0)
        refined = fitted_motions(source[None, own], source[None, image[own]], scaled=False, mirror=False)
        R, t = refined.linear[0], refined.shift[0]
        count, _ = _mapped(source, normals, R, t, near)
        if count >= least and not any(_alike(R, one) for _, one, _ in found):
            found.append((count, R, t))
    found.sort(key=lambda one: -one[0])
    return [(rotation, shift) for _, rotation, shift in found[:most]]


def _mapped(source: Floats, normals: Floats | None, R: Floats, t: Floats, near: float) -> tuple[int, NDArray[np.int64]]:
    """How many points a motion maps onto others, and onto which, −1 for none."""
    off = np.linalg.norm((source @ R.T + t)[:, None] - source, axis=2)
    possible = off < near
    if normals is not None:
        length = np.linalg.norm(normals, axis=1)
        cosine = (normals @ R.T) @ normals.T
        possible &= cosine >= FACING * length[:, None] * length
    image = np.where(possible.any(axis=1), np.where(possible, off, np.inf).argmin(axis=1), -1)
    return int((image >= 0).sum()), image


def _alike(first: Floats, second: Floats) -> bool:
    return float((first * second).sum()) > 1.0 + 2.0 * math.cos(ANGLE)
