"""Bodies that are symmetric, or copies, within the noise of their models or not: what is trusted, and what is told.

    python benchmarks/symmetric_bodies.py --seeds 60 --first-seed 113000

Half of the bodies are exactly symmetric, the others are displaced from that: all points, by a size between the noise of
the model and the body's own, flat in its logarithm; or one point or two, by 3, 5 or 8 σ in a random direction. Of two
copies the second is displaced. Points are measured with σ .5 mm and 85 % of them detected to .3 px with a focal length
of 1500 px, 1 to 1.5 m away, among six points of clutter. "Told": the mean of the probability; "right": the share of
matches that are right. Defaults were chosen on seeds from 1000.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from shared import Calibration, Floats, Integers, head, parser, row

import rootmatch as rm

SIZE = (1280, 960)
CAMERA = rm.Camera(1500.0, 1500.0, 640.0, 480.0, size=SIZE)
PIXEL, MODEL, DETECTED, CLUTTER = 0.3, 0.5, 0.85, 6


def _ring(rng: np.random.Generator) -> Floats:
    """Bolt circles of eight and sixteen."""
    circles = []
    for r, m, z in ((100.0, 8, 0.0), (60.0, 16, rng.uniform(10.0, 40.0))):
        angle = 2.0 * np.pi * np.arange(m) / m
        circles.append(np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(m, z)]))
    return np.concatenate(circles)


def _halves(rng: np.random.Generator) -> Floats:
    """Seven points and the same half a turn on."""
    half = rng.uniform(-100.0, 100.0, (7, 3))
    return np.concatenate([half, half * (-1.0, -1.0, 1.0)])


def _box(rng: np.random.Generator) -> Floats:
    """Three points and the same after half a turn about each of three axes."""
    turns = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    return np.asarray((turns[:, None] * rng.uniform(30.0, 100.0, (3, 3))).reshape(-1, 3))


BODIES: dict[str, Callable[[np.random.Generator], Floats]] = {"ring": _ring, "halves": _halves, "box": _box}


class Scene(NamedTuple):
    """The models of one body or two, detections, and that of each point, or −1."""

    models: list[Floats]
    target: Floats
    truth: list[Integers]


def displaced(points: Floats, how: str, rng: np.random.Generator) -> Floats:
    """Points that are displaced in one of the ways of the rows."""
    if how == "exact":
        return points
    if how == "all":
        size = MODEL * np.exp(rng.uniform(0.0, np.log(100.0 / MODEL)))
        return np.asarray(points + rng.normal(0.0, size, points.shape))
    count, size = (int(one) for one in how.split(" by "))
    off, some = np.zeros(points.shape), rng.permutation(len(points))[:count]
    off[some] = rng.normal(size=(count, 3))
    return np.asarray(points + size * MODEL * off / np.maximum(np.linalg.norm(off, axis=1, keepdims=True), 1e-9))


def scene(name: str, how: str, seed: int) -> Scene:
    """One or two bodies and their image."""
    rng = np.random.default_rng([seed, 31])
    if name == "copies":
        first = rng.uniform(-90.0, 90.0, (10, 3))
        bodies = [first, displaced(first, how, rng)]
    else:
        bodies = [displaced(BODIES[name](rng), how, rng)]
    places, truth = [], []
    for k, points in enumerate(bodies):
        R = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
        t = np.array([200.0 * (k - 0.5 * (len(bodies) - 1)), rng.normal(0.0, 40.0), rng.uniform(1000.0, 1500.0)])
        seen = np.flatnonzero(rng.random(len(points)) < DETECTED)
        truth.append(np.full(len(points), -1))
        truth[-1][seen] = sum(map(len, places)) + np.arange(len(seen))
        places.append(CAMERA.project(points[seen] @ R.T + t))
    places.append(rng.uniform((0.0, 0.0), SIZE, (CLUTTER, 2)))
    target = np.concatenate(places)
    order = rng.permutation(len(target))
    place = np.append(np.argsort(order), -1)
    noisy = (target + rng.normal(0.0, PIXEL, target.shape))[order]
    models = [points + rng.normal(0.0, MODEL, points.shape) for points in bodies]
    return Scene(models, noisy, [place[one] for one in truth])


def main() -> None:
    """Print one row for each body and way in which it is displaced, and how often a probability held."""
    ask = parser(__doc__, seeds=30, first_seed=1000)
    ask.add_argument("--bodies", nargs="+", default=[*BODIES, "copies"], choices=[*BODIES, "copies"])
    given = ask.parse_args()
    calibration = Calibration()
    head("body", "displaced, points by σ", "number", "trusted and right", "trusted and wrong", "told", "right")
    for name in given.bodies:
        for how in ("exact", "all", "1 by 3", "1 by 5", "1 by 8", "2 by 5"):
            told, right, trusted = [], [], []
            for seed in range(given.first_seed, given.first_seed + given.seeds):
                one = scene(name, how, seed)
                labels = np.repeat(np.arange(len(one.models)), [len(points) for points in one.models])
                match = rm.match(
                    np.concatenate(one.models), one.target, rm.P3P(CAMERA), noise=PIXEL, source_noise=MODEL,
                    bodies=labels if len(one.models) > 1 else None,
                )  # fmt: skip
                found = [match] if match.bodies is None else [match.bodies[k] for k in range(len(one.models))]
                for each, truth in zip(found, one.truth, strict=True):
                    told.append(each.probability or 0.0)
                    matched = each.assignment >= 0
                    right.append(bool(matched.any() and (each.assignment == truth)[matched].all()))
                    trusted.append(bool(each))
                if how in ("exact", "all"):
                    calibration.add(zip(told[-len(found) :], right[-len(found) :], strict=True))
            both = np.array(trusted), np.array(right)
            row(
                name, how, len(told), int((both[0] & both[1]).sum()), int((both[0] & ~both[1]).sum()),
                f"{np.mean(told):.3f}", f"{np.mean(right):.3f}",
            )  # fmt: skip
    calibration.print("exact or displaced as a whole, told")


if __name__ == "__main__":
    main()
