"""How often a camera of unknown focal length is matched, and how often wrongly: `UP2PF` on scenes of several kinds.

python benchmarks/zoom.py [--scenes 20] [--first-seed 1000] [--kinds clean-8,unrelated]

Every scene is upright, at a focal length of 500 to 1500 px, in a box 8 away (`tests/robot_scenes.py`), σ .5 px. Those
of the kind "any" have 5 to 14 points, up to 60 % of them hidden, up to 20 clutter points and a σ of .5 to 2 px, and are
6 to 40 away. A match is right if it is trusted and all its matches are right, and wrong if it is trusted and one of
them is not; "expected wrong" is how many of these its probabilities let expect.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

import numpy as np
from shared import head, parser, row

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import robot_scenes
import rootmatch as rm
from instances import axis_rotation, project
from rootmatch.errors import InputError

CENTRE, SIGMA = (320.0, 240.0), 0.5
CLEAN = {f"clean-{n}": (n, 0, 0) for n in (8, 10, 12, 16, 20)}
CLUTTER = {f"clutter-{n}+{m}": (n, 0, m) for n, m in ((8, 4), (8, 8), (12, 6), (12, 12), (12, 20), (40, 40))}
HIDDEN = {f"hidden-{n}-{h}+{m}": (n, h, m) for n, h, m in ((10, 3, 3), (12, 4, 4), (12, 6, 6), (40, 20, 60))}
UNRELATED = {f"unrelated-{n}x{m}": (n, m) for n, m in ((8, 8), (8, 12), (12, 12))}
TOWERS = {
    "tower": (0, 0, 0),
    "tower-hidden": (0, 3, 0),
    "tower-mark": (1, 0, 0),
    "tower-mark-hidden": (1, 3, 2),
    "tower-rough": (0, 2, 2),
}
Made = tuple[np.ndarray, np.ndarray, np.ndarray, rm.UP2PF]


def box(n: int, hidden: int, clutter: int, seed: int) -> Made:
    """Random points of which some are hidden, with clutter."""
    scene = robot_scenes.zoomed(n, clutter, SIGMA, seed)
    return shown(scene.source, scene.target, scene.truth, hidden, seed, scene.vertical)


def shown(
    source: np.ndarray, target: np.ndarray, truth: np.ndarray, hidden: int, seed: int, vertical: np.ndarray
) -> Made:
    """A scene without the detections of some points."""
    lost = np.random.default_rng([seed, 1]).permutation(len(source))[:hidden]
    left = np.setdiff1d(np.arange(len(target)), truth[lost])
    place = np.full(len(target), -1)
    place[left] = np.arange(len(left))
    return source, target[left], place[truth], rm.UP2PF(CENTRE, tuple(vertical), (0.0, 1.0, 0.0))


def tower(marks: int, hidden: int, clutter: int, seed: int, rough: float = 0.0) -> Made:
    """Three square floors of a tower, of which the four sides are alike but for a mark, or for 3 cm of 2 m."""
    rng = np.random.default_rng([seed, 2])
    corners = [
        (x, y, z) for y, half in ((-1.5, 0.8), (0.0, 1.0), (1.5, 1.2)) for x in (-half, half) for z in (-half, half)
    ]
    source = np.array([*corners, *[(0.7, 0.6, 1.1)][:marks]])
    source += rough * np.random.default_rng([seed, 4]).normal(size=source.shape)
    focal, mount = rng.uniform(500.0, 1500.0), axis_rotation(np.array([1.0, 0.0, 0.0]), rng.uniform(0.0, 0.3))
    rotation = mount @ axis_rotation(robot_scenes.DOWN, rng.uniform(-np.pi, np.pi))
    image = project(source @ rotation.T + mount @ np.array([0.0, 0.0, 8.0]), (focal, focal, *CENTRE))
    target, truth = robot_scenes._shuffled(rng, image, clutter, SIGMA)
    return shown(source, target, truth, hidden, seed, mount @ robot_scenes.DOWN)


def unrelated(n: int, detections: int, seed: int) -> Made:
    """Points of one scene and unrelated detections."""
    scene = robot_scenes.zoomed(n, 0, SIGMA, seed)
    target = np.random.default_rng([seed, 3]).uniform((0.0, 0.0), (640.0, 480.0), (detections, 2))
    return scene.source, target, np.full(n, -2), rm.UP2PF(CENTRE, tuple(scene.vertical), (0.0, 1.0, 0.0))


def of_any_kind(seed: int) -> tuple[Made, float]:
    """A scene drawn to be hard, and its σ."""
    rng = np.random.default_rng([seed, 9])
    n = int(rng.integers(5, 15))
    hidden, clutter = int(rng.integers(0, int(0.6 * n) + 1)), int(rng.integers(0, 21))
    clutter = max(clutter, 4 - n + hidden)
    sigma, depth = float(rng.choice([0.5, 1.0, 2.0])), float(rng.choice([6.0, 8.0, 16.0, 40.0]))
    scene = robot_scenes.zoomed(n, clutter, sigma, seed, depth=depth)
    return shown(scene.source, scene.target, scene.truth, hidden, seed, scene.vertical), sigma


def made(kind: str, seed: int) -> Made:
    """The scene of a kind and a seed."""
    if kind in UNRELATED:
        return unrelated(*UNRELATED[kind], seed)
    if kind in TOWERS:
        return tower(*TOWERS[kind], seed, 0.03 if "rough" in kind else 0.0)
    return box(*(CLEAN | CLUTTER | HIDDEN)[kind], seed)


def main() -> None:
    """Print a row for each kind."""
    ask = parser(__doc__, scenes=20, first_seed=1000)
    ask.add_argument("--kinds", default=",".join([*(CLEAN | CLUTTER | HIDDEN | TOWERS | UNRELATED), "any"]))
    options = ask.parse_args()
    print(f"seeds {options.first_seed} to {options.first_seed + options.scenes - 1}")
    told = "kind", "right", "wrong", "ambiguous", "untrusted", "truth listed", "refused", "expected wrong", "median ms"
    head(*told, "seeds of wrong", "first seeds without a match")
    for kind in options.kinds.split(","):
        counts = dict.fromkeys(("right", "wrong", "ambiguous", "untrusted", "listed", "refused"), 0)
        times, wrong, lost, expected = [], [], [], 0.0
        for seed in range(options.first_seed, options.first_seed + options.scenes):
            (source, target, truth, problem), sigma = of_any_kind(seed) if kind == "any" else (made(kind, seed), SIGMA)
            began = time.perf_counter()
            try:
                match = rm.match(source, target, problem, noise=sigma)
            except InputError:
                counts["refused"] += 1
                continue
            times.append(1e3 * (time.perf_counter() - began))
            own = match.assignment >= 0
            is_right = bool((match.assignment[own] == truth[own]).all())
            if match:
                expected += 1.0 - (1.0 if match.probability is None else match.probability)
                counts["right" if is_right else "wrong"] += 1
                wrong += [] if is_right else [(seed, match.probability)]
            else:
                counts[str(match.status)] += 1
                lost.append(seed)
            seen = truth >= 0
            every = [match.assignment, *(one for one, _ in match.alternatives)]
            counts["listed"] += any((one[seen] == truth[seen]).mean() >= 0.8 for one in every) if seen.any() else 0
        median = f"{statistics.median(times):.0f}" if times else "-"
        row(kind, *counts.values(), f"{expected:.2f}", median, wrong, lost[:12])


if __name__ == "__main__":
    main()
