"""Regular models of which an image shows a part: how many matches are trusted, and how many of these are wrong.

    python benchmarks/regular_models.py --seeds 60 --first-seed 79000

``hall``: lamps on a grid of 6 by 4, a fifth of them missing, seen from 1.6 m below within 62° of the vertical: nine to
twelve are in view. ``ceiling``: 14 by 10 of them. Both exactly on their grid, or off it by some centimetres; with the
vertical exact (up2p) or not known (p3p). ``runway``: two rows of forty lamps 60 m apart, from an aircraft on its
approach or above them, which sees no farther than 900 m. What is exactly regular has a rival a period away wherever no
hole tells.

"Right": no match wrong and nine tenths of the visible lamps matched. Defaults were chosen on seeds below 2000.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shared import head, judge, parser, row

import rootmatch as rm

Floats = NDArray[np.float64]

CAMERA = rm.Camera(250.0, 250.0, 640.0, 480.0)
SPACING, HEIGHT, NOISE = np.array([1.2, 1.8]), 2.6, 0.3
AHEAD, SIZE, SIGHT = rm.Camera(1200.0, 1200.0, 960.0, 540.0), (1920.0, 1080.0), 900.0


class Scene(NamedTuple):
    """Lamps (n, 3), detections (n', 2), the detection of each lamp, −1 for none, and what problems are made of."""

    lamps: Floats
    target: Floats
    truth: NDArray[np.int64]
    camera: rm.Camera
    upwards: Floats


def under_ceiling(rng: np.random.Generator, size: tuple[int, int], off: float) -> Scene:
    """Lamps on a grid, from below."""
    grid = SPACING * np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).reshape(-1, 2)
    lamps = np.column_stack([grid + rng.normal(0.0, 1.0, grid.shape) * off, np.full(len(grid), HEIGHT)])
    lamps = lamps[rng.random(len(lamps)) < 0.8]
    c, s = np.cos(angle := rng.uniform(-np.pi, np.pi)), np.sin(angle)
    place = np.append(rng.uniform(0.2, 0.8, 2) * SPACING * size, 1.0)
    image = CAMERA.project((lamps - place) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T)
    shown = np.linalg.norm(image - (640.0, 480.0), axis=1) < 480.0
    return seen(rng, lamps, image, shown, CAMERA, np.array([0.0, 0.0, 1.0]))


def along_runway(rng: np.random.Generator, off: float) -> Scene:
    """Lamps beside a runway, from an aircraft that looks along it."""
    lamps = np.stack(np.meshgrid(60.0 * np.arange(40), (-22.5, 22.5), 0.0), axis=-1).reshape(-1, 3)
    lamps[:, :2] += rng.normal(0.0, 1.0, (len(lamps), 2)) * off
    place = np.array([rng.uniform(-900.0, 900.0), rng.uniform(-8.0, 8.0), rng.uniform(20.0, 80.0)])
    turn = Rotation.from_euler("ZYX", [rng.normal(0.0, 0.05), rng.uniform(0.02, 0.1), rng.normal(0.0, 0.03)])
    forward, left, up = turn.as_matrix().T
    R = np.array([-left, -up, forward])
    away = (lamps - place) @ R.T
    image = AHEAD.project(np.where(away[:, 2:] > 1.0, away, 1.0))
    shown = (away[:, 2] > 1.0) & (image > 0.0).all(axis=1) & (image < SIZE).all(axis=1)
    shown &= (np.linalg.norm(lamps - place, axis=1) < SIGHT) & (rng.random(len(lamps)) < 0.97)
    return seen(rng, lamps, image, shown, AHEAD, R[:, 2])


def seen(
    rng: np.random.Generator, lamps: Floats, image: Floats, shown: NDArray[np.bool_], camera: rm.Camera, up: Floats
) -> Scene:
    """The scene of lamps of which some are shown, in random order."""
    own = rng.permutation(np.flatnonzero(shown))
    truth = np.full(len(lamps), -1)
    truth[own] = np.arange(len(own))
    return Scene(lamps, image[own] + rng.normal(0.0, NOISE, (len(own), 2)), truth, camera, up)


KINDS: dict[str, Callable[[np.random.Generator], Scene]] = {
    "hall": lambda rng: under_ceiling(rng, (6, 4), 0.0),
    "hall, 2 cm off": lambda rng: under_ceiling(rng, (6, 4), 0.02),
    "ceiling": lambda rng: under_ceiling(rng, (14, 10), 0.0),
    "ceiling, 1 cm off": lambda rng: under_ceiling(rng, (14, 10), 0.01),
    "ceiling, 5 cm off": lambda rng: under_ceiling(rng, (14, 10), 0.05),
    "runway": lambda rng: along_runway(rng, 0.0),
    "runway, 30 cm off": lambda rng: along_runway(rng, 0.3),
    "runway, 1 m off": lambda rng: along_runway(rng, 1.0),
}


def problem_of(name: str, given: Scene) -> rm.P3P | rm.UP2P:
    """The problem of a scene with an unknown or an exact vertical."""
    if name == "p3p":
        return rm.P3P(given.camera)
    return rm.UP2P(given.camera, vertical_camera=given.upwards, vertical_world=(0.0, 0.0, 1.0))


def main() -> None:
    """Print one row for each kind and problem."""
    ask = parser(__doc__, seeds=20, first_seed=1000)
    given = ask.parse_args()
    head("kind", "problem", "images", "trusted", "wrong", "ambiguous", "median s")
    for kind, make in KINDS.items():
        for name in ("up2p", "p3p"):
            told, wrong, times = list[rm.Status](), list[int](), list[float]()
            for seed in range(given.first_seed, given.first_seed + given.seeds):
                scene = make(np.random.default_rng([seed, *kind.encode()]))
                if len(scene.target) < 6:
                    continue
                started = time.process_time()
                match = rm.match(scene.lamps, scene.target, problem_of(name, scene), noise=NOISE, seed=seed)
                times.append(time.process_time() - started)
                told.append(match.status)
                wrong += [seed] if match and judge(match.assignment, scene.truth)[1] else []
            counts = [told.count(one) for one in (rm.Status.MATCHED, rm.Status.AMBIGUOUS)]
            row(kind, name, len(told), counts[0], f"{len(wrong)} {wrong}", counts[1], f"{np.median(times):.3f}")


if __name__ == "__main__":
    main()
