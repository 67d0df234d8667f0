"""Flights of a body whose model is not exact: whether poses stay as certain as they are, frame after frame.

    python benchmarks/inexact_flights.py --families one two turns fisheye --seeds 150 --first-seed 97000

A headset of 24 LEDs, .2 m wide and .8 m away, whose model is good to 1 mm and says so (``source_noise=``); 97 % of the
LEDs that face a camera are detected to .3 px with a focal length of 700 px, among three strays, 60 times a second.
Seen by one camera, by two, by a fisheye, or with either half of the LEDs dark for six frames in turn. The first frame
has a vague prior in the place of a search. "Covered": the squared error of the pose over its covariance is below its
95 % quantile, in trusted frames. Defaults were chosen on seeds below 2000.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation
from shared import Floats, head, parser, row, squared_error

import rootmatch as rm
from rootmatch.cameras.kannala_brandt import KannalaBrandt

FRAMES = (1, 2, 5, 10, 20, 40, 100)
LEDS, MODEL, PIXEL, DETECTED, STRAYS, FACING = 24, 1e-3, 0.3, 0.97, 3, np.cos(np.radians(72.0))
QUANTILE = 12.592
"""95 % of χ² with six degrees of freedom."""
CAMERA = rm.Camera(700.0, 700.0, 640.0, 480.0)
FISHEYE = rm.Camera(400.0, 400.0, 640.0, 480.0, KannalaBrandt((-0.01, 0.002, 0.0, 0.0)))
HERE, ASIDE = (np.eye(3), np.zeros(3)), (Rotation.from_euler("y", 25.0, degrees=True).as_matrix(), [-0.3, 0.0, 0.05])
FAMILIES = {
    "one": [(CAMERA, *HERE)],
    "two": [(CAMERA, *HERE), (CAMERA, *ASIDE)],
    "fisheye": [(FISHEYE, *HERE)],
    "turns": [(CAMERA, *HERE)],
}
AWAY = np.array([0.0, 0.0, 0.8])
VAGUE = np.diag([0.15**2] * 3 + [0.04**2] * 3)


def smooth(rng: np.random.Generator, size: float) -> Callable[[float], Floats]:
    """A movement (3,) of some size over time, of three frequencies up to .8 Hz."""
    frequency, phase = rng.uniform(0.15, 0.8, (3, 3)), rng.uniform(0.0, 6.28, (3, 3))
    each = size * rng.uniform(0.3, 1.0, (3, 3)) / np.sqrt(3.0)
    return lambda t: np.asarray((each * np.sin(2.0 * np.pi * frequency * t + phase)).sum(axis=0))


def flight(family: str, seed: int) -> tuple[dict[int, float], list[float], list[float]]:
    """Squared errors at `FRAMES`, errors of the position and seconds of each frame that is trusted."""
    rng, views = np.random.default_rng(seed), FAMILIES[family]
    normals = rng.normal(size=(LEDS, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    model = normals * (0.1, 0.06, 0.09) + rng.normal(0.0, 0.003, (LEDS, 3))
    made = model + rng.normal(0.0, MODEL, model.shape)
    start, place, turn = Rotation.random(random_state=seed), smooth(rng, 0.15), smooth(rng, 1.2)
    problem = rm.P3P(views[0][0] if len(views) == 1 else rm.Rig(views))
    tracker = rm.Tracker(model, problem, noise=PIXEL, normals=normals, source_noise=MODEL)
    squared, errors, seconds = {}, [], []
    for k in range(max(FRAMES)):
        R, t = (Rotation.from_rotvec(turn(k / 60.0)) * start).as_matrix(), place(k / 60.0) + AWAY
        images = []
        for camera, rotation, translation in views:
            there = (made @ R.T + t) @ rotation.T + translation
            cosine = -((normals @ R.T @ rotation.T) * there).sum(axis=1) / np.linalg.norm(there, axis=1)
            shown = (cosine > FACING) & (rng.random(LEDS) < DETECTED)
            if family == "turns":
                shown &= np.arange(LEDS) % 2 == k // 6 % 2
            pixels = camera.project(there)[shown] + rng.normal(0.0, PIXEL, (int(shown.sum()), 2))
            images.append(np.vstack([pixels, rng.uniform((0.0, 0.0), (1280.0, 960.0), (STRAYS, 2))]))
        target = np.vstack(images)
        seen = target if len(views) == 1 else (target, np.repeat(np.arange(len(views)), list(map(len, images))))
        prior = None
        if k == 0:
            off, moved = Rotation.from_rotvec(rng.normal(0.0, 0.15, 3)).as_matrix(), rng.normal(0.0, 0.04, 3)
            prior = rm.Pose(off @ R, t + moved, VAGUE)
        started = time.process_time()
        match = tracker.update(seen, time=1.0 + k / 60.0, prior=prior)
        seconds.append(time.process_time() - started)
        if match and match.pose is not None:
            errors.append(float(np.linalg.norm(t - match.pose.t)))
            if k + 1 in FRAMES:
                squared[k + 1] = squared_error(match.pose, R, t)
    return squared, errors, seconds[10:]


def main() -> None:
    """Print one row for each family."""
    ask = parser(__doc__, seeds=30, first_seed=1000)
    ask.add_argument("--families", nargs="+", default=list(FAMILIES), choices=FAMILIES)
    given = ask.parse_args()
    head("flights", "number", "trusted", *(f"frame {k}" for k in FRAMES), "position, mm", "ms")
    for family in given.families:
        every = [flight(family, seed) for seed in range(given.first_seed, given.first_seed + given.seeds)]
        each = [np.array([one[k] for one, _, _ in every if k in one]) for k in FRAMES]
        errors, seconds = (np.concatenate([one[k] for one in every]) for k in (1, 2))
        row(
            family, given.seeds, f"{len(errors) / (given.seeds * max(FRAMES)):.3f}",
            *(f"{(some < QUANTILE).mean():.3f}" for some in each), f"{1e3 * np.median(errors):.2f}",
            f"{1e3 * np.median(seconds):.2f}",
        )  # fmt: skip


if __name__ == "__main__":
    main()
