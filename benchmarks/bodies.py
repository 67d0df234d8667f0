"""Several rigid bodies in one image: how often each is told right, how often wrongly trusted, and how long it takes.

    python benchmarks/bodies.py --seeds 100 --first-seed 20000

A headset of 32 sensors and two controllers of 22 LEDs that are mirror images of each other, with normals, before one
camera of 1280 × 960 px: each in a pose of its own, an LED seen within 70 degrees of its normal, 0.5 px of noise, 5 or
15 clutter points. The headset comes from ``constellations.py``, see benchmarks/constellations.py.

"right": a body with no match wrong and nine tenths of its visible points matched; counted of the bodies that show seven
points or more. "listed": right, or called ambiguous with such an assignment among the first five alternatives.
"matched and wrong": of the bodies whose status is "matched", those with a wrong match; a body that shows fewer points
counts here too. Times are processor seconds of one thread for the whole image with all kernels
compiled. Defaults are chosen on seeds below 4000.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from shared import is_listed, judge, parser, scenes_of, timed

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import rootmatch as rm
from rig_scenes import controller

MIN_VISIBLE = 7
VIEW = 70.0
NOISE = 0.5
LABELS = ("headset", "left", "right")
NEAR_FAR = {"headset": (0.3, 2.5), "left": (0.3, 1.2), "right": (0.3, 1.2)}
"""Distances in metres; controllers are held within an arm's length or two of the camera."""


@dataclass(frozen=True)
class Scene:
    """One image of three bodies, and the truth."""

    source: NDArray[np.float64]
    normals: NDArray[np.float64]
    labels: NDArray[np.str_]
    target: NDArray[np.float64]
    truth: NDArray[np.int64]
    camera: rm.Camera
    poses: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]


def bodies(scenes: ModuleType) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Points and normals of each body in its own frame."""
    points, normals = controller()
    mirror = np.array([-1.0, 1.0, 1.0])
    return {
        "headset": (scenes.HEADSET, scenes.NORMALS),
        "left": (points, normals),
        "right": (points * mirror, normals * mirror),
    }


def scene(scenes: ModuleType, seed: int, clutter: int) -> Scene:
    """One image; the same seed gives the same bodies in the same poses, whatever the clutter."""
    rng = np.random.default_rng([seed, 15])
    width, height = scenes.W, scenes.H
    f = rng.uniform(500.0, 1000.0)
    source, normals, labels, pixels, seen, poses = [], [], [], [], [], {}
    for name, (points, facing) in bodies(scenes).items():
        rotation = scenes._rotation(rng)
        z = rng.uniform(*NEAR_FAR[name])
        u = rng.uniform([0.1 * width, 0.1 * height], [0.9 * width, 0.9 * height])
        t = np.array([(u[0] - width / 2) / f * z, (u[1] - height / 2) / f * z, z])
        X, n = points @ rotation.T + t, facing @ rotation.T
        p = X[:, :2] / X[:, 2:] * f + (width / 2, height / 2)
        cosine = -(n * X).sum(axis=1) / np.linalg.norm(X, axis=1) / np.linalg.norm(n, axis=1)
        inside = (p > 0).all(axis=1) & (p < (width, height)).all(axis=1)
        source.append(points)
        normals.append(facing)
        labels += [name] * len(points)
        seen.append((X[:, 2] > 0.05) & (cosine > np.cos(np.radians(VIEW))) & inside)
        pixels.append(p + rng.normal(0.0, NOISE, p.shape))
        poses[name] = rotation, t
    index = np.flatnonzero(np.concatenate(seen))
    fake = np.random.default_rng([seed, clutter, 16]).uniform((0.0, 0.0), (width, height), (clutter, 2))
    target = np.vstack([np.concatenate(pixels)[index], fake])
    order = np.random.default_rng([seed, 17]).permutation(len(target))
    truth = np.full(len(labels), -1)
    truth[index] = np.argsort(order)[: len(index)]
    return Scene(
        np.concatenate(source), np.concatenate(normals), np.array(labels), target[order], truth,
        rm.Camera(f, f, width / 2, height / 2), poses,
    )  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What came of one body."""

    visible: int
    status: str
    wrong: int
    right: bool
    listed: bool


def outcomes(made: Scene, seed: int, normals: bool) -> tuple[list[Outcome], float]:
    """The bodies of one image, and the processor seconds that they took."""
    options: dict[str, Any] = {"normals": made.normals, "view_angle": np.radians(VIEW)} if normals else {}
    known = {"noise": NOISE, "bodies": made.labels, "seed": seed, **options}
    match, seconds = timed(lambda: rm.match(made.source, made.target, rm.P3P(made.camera), **known))
    assert match.bodies is not None
    used = match.assignment[match.assignment >= 0]
    assert len(set(used.tolist())) == len(used)
    found = []
    for label, body in match.bodies.items():
        truth = made.truth[made.labels == label]
        _, wrong, full = judge(body.assignment, truth)
        shown = int((truth >= 0).sum())
        found.append(Outcome(shown, body.status.name.lower(), wrong, full, is_listed(body, truth)))
    return found, seconds


def main() -> None:
    ask = parser(__doc__, seeds=100, first_seed=1000)
    ask.add_argument("--clutter", type=int, nargs="+", default=[5, 15])
    ask.add_argument("--scenes", help="folder of the scenes' module")
    ask.add_argument("--no-normals", action="store_true", help="match without normals")
    ask.add_argument("--verbose", action="store_true", help="a line for each image")
    given = ask.parse_args()
    numba.set_num_threads(1)
    scenes = scenes_of("constellations", given.scenes)
    if scenes is None:
        return
    for seed in range(given.first_seed, given.first_seed + 2):
        outcomes(scene(scenes, seed, 5), seed, not given.no_normals)
    for clutter in given.clutter:
        every, times = [], []
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            found, seconds = outcomes(scene(scenes, seed, clutter), seed, not given.no_normals)
            every += found
            times.append(seconds)
            if given.verbose:
                each = ", ".join(
                    f"{one.visible} visible {one.status} {'right' if one.right else f'{one.wrong} wrong'}"
                    for one in found
                )
                print(f"  {seed}: {seconds:.2f} s; {each}", flush=True)
        shown = [one for one in every if one.visible >= MIN_VISIBLE]
        matched = [one for one in every if one.status == "matched"]
        print(
            f"{clutter} clutter, {given.seeds} images: right {sum(one.right for one in shown)} of {len(shown)} bodies "
            f"with {MIN_VISIBLE} visible or more, listed {sum(one.listed for one in shown)}; "
            f"matched and wrong {sum(one.wrong > 0 for one in matched)} of "
            f"{len(matched)}; seconds an image: median {np.median(times):.3f}, 95 % {np.quantile(times, 0.95):.2f}, "
            f"worst {max(times):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
