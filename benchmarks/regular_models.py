"""Regular models of which an image shows a part: how many matches are trusted, and how many of these are wrong.

    python benchmarks/regular_models.py --seeds 60 --first-seed 79000

``hall``: lamps on a grid of 6 by 4, a fifth of them missing, seen from 1.6 m below within 62° of the vertical: nine to
twelve are in view. ``ceiling``: 14 by 10 of them. Both exactly on their grid, or off it by some centimetres.
``runway``: two rows of forty lamps 60 m apart, from an aircraft on its approach or above them, which sees no farther
than 900 m. ``railway``: masts every 50 m on both sides, half a metre off, each with three marks, and eight signals,
from a train. ``power line``: ten equal towers 300 m apart with six lamps each; ``stairs``: twenty equal steps with
three lamps; ``corridor``: four random marks, the same twenty times a metre apart; all seen lengthwise, from anywhere
along them, as far as the image goes or up to a distance, with four other detections. What is exactly regular has a
rival a period away wherever no hole tells. The vertical is exact (up2p), known to a degree (up2p 1°), or not known
(p3p).

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
INSIDE = rm.Camera(900.0, 900.0, 640.0, 480.0, size=(1280, 960))


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


def along_railway(rng: np.random.Generator) -> Scene:
    """Marks on the masts of a railway, from a train; up to seven other detections."""
    places = np.stack(np.meshgrid(np.arange(20.0, 320.0, 50.0), (-3.5, 7.5)), axis=-1).reshape(-1, 2)
    places[:, 0] += rng.normal(0.0, 0.5, len(places))
    towards = -np.sign(places[:, 1])
    masts = [np.column_stack([places, np.full(len(places), height)]) for height in (5.5, 7.0)]
    masts.append(np.column_stack([places[:, 0], places[:, 1] + 2.5 * towards, np.full(len(places), 6.0)]))
    signals = rng.uniform((25.0, -9.0, 0.5), (200.0, 12.0, 5.0), (8, 3))
    marks = np.concatenate([*masts, signals])
    place = np.array([rng.uniform(-5.0, 15.0), rng.normal(0.0, 0.2), 3.0])
    turn = Rotation.from_euler("ZYX", [rng.normal(0.0, 0.03), rng.normal(-0.03, 0.02), rng.normal(0.0, 0.01)])
    forward, left, up = turn.as_matrix().T
    R = np.array([-left, -up, forward])
    away = (marks - place) @ R.T
    image = AHEAD.project(np.where(away[:, 2:] > 1.0, away, 1.0))
    shown = (
        (away[:, 2] > 1.0) & (image > 0.0).all(axis=1) & (image < SIZE).all(axis=1) & (rng.random(len(marks)) < 0.85)
    )
    scene = seen(rng, marks, image, shown, AHEAD, R[:, 2])
    low, high = scene.target.min(axis=0), scene.target.max(axis=0)
    return scene._replace(target=np.concatenate([scene.target, rng.uniform(low, high, (rng.integers(0, 8), 2))]))


def along_row(
    rng: np.random.Generator, units: Floats, place: tuple[float, float, float], pitch: float, sight: float = np.inf
) -> Scene:
    """Lamps of equal units (…, 3) along x, from a camera that looks along it; four other detections."""
    lamps = units.reshape(-1, 3)
    turn = Rotation.from_euler("ZY", [rng.uniform(-0.2, 0.2), pitch])
    forward, left, up = turn.as_matrix().T
    R = np.array([-left, -up, forward])
    away = (lamps - place) @ R.T
    image = INSIDE.project(np.where(away[:, 2:] > 0.05, away, 1.0))
    shown = (away[:, 2] > 0.05) & (image > 0.0).all(axis=1) & (image < INSIDE.size).all(axis=1)
    shown &= (np.linalg.norm(away, axis=1) < sight) & (rng.random(len(lamps)) < 0.85)
    scene = seen(rng, lamps, image, shown, INSIDE, R[:, 2])
    return scene._replace(target=np.concatenate([scene.target, rng.uniform((0.0, 0.0), INSIDE.size, (4, 2))]))


def power_line(rng: np.random.Generator, sight: float = np.inf) -> Scene:
    """Ten towers, from a drone between them."""
    tower = [(0, -5, 20), (0, 4, 21), (0, -7, 26), (0, 8, 25), (0, -4, 32), (0, 3, 31)]
    units = np.array(tower, float) + 300.0 * np.arange(10)[:, None, None] * [1.0, 0.0, 0.0]
    return along_row(rng, units, (rng.uniform(-300.0, 2400.0), rng.uniform(-60.0, 60.0), 1.7), -0.1, sight)


def up_stairs(rng: np.random.Generator, sight: float = np.inf) -> Scene:
    """Twenty steps, from someone who climbs them."""
    step = [(0.0, -1.0, 0.3), (0.0, 1.0, 0.3), (0.0, -1.0, 1.2)]
    units = np.array(step) + np.arange(20)[:, None, None] * [0.9, 0.0, 0.5]
    x, y, eyes = rng.uniform(-2.0, 16.0), rng.uniform(-0.4, 0.4), rng.uniform(1.5, 1.9)
    return along_row(rng, units, (x, y, max(x, 0.0) * 0.5 / 0.9 + eyes), -0.26, sight)


def down_corridor(rng: np.random.Generator, sight: float = np.inf) -> Scene:
    """Twenty metres, each with the same four marks on its walls."""
    sides = rng.choice([-1.0, 1.0], 4) * rng.uniform(0.5, 2.0, 4)
    marks = np.column_stack([rng.uniform(-0.4, 0.4, 4), sides, rng.uniform(0.0, 2.5, 4)])
    units = marks + np.arange(20)[:, None, None] * [1.0, 0.0, 0.0]
    return along_row(rng, units, (rng.uniform(-1.0, 18.0), rng.uniform(-0.3, 0.3), 1.2), 0.0, sight)


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
    "railway": along_railway,
    "power line": power_line,
    "power line, up to 900 m": lambda rng: power_line(rng, 900.0),
    "stairs": up_stairs,
    "stairs, up to 7 m": lambda rng: up_stairs(rng, 7.0),
    "corridor": down_corridor,
    "corridor, up to 7 m": lambda rng: down_corridor(rng, 7.0),
}
TILT = np.radians(1.0)


def problem_of(name: str, given: Scene, seed: int) -> rm.P3P | rm.UP2P:
    """The problem of a scene with a vertical that is exact, measured, or unknown."""
    if name == "p3p":
        return rm.P3P(given.camera)
    if name == "up2p":
        return rm.UP2P(given.camera, vertical_camera=given.upwards, vertical_world=(0.0, 0.0, 1.0))
    off = Rotation.from_rotvec(np.random.default_rng([seed, 1]).normal(0.0, TILT, 3)).as_matrix()
    return rm.UP2P(given.camera, off @ given.upwards, (0.0, 0.0, 1.0), vertical_noise=TILT)


def main() -> None:
    """Print one row for each kind and problem."""
    ask = parser(__doc__, seeds=20, first_seed=1000)
    ask.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    given = ask.parse_args()
    head("kind", "problem", "images", "trusted", "wrong", "ambiguous", "median s")
    for kind in given.kinds:
        make = KINDS[kind]
        for name in ("up2p", "up2p 1°", "p3p"):
            told, wrong, times = list[rm.Status](), list[int](), list[float]()
            for seed in range(given.first_seed, given.first_seed + given.seeds):
                scene = make(np.random.default_rng([seed, *kind.encode()]))
                if len(scene.target) < 6:
                    continue
                started = time.process_time()
                match = rm.match(scene.lamps, scene.target, problem_of(name, scene, seed), noise=NOISE, seed=seed)
                times.append(time.process_time() - started)
                told.append(match.status)
                wrong += [seed] if match and judge(match.assignment, scene.truth)[1] else []
            counts = [told.count(one) for one in (rm.Status.MATCHED, rm.Status.AMBIGUOUS)]
            row(kind, name, len(told), counts[0], f"{len(wrong)} {wrong}", counts[1], f"{np.median(times):.3f}")


if __name__ == "__main__":
    main()
