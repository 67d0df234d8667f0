"""Simulated flights of a headset: how many frames are right, and how long each takes.

    python benchmarks/tracking.py --flights 10 --first-seed 20000
    python benchmarks/tracking.py --flights 1 --frames 60000 --memory

A headset of 32 sensors moves before a camera of 1280 × 960 px for 600 frames at 60 Hz: turns of up to 60 degrees about
each axis and 0.5 m in each direction, each the sum of three sines below 0.8 Hz; a sensor is seen within 70 degrees of
its normal, with 0.5 px of noise and 5 clutter points. Twice in 10 s all of it is hidden for 10 frames, twice a random
half is. The headset comes from ``constellations.py``, see benchmarks/constellations.py.

"right": of the frames with four visible sensors or more, those with no match wrong and nine tenths of the visible ones
matched; "listed": right, or called ambiguous with such an assignment among the first five alternatives. "runs of
wrong": frames one after another that are called matched and have a wrong match. Times are processor
milliseconds a frame of one thread, all kernels compiled; the first frame of each flight is told apart.
"""

from __future__ import annotations

import resource
from dataclasses import dataclass
from functools import partial
from types import ModuleType

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shared import is_listed, judge, parser, scenes_of, timed

import rootmatch as rm

RATE, NOISE, CLUTTER, VIEW = 60.0, 0.5, 5, 70.0
CYCLE, HIDDEN = 150, 10
"""Frames from one occlusion to the next, and of one."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Flight:
    """A motion: amplitudes, frequencies (Hz) and phases (6, 3) of three rotations and three translations."""

    amplitude: Floats
    frequency: Floats
    phase: Floats
    start: Rotation
    distance: float
    focal: float

    def pose(self, seconds: float) -> tuple[Floats, Floats]:
        """Rotation and translation at a time."""
        waves = self.amplitude * np.sin(2.0 * np.pi * self.frequency * seconds + self.phase)
        moved = waves.sum(axis=1)
        R = (Rotation.from_rotvec(moved[:3]) * self.start).as_matrix()
        return R, moved[3:] + np.array([0.0, 0.0, self.distance])


def flight(seed: int) -> Flight:
    """The motion of one seed."""
    rng = np.random.default_rng([seed, 18])
    amplitude = rng.uniform(0.2, 1.0, (6, 3))
    amplitude *= (np.array([1.05] * 3 + [0.4, 0.3, 0.5]) / amplitude.sum(axis=1))[:, None]
    frequency, phase = rng.uniform(0.05, 0.8, (6, 3)), rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    start = Rotation.random(random_state=np.random.RandomState(seed))
    return Flight(amplitude, frequency, phase, start, rng.uniform(1.0, 1.6), rng.uniform(600.0, 900.0))


def frame(scenes: ModuleType, made: Flight, seed: int, k: int) -> tuple[Floats, NDArray[np.int64]]:
    """Detections of frame k, and the truth."""
    rng = np.random.default_rng([seed, k, 19])
    R, t = made.pose(k / RATE)
    X, n = scenes.HEADSET @ R.T + t, scenes.NORMALS @ R.T
    size = np.array([scenes.W, scenes.H])
    pixels = X[:, :2] / X[:, 2:] * made.focal + size / 2
    cosine = -(n * X).sum(axis=1) / np.linalg.norm(X, axis=1) / np.linalg.norm(n, axis=1)
    seen = (
        (X[:, 2] > 0.05) & (cosine > np.cos(np.radians(VIEW))) & (pixels > 0).all(axis=1) & (pixels < size).all(axis=1)
    )
    turn, within = divmod(k, CYCLE)
    if within >= CYCLE - HIDDEN:
        half = np.random.default_rng([seed, turn, 20]).random(len(X)) < 0.5
        seen &= half if turn % 2 else False
    pixels = pixels + rng.normal(0.0, NOISE, pixels.shape)
    index = np.flatnonzero(seen)
    target = np.vstack([pixels[index], rng.uniform((0.0, 0.0), size, (CLUTTER, 2))])
    order = rng.permutation(len(target))
    truth = np.full(len(X), -1)
    truth[index] = np.argsort(order)[: len(index)]
    return target[order], truth


@dataclass
class Tally:
    """What came of some flights."""

    frames: int = 0
    shown: int = 0
    right: int = 0
    listed: int = 0
    wrong: int = 0
    longest: int = 0
    searched: int = 0


def main() -> None:
    ask = parser(__doc__, flights=3, frames=600, first_seed=1000)
    ask.add_argument("--scenes", help="folder of the scenes' module")
    ask.add_argument("--max-seconds", type=float, help="bound of each search")
    ask.add_argument("--memory", action="store_true", help="print the memory every 10,000 frames and at the end")
    ask.add_argument("--verbose", action="store_true", help="a line for each frame that is not right")
    given = ask.parse_args()
    numba.set_num_threads(1)
    scenes = scenes_of("constellations", given.scenes)
    if scenes is None:
        return
    tally, times, first = Tally(), [], []
    for seed in range(given.first_seed - 1, given.first_seed + given.flights):
        made = flight(seed)
        camera = rm.Camera(made.focal, made.focal, scenes.W / 2, scenes.H / 2)
        tracker = rm.Tracker(
            scenes.HEADSET, rm.P3P(camera), noise=NOISE, normals=scenes.NORMALS, view_angle=np.radians(VIEW),
            max_seconds=given.max_seconds,
        )  # fmt: skip
        warming = seed < given.first_seed
        run = 0
        for k in range(20 if warming else given.frames):
            target, truth = frame(scenes, made, seed, k)
            match, seconds = timed(partial(tracker.update, target))
            if warming:
                continue
            _, wrong, full = judge(match.assignment, truth)
            (times if k else first).append(1e3 * seconds)
            shown = int((truth >= 0).sum()) >= 4
            tally.frames += 1
            tally.shown += shown
            tally.right += shown and full
            tally.listed += shown and is_listed(match, truth)
            bad = match.status is rm.Status.MATCHED and wrong > 0
            tally.wrong += bad
            run = run + 1 if bad else 0
            tally.longest = max(tally.longest, run)
            tally.searched += match.evaluated > 0
            if given.verbose and ((shown and not full) or bad or seconds > 0.05):
                print(
                    f"  {seed} frame {k}: {match.status.name.lower()}, {tracker.state.name.lower()}, {wrong} wrong, "
                    f"{int((truth >= 0).sum())} visible, {match.evaluated} hyper-edges, {1e3 * seconds:.1f} ms",
                    flush=True,
                )
            if given.memory and (k % 10_000 == 0 or k == given.frames - 1):
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
                with open("/proc/self/statm") as file:
                    now = int(file.read().split()[1]) * resource.getpagesize() / 2**20
                print(f"  frame {k}: {now:.1f} MiB resident, peak {peak:.1f} MiB", flush=True)
    print(
        f"{given.flights} flights, {tally.frames} frames: right {tally.right} of {tally.shown} with four visible "
        f"or more ({100.0 * tally.right / tally.shown:.2f} %), listed {tally.listed}; matched and wrong {tally.wrong}, "
        f"longest run {tally.longest}; "
        f"searched {tally.searched}; ms a frame: median {np.median(times):.2f}, 99 % {np.quantile(times, 0.99):.1f}, "
        f"worst {max(times):.1f}, first frame {np.median(first):.0f}"
    )


if __name__ == "__main__":
    main()
