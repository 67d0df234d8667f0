"""Random scenes of rigs, for `adversary.py --rigs`: two to four cameras that see one or two bodies at once.

Bodies, lenses and clutter are drawn as there. Another body and a stretched copy are things in the world, at the same
place for all cameras; uniform and crowded clutter is drawn in each image by itself. In half of the scenes the sizes of
the images are told.
"""

from __future__ import annotations

import numpy as np
from adversary import (
    SIZE,
    VIEW,
    Scene,
    arguments_of,
    drawn_clutter,
    lens,
    shapes,
    stranger,
    tilted_vertical,
)
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shared import Floats

import rootmatch as rm

View = tuple[rm.Camera, Floats, Floats]


def drawn(seed: int) -> Scene:
    """The scene of a seed; truths are those of sightings, camera by camera."""
    rng = np.random.default_rng([seed, 78])
    kind, clutter, bodies, normals = shapes(rng)
    sigma, facing = float(np.exp(rng.uniform(np.log(0.1), np.log(2.0)))), bool(rng.random() < 0.6)
    views = [_view(rng) for _ in range(int(rng.integers(2, 5)))]
    sizes = [SIZE] * len(views) if rng.random() < 0.5 else None
    absent, rate, count = rng.random() < 0.1, rng.choice([1.0, 0.9, 0.7]), int(rng.choice([0, 2, 5, 10]))
    poses, present = [], []
    for b in range(len(bodies)):
        R = Rotation.random(random_state=rng).as_matrix()
        poses.append((R, np.array([rng.uniform(-0.25, 0.25), rng.uniform(-0.2, 0.2), rng.uniform(0.4, 2.0)])))
        present.append(not (absent or (b and rng.random() < 0.5)))
    of_things = clutter in ("another body", "a stretched copy")
    things = stranger(rng, clutter, bodies[0]) if of_things else np.empty((0, 3))
    rows: list[tuple[float, float, int]] = []
    owners: list[tuple[int, int, int] | None] = []
    for k, (camera, Q, s) in enumerate(views):
        for b, body in enumerate(bodies):
            if not present[b]:
                continue
            R, t = poses[b]
            places = (body @ R.T + t) @ Q.T + s
            seen = (rng.random(len(body)) < rate) & (places[:, 2] > 0.05)
            if facing:
                cosine = -((normals[b] @ R.T @ Q.T) * places).sum(axis=1) / np.linalg.norm(places, axis=1)
                seen &= cosine > np.cos(VIEW)
            image = camera.project(places)
            for i in np.flatnonzero(seen & _inside(image)).tolist():
                rows.append((*image[i], k))
                owners.append((b, k, i))
        for pixel in _clutter_of(rng, clutter, count, camera, things @ Q.T + s):
            rows.append((*pixel, k))
            owners.append(None)
    target = np.array(rows).reshape(-1, 3)
    target[:, :2] += rng.normal(0.0, sigma, (len(target), 2))
    order = rng.permutation(len(target))
    truths: list[list[set[int]]] = [[set() for _ in range(len(views) * len(body))] for body in bodies]
    for place, j in enumerate(order.tolist()):
        if (owner := owners[j]) is not None:
            b, k, i = owner
            truths[b][k * len(bodies[b]) + i].add(place)
    rig = rm.Rig(views, sizes=sizes)
    problem: rm.Problem = rm.P3P(rig)
    if rng.random() < 0.3 and len(bodies) == 1:
        problem = tilted_vertical(rng, rig, poses[0][0])
    arguments = arguments_of(bodies, target[order], problem, sigma, seed, normals if facing else None)
    return Scene((kind, clutter), arguments, truths, poses)


def _view(rng: np.random.Generator) -> View:
    """A camera of a rig, up to 40° and some decimetres from its frame."""
    camera = lens() if rng.random() < 0.5 else rm.Camera(900.0, 900.0, 640.0, 480.0)
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * rng.uniform(0.0, np.radians(40.0)))
    return camera, turn.as_matrix(), rng.uniform(-0.12, 0.12, 3)


def _inside(image: Floats) -> NDArray[np.bool_]:
    return np.asarray(((image > 0) & (image < SIZE)).all(axis=1))


def _clutter_of(rng: np.random.Generator, kind: str, count: int, camera: rm.Camera, things: Floats) -> Floats:
    """Pixels of clutter in one image; ``things`` (m, 3): those of the world, in the frame of the camera."""
    if not len(things):
        return drawn_clutter(rng, kind, count)
    image = camera.project(things[things[:, 2] > 0.05])
    return np.asarray(image[_inside(image)])
