"""Scenes that are drawn from the model's own priors (docs/model.md): rows of `together.py`.

Drawn are whether the body is in view, its pose, the factor on σ, the detection rate, what is hidden as a whole, the
number of clutter points, and uniform clutter. What is told of them has to be right; elsewhere it is as right as the
priors are. Not drawn are what is too small, points that are off, copies and crowds.
"""

from __future__ import annotations

import zlib
from typing import Any

import adversary
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import gammaln
from shared import Floats

import rootmatch as rm

SIZE, FOCAL = 1280.0, 667.0
"""Of an image that fills 2 sr, as the prior of positions does."""
NEAREST, FARTHEST = 2.0, 200.0
"""Distances of a drawn body, over its root mean square radius: a factor of 100."""
VIEW, SLOPE, EDGE = np.radians(70.0), 1.702, 0.03
"""View angle, and the logistic curve of its edge in cosines."""
MAXIMUM = 16
"""Largest number of clutter points that are drawn; scenes with more detections in an image are left out, as the model
allows for more of them."""
PRESENT, HIDDEN = 0.8, 0.05
KINDS = "P3P", "P3P normals", "UP2P", "UP2P normals", "bodies", "bodies normals", "rig", "rig normals"


def body(rng: np.random.Generator, minimum: int = 4) -> tuple[Floats, Floats]:
    """Points (n, 3) in a ball, and normals that point away from its centre."""
    n = int(rng.integers(minimum, 13))
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * np.cbrt(rng.uniform(0.2, 1.0, (n, 1)))
    return points - points.mean(axis=0), directions


def place(rng: np.random.Generator, points: Floats) -> tuple[Floats, Floats]:
    """Any pose of a body about its centre, in the field of the camera."""
    radius = float(np.sqrt((points**2).sum(axis=1).mean()))
    pixel = rng.uniform(0.0, SIZE, 2)
    while True:  # directions are uniform in solid angle
        ray = np.array([*((pixel - SIZE / 2) / FOCAL), 1.0])
        if rng.random() < np.linalg.norm(ray) ** -3:
            break
        pixel = rng.uniform(0.0, SIZE, 2)
    distance = radius * np.exp(rng.uniform(np.log(NEAREST), np.log(FARTHEST)))
    return Rotation.random(random_state=rng).as_matrix(), distance * ray / np.linalg.norm(ray)


def hidden(rng: np.random.Generator, pixels: Floats, seen: np.ndarray) -> np.ndarray:
    """Points that are hidden together: those beyond an edge, or all but a window about any three of them."""
    out = np.zeros(len(seen), np.bool_)
    chance, places = rng.random(), np.flatnonzero(seen)
    if chance < HIDDEN and len(places):
        angle = rng.integers(8) * np.pi / 4
        along = pixels @ (np.cos(angle), np.sin(angle))
        out = along >= along[rng.choice(places)] - 1e-9
    elif chance < 2.0 * HIDDEN and len(places) >= 3:
        three = pixels[rng.choice(places, 3, replace=False)]
        middle = np.linalg.solve(2.0 * (three[1:] - three[0]), (three[1:] ** 2 - three[0] ** 2).sum(axis=1))
        reach = np.linalg.norm(three[0] - middle)
        out = np.linalg.norm(pixels - middle, axis=1) > reach + 1e-6
    return out


def clutter_count(rng: np.random.Generator) -> int:
    """Number of clutter points under Jeffreys' prior of their rate, up to `MAXIMUM`."""
    counts = np.arange(MAXIMUM + 1)
    weights = np.exp(gammaln(counts + 0.5) - gammaln(counts + 1.0))
    return int(rng.choice(counts, p=weights / weights.sum()))


def drawn(seed: int, kind: str) -> tuple[dict[str, Any], list[list[set[int]]]] | None:
    """Arguments of `rootmatch.match` of a scene of a kind, and the detections of each point, or sighting, of each body.

    None if it has too few detections, or more than are drawn.
    """
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    facing, several, turns = "normals" in kind, 2 if "bodies" in kind else 1, "UP2P" in kind
    views = [(rm.Camera(FOCAL, FOCAL, SIZE / 2, SIZE / 2, size=(SIZE, SIZE)), np.eye(3), np.zeros(3))]
    if "rig" in kind:
        turn = Rotation.from_rotvec((0.0, rng.uniform(-0.3, 0.3), 0.0)).as_matrix()
        views.append((views[0][0], turn, np.array([rng.uniform(-4.0, 4.0), 0.0, 0.0])))
    bodies = [body(rng) for _ in range(several)]
    sigma = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
    noise = sigma * np.sqrt(1.0 / rng.gamma(10.0, 0.1))
    truths = [[set() for _ in range(len(views) * len(points))] for points, _ in bodies]
    poses = [place(rng, points) for points, _ in bodies]
    rates = [rng.beta(9.0, 1.0) if facing else rng.uniform() for _ in bodies]
    present = rng.random(several) < PRESENT
    rows: list[tuple[float, ...]] = []
    owners: list[tuple[int, int] | None] = []
    for k, (camera, turn, shift) in enumerate(views):
        for b, (points, normals) in enumerate(bodies):
            R, t = poses[b]
            places = (points @ R.T + t) @ turn.T + shift
            pixels = camera.project(places)
            seen = (places[:, 2] > 0.0) & (pixels > 0.0).all(axis=1) & (pixels < SIZE).all(axis=1)
            if facing:
                cosine = -((normals @ R.T @ turn.T) * places).sum(axis=1) / np.linalg.norm(places, axis=1)
                seen &= rng.random(len(points)) < 1.0 / (1.0 + np.exp(-SLOPE * (cosine - np.cos(VIEW)) / EDGE))
            seen &= ~hidden(rng, pixels, seen)
            seen &= (rng.random(len(points)) < rates[b]) & present[b]
            for i in np.flatnonzero(seen).tolist():
                rows.append((*(pixels[i] + noise * rng.normal(size=2)), k))
                owners.append((b, k * len(points) + i))
        count = clutter_count(rng)
        rows += [(*rng.uniform(0.0, SIZE, 2), k) for _ in range(count)]
        owners += [None] * count
    target = np.array(rows).reshape(-1, 3)
    if len(target) < 4 or np.bincount(target[:, 2].astype(int)).max() > MAXIMUM:
        return None
    order = rng.permutation(len(target))
    for at, j in enumerate(order.tolist()):
        if (owner := owners[j]) is not None:
            truths[owner[0]][owner[1]].add(at)
    camera = rm.Rig(views, sizes=[(SIZE, SIZE)] * 2) if len(views) > 1 else views[0][0]
    problem: rm.Problem = adversary.tilted_vertical(rng, camera, poses[0][0]) if turns else rm.P3P(camera)
    target = target[order] if len(views) > 1 else target[order, :2]
    given = {"source": np.concatenate([points for points, _ in bodies]), "target": target, "problem": problem}
    given |= {"noise": sigma, "seed": seed}
    if facing:
        given |= {"normals": np.concatenate([normals for _, normals in bodies]), "view_angle": VIEW}
    if several > 1:
        given["bodies"] = np.repeat(np.arange(several), [len(points) for points, _ in bodies])
    return given, truths
