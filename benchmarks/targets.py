"""A large object that hides part of itself: the coded targets of `aicon_targets`, without normals, view by view.

157 retro-reflective targets against the 15 to 131 that a view shows, raw pixels of a lens with distortion, in random
order and with clutter among them. ROOTMATCH_DATA names the folder of the data set. With ``--sizes`` instead simulated
closed surfaces of 20 to 2,000 points, of which the camera sees the half that faces it: how the time grows. With
``--seen`` they are points of a box, and only so many are detected.

    python benchmarks/targets.py --clutter 0 100
    python benchmarks/targets.py --sizes 20 50 100 200 500 1000 2000
    python benchmarks/targets.py --sizes 60 --seen 10 --seeds 40
    python benchmarks/targets.py --sizes 40 --seen 20 --seeds 10 --noise auto
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from shared import Floats, Integers, head, measured_data, parser, row, timed

import rootmatch as rm

MINIMUM = 15
"""Points that a view must show."""
SIGMA = 0.1
"""Least noise that is stated, in pixels: some views fit better than their detections can be trusted."""
GOALS = {"recall": 0.98, "precision": 0.99}


class Scene(NamedTuple):
    """Points, detections in random order, and which is which: −1 for the points that are not seen."""

    source: Floats
    target: Floats
    truth: Integers
    camera: rm.Camera
    sigma: float


class Result(NamedTuple):
    """A match held against the truth."""

    name: str
    detections: int
    recall: float
    precision: float
    status: str
    seconds: float
    evaluations: int


def shuffled(source: Floats, pixels: Floats, clutter: Floats, rng: np.random.Generator) -> tuple[Floats, Integers]:
    """Pixels (n, 2), NaN where a point is not seen, and clutter in random order, and the truth."""
    seen = np.flatnonzero(np.isfinite(pixels[:, 0]))
    target = np.concatenate([pixels[seen], clutter])
    order = rng.permutation(len(target))
    truth = np.full(len(source), -1)
    truth[seen] = np.argsort(order)[: len(seen)]
    return target[order], truth


def recorded(data: dict[str, Floats], view: int, clutter: int, seed: int) -> Scene:
    """A view of the targets."""
    rng = np.random.default_rng([seed, view])
    source, pixels = data["points3d"], data["points2d"][view]
    target, truth = shuffled(source, pixels, rng.uniform(0.0, data["size"], (clutter, 2)), rng)
    camera = rm.Camera.from_opencv(data["K"][view], data["dist"])
    return Scene(source, target, truth, camera, max(float(data["rms"][view]), SIGMA))


def simulated(n: int, clutter: int, seed: int, sigma: float = 0.5) -> Scene:
    """Points all over an ellipsoid, those that face the camera seen."""
    rng = np.random.default_rng([seed, n, clutter])
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes = np.array([1.0, 0.8, 0.6])
    source, normals = normals * axes, normals / axes
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    camera = rm.Camera(3000.0, 3000.0, 2000.0, 1500.0)
    inside = source @ rotation.T + np.array([0.0, 0.0, 4.0])
    pixels = inside[:, :2] / inside[:, 2:] * 3000.0 + np.array([2000.0, 1500.0])
    hidden = ((normals @ rotation.T) * inside).sum(axis=1) > 0.0
    pixels[hidden] = np.nan
    pixels += rng.normal(scale=sigma, size=pixels.shape)
    low, high = np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)
    target, truth = shuffled(source, pixels, rng.uniform(low, high, (clutter, 2)), rng)
    return Scene(source, target, truth, camera, sigma)


def boxed(n: int, seen: int, clutter: int, seed: int, sigma: float = 0.3) -> Scene:
    """Points of a box, some of which are detected."""
    rng = np.random.default_rng([seed, n, seen, clutter])
    source = rng.uniform(-0.5, 0.5, (n, 3)) * [1.0, 1.0, 0.6]
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    camera = rm.Camera(1200.0, 1200.0, 640.0, 480.0)
    pixels = camera.project(source @ rotation.T + [*rng.uniform(-0.2, 0.2, 2), 2.0])
    pixels += rng.normal(scale=sigma, size=pixels.shape)
    pixels[rng.permutation(n)[seen:]] = np.nan
    target, truth = shuffled(source, pixels, rng.uniform(0.0, [1280.0, 960.0], (clutter, 2)), rng)
    return Scene(source, target, truth, camera, sigma)


def result(name: str, scene: Scene, seed: int, max_seconds: float | None, auto: bool = False) -> Result:
    """Match a scene, its noise stated or estimated; processor seconds."""
    known = {"noise": "auto" if auto else scene.sigma, "seed": seed, "max_seconds": max_seconds}
    match, seconds = timed(lambda: rm.match(scene.source, scene.target, rm.P3P(scene.camera), **known))
    found = match.assignment >= 0
    right = int((found & (match.assignment == scene.truth)).sum())
    return Result(
        name, len(scene.target), right / int((scene.truth >= 0).sum()), right / max(int(found.sum()), 1),
        match.status.name.lower(), seconds, match.evaluated,
    )  # fmt: skip


HEAD = ("", "detections", "recall", "precision", "status", "s", "evaluations")


def print_row(one: Result) -> None:
    figures = f"{one.recall:.3f}", f"{one.precision:.3f}", one.status, f"{one.seconds:.2f}", f"{one.evaluations:.2g}"
    row(one.name, one.detections, *figures)


def summary(rows: list[Result]) -> str:
    """How many views reach the goals, statuses, and times."""
    reached = [r.recall >= GOALS["recall"] and r.precision >= GOALS["precision"] for r in rows]
    sure = [ok for r, ok in zip(rows, reached, strict=True) if r.status == "matched"]
    seconds = np.array([r.seconds for r in rows])
    return (
        f"{sum(reached)} of {len(rows)} reach recall {GOALS['recall']} and precision {GOALS['precision']}; "
        f"{sum(sure)} of {len(sure)} matched ones do; median {np.median(seconds):.2f} s, 90 % "
        f"{np.quantile(seconds, 0.9):.2f} s, worst {seconds.max():.2f} s"
    )


def main() -> None:
    ask = parser(__doc__, seeds=1, first_seed=20_000, every=1)
    ask.add_argument("--clutter", type=int, nargs="+", default=[0], help="clutter points beside the visible ones")
    ask.add_argument("--views", type=int, nargs="+", help="default: every view with 15 points or more")
    ask.add_argument("--sizes", type=int, nargs="+", help="simulated objects of so many points instead")
    ask.add_argument("--seen", type=int, help="of points of a box instead, of which so many are detected")
    ask.add_argument("--noise", choices=["stated", "auto"], default="stated", help="of simulated points")
    ask.add_argument("--max-seconds", type=float, help="most seconds a match may take")
    options = ask.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    auto = options.noise == "auto"
    result("warm-up", simulated(60, 0, 0), 0, None, auto)  # compiles
    if options.sizes:
        for clutter in options.clutter:
            print(f"\nsimulated, {clutter} clutter points\n")
            head(*HEAD)
            medians = []
            for n in options.sizes:
                rows = []
                for seed in seeds:
                    scene = simulated(n, clutter, seed)
                    if options.seen:
                        scene = boxed(n, options.seen, clutter, seed)
                    rows.append(result(f"{n}", scene, seed, options.max_seconds, auto))
                medians.append(float(np.median([r.seconds for r in rows])))
                for one in rows:
                    print_row(one)
                print(summary(rows))
            if len(medians) > 1:
                slope = np.polyfit(np.log(options.sizes), np.log(medians), 1)[0]
                print(f"exponent {slope:.2f}")
        return
    data = measured_data("aicon_targets")
    views = options.views or [v for v, p in enumerate(data["points2d"]) if np.isfinite(p[:, 0]).sum() >= MINIMUM]
    for clutter in options.clutter:
        print(f"\n{clutter} clutter points\n")
        head(*HEAD)
        rows = []
        for view in views[:: options.every]:
            for seed in seeds:
                rows.append(result(f"view {view}", recorded(data, view, clutter, seed), seed, options.max_seconds))
                print_row(rows[-1])
        print(summary(rows))


if __name__ == "__main__":
    main()
