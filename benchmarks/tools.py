"""Three tools of 4, 4 and 5 markers among stray points at 100 Hz: tracked, and matched frame by frame, on one thread.

    python benchmarks/tools.py --flights 10 --first-seed 32000
    python benchmarks/tools.py --flights 10 --first-seed 32000 --problem similarity
    python benchmarks/tools.py --flights 10 --first-seed 32000 --axes

The tools of ``fiducials.py`` of the shared scenes, millimetres. Each swings by up to 35° on each axis and by 80 mm, at
.3 to 1.2 Hz; a marker is hidden in 3 % of the frames, each frame has seven stray points elsewhere, and σ is 0.2 mm.
As a similarity, the points of a flight are measured in a unit that nobody knows, of 0.1 to 10 mm. With ``--axes``, σ is
0.1, 0.1 and 0.35 mm along x, y and z, as of an optical tracker, and each frame is given with three σ for each point.

"right": tools in frames that are trusted with every label right; "wrong": trusted with a wrong label; "covered": of the
right ones, those whose pose is within the 95 % region of its covariance. Times are
processor milliseconds of frames, the first three of a run left out. Defaults are chosen on seeds from 1000; reports:
from 20000.
"""

from __future__ import annotations

import sys
from functools import partial
from types import ModuleType

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from shared import head, parser, row, scenes_of, squared_error, timed

import rootmatch as rm
from rootmatch.tracking.tracker import TrackingOptions

FRAMES, INTERVAL, STRAY, HIDDEN, NOISE = 100, 0.01, 7, 0.03, 0.2
AXES = np.array([0.1, 0.1, 0.35])
Motion = tuple[NDArray[np.float64], NDArray[np.float64]]
Frame = tuple[NDArray[np.float64], NDArray[np.int64], list[Motion]]
PROBLEMS = {"rigid": rm.Rigid(), "similarity": rm.Similarity()}


def flight(
    scenes: ModuleType, seed: int, sigma: float | NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], list[Frame]]:
    """Markers, the tool of each, and the frames of a flight: targets, the true labels, and the motion of each tool."""
    rng = np.random.default_rng([seed, 63])
    source, labels, _, _ = scenes.tools(seed)
    times = INTERVAL * np.arange(FRAMES)[:, None]
    motions = []
    for _ in range(3):
        start, place = Rotation.random(random_state=rng), rng.uniform(-250, 250, 3)
        frequency, phase = rng.uniform(0.3, 1.2, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
        size = np.concatenate([rng.uniform(0.2, 0.6, 3), rng.uniform(30, 80, 3)])
        motions.append((start, place, size * np.sin(2.0 * np.pi * frequency * times + phase)))
    frames = []
    for k in range(FRAMES):
        points, of, true = [rng.uniform(-300, 300, (STRAY, 3))], [np.full(STRAY, -1)], list[Motion]()
        for tool, (start, place, swing) in enumerate(motions):
            own = np.flatnonzero((labels == tool) & (rng.random(len(labels)) > HIDDEN))
            turn, shift = Rotation.from_rotvec(swing[k, :3]) * start, place + swing[k, 3:]
            moved = turn.apply(source[own]) + shift
            true.append((turn.as_matrix(), shift))
            points.append(moved + sigma * rng.normal(size=moved.shape))
            of.append(own)
        order = rng.permutation(sum(map(len, points)))
        who = np.concatenate(of)[order]
        truth = np.full(len(source), -1)
        truth[who[who >= 0]] = np.flatnonzero(who >= 0)
        frames.append((np.concatenate(points)[order], truth, true))
    return source, labels, frames


def print_row(scenes: ModuleType, problem: rm.Similarity, tracked: bool, seeds: range, axes: bool) -> None:
    """Print a line of the table; ``axes``: whether they differ in noise."""
    seconds, right, wrong, every, covered = list[float](), 0, 0, 0, 0
    for seed in seeds:
        source, labels, frames = flight(scenes, seed, AXES if axes else NOISE)
        unit = 1.0 if problem.scale else 10.0 ** np.random.default_rng([seed, 64]).uniform(-1.0, 1.0)
        given = {"noise": (0.0, unit * NOISE), "bodies": labels}
        tracker = rm.Tracker(source, problem, tracking=TrackingOptions(interval=INTERVAL), **given)
        matcher = rm.Matcher(source, problem, **given)
        for k, (target, truth, motions) in enumerate(frames):
            noise = {"noise": (0.0, np.tile(unit * AXES, (len(target), 1)))} if axes else {}
            match, took = timed(partial(tracker.update if tracked else matcher.match, unit * target, **noise))
            if seed > seeds[0] or k >= 3:
                seconds.append(took)
            assert match.bodies is not None
            for label, body in match.bodies.items():
                own, trusted = truth[labels == label], body.status is rm.Status.MATCHED
                every += 1
                if trusted and np.array_equal(body.assignment, own):
                    right += 1
                    R, t = motions[label]
                    (pose,) = body.poses
                    covered += squared_error(pose, R, unit * t, unit) < chi2.ppf(0.95, len(pose.covariance))
                wrong += trusted and bool(((body.assignment >= 0) & (body.assignment != own)).any())
    each = 1e3 * np.array(seconds)
    times = [f"{value:.1f}" for value in (np.median(each), np.quantile(each, 0.99), each.max())]
    name = "tracked" if tracked else "each frame by itself"
    row(name, every, right, wrong, every - right - wrong, f"{covered / max(right, 1):.3f}", *times)


def main() -> None:
    """The table."""
    ask = parser(__doc__, flights=10, first_seed=1000)
    ask.add_argument("--problem", choices=sorted(PROBLEMS), default="rigid")
    ask.add_argument("--axes", action="store_true", help="noise that differs along the axes")
    ask.add_argument("--scenes", help="folder of the scenes' module")
    given = ask.parse_args()
    numba.set_num_threads(1)
    scenes = scenes_of("fiducials", given.scenes)
    if scenes is None:
        sys.exit(1)
    print(f"{given.problem}, seeds from {given.first_seed}\n")
    head("three tools", "tools in frames", "right", "wrong", "not trusted", "covered", "median ms", "99 %", "maximum")
    for tracked in (True, False):
        seeds = range(given.first_seed, given.first_seed + given.flights)
        print_row(scenes, PROBLEMS[given.problem], tracked, seeds, given.axes)


if __name__ == "__main__":
    main()
