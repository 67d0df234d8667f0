"""Rigs of four cameras: one image of each, a predicted pose, flights, and several bodies; how often right, how fast.

    python benchmarks/rigs.py --scenes 40 --first-seed 20000
    python benchmarks/rigs.py --rows flight --scenes 10 --frames 600

The scenes are those of tests/rig_scenes.py. "search": twenty points amidst four cameras, of which each sees five
others, 0.5 px, with clutter in each image; of 60 scenes each a clutter point lies in one where a camera that does not
see a point would show it (seeds 1003 and 1092, with 5 and 2: 1.1 and 2.3 px off), which nothing tells from a sighting:
with it the evidence is 8.4 and 3.5 nats higher than that of the truth. The others are of a headset whose four cameras
(640 × 480 px, 94° wide, with distortion) see one or two controllers of 22 LEDs, 0.3 px, two clutter points in each
image. "prior": of one, predicted with errors of 3° and 1 cm, as its covariance says; "three": all but three of its
sightings are removed, whichever, and the errors are a fifth of that; "wrong": the prediction is 60° off. "bodies": both
controllers in one image of each camera, without a prediction. "flight" and "hands": one or both are followed at 60 Hz;
in 10 of 150 frames all cameras are covered, in 10 of the next 150 two of them. "actors": six bodies of four or five
markers before two cameras, see tests/actor_scenes.py.

"right": no sighting wrong and nine tenths of them matched; of the flights' frames, those with four sightings or more
(of each body) count. "matched and wrong": called matched with a wrong sighting; "run": most frames of a flight in a
row. Milliseconds are processor time of one thread, kernels compiled. Defaults are chosen on seeds below 4000.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
from shared import head, parser, row, timed

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import rootmatch as rm
from actor_scenes import Stage
from rig_scenes import NOISE, VIEW, RigScene, controllers, four_about, frame, headset
from rootmatch.algebra.rotation import one_rotation_matrix

CYCLE, HIDDEN = 150, 10
SPREAD = np.repeat([np.radians(3.0), 0.01], 3)
RIG = headset()
POINTS, NORMALS, LABELS = controllers()
LEDS = len(POINTS) // 2


class Outcome(NamedTuple):
    """What came of one body in one frame."""

    shown: bool
    right: bool
    matched: bool
    wrong: bool
    milliseconds: float
    searched: bool
    seed: int


def judged(found: rm.Match, truth: np.ndarray, seconds: float, seed: int, minimum: int = 1) -> Outcome:
    """One body's sightings against the truth."""
    sightings = found.sightings.assignment
    matched = sightings >= 0
    wrong = bool((sightings != truth)[matched].any())
    visible = int((truth >= 0).sum())
    return Outcome(
        shown=visible >= minimum,
        right=not wrong and matched.sum() >= 0.9 * visible,
        matched=bool(found.status),
        wrong=bool(found.status) and wrong,
        milliseconds=1e3 * seconds,
        searched=found.evaluated > 0,
        seed=seed,
    )


def search(seed: int, clutter: int) -> Iterator[Outcome]:
    """Points amidst four cameras, each of which sees others."""
    scene = four_about(clutter=clutter, seed=seed)
    found, seconds = timed(lambda: rm.match(scene.points, scene.rows, rm.P3P(scene.rig), noise=0.5))
    yield judged(found, scene.truth, seconds, seed)


def predicted(seed: int, kind: str) -> Iterator[Outcome]:
    """One controller with a predicted pose, which is as sure as it says unless ``kind`` is "wrong"."""
    rng = np.random.default_rng([seed, 41])
    scene, spread = frame(seed, 0, RIG), SPREAD
    if kind == "three":
        scene, spread = of_three(scene, rng), SPREAD / 5.0
    R, t = scene.poses[0]
    error = spread * rng.standard_normal(6)
    if kind == "wrong":
        error[:3] = np.radians(60.0) * np.array([0.6, 0.0, 0.8])
    prior = rm.Pose(one_rotation_matrix(error[:3]) @ R, t + error[3:], np.diag(spread**2))
    known = {"noise": NOISE, "normals": NORMALS[:LEDS], "view_angle": np.radians(VIEW)}
    found, seconds = timed(lambda: rm.match(scene.points, scene.rows, rm.P3P(RIG), prior=prior, **known))
    yield judged(found, scene.truth, seconds, seed, minimum=3)


def of_three(scene: RigScene, rng: np.random.Generator) -> RigScene:
    """The scene without all but three of the sightings."""
    seen = np.argwhere(scene.truth >= 0)
    gone = scene.truth[tuple(rng.permutation(seen)[3:].T)]
    kept = np.setdiff1d(np.arange(len(scene.rows)), gone)
    place = np.full(len(scene.rows) + 1, -1)
    place[kept] = np.arange(len(kept))
    return scene._replace(rows=scene.rows[kept], truth=place[scene.truth])


def bodies(seed: int) -> Iterator[Outcome]:
    """Both controllers in one image of each camera."""
    scene = frame(seed, 0, RIG, hands=2)
    known = {"noise": NOISE, "normals": NORMALS, "view_angle": np.radians(VIEW), "bodies": LABELS}
    found, seconds = timed(lambda: rm.match(POINTS, scene.rows, rm.P3P(RIG), **known))
    yield from of_bodies(found, scene, seconds, seed)


def of_bodies(found: rm.Match, scene: RigScene, seconds: float, seed: int) -> Iterator[Outcome]:
    """Each body of a frame; the time is that of all."""
    for label, body in found.bodies.items():
        own = LABELS[: len(scene.points)] == label
        yield judged(body, scene.truth[:, own], seconds, seed, minimum=4)


def actors(seed: int) -> Iterator[Outcome]:
    """Three actors with a body on the head and one on the hip; those with four sightings or more count as shown."""
    stage = Stage(seed)
    found, seconds = timed(stage.match)
    for name, body in found.bodies.items():
        yield judged(body, stage.truth_of(name), seconds, seed, minimum=4)


def flight(seed: int, hands: int, frames: int) -> Iterator[Outcome]:
    """One or both controllers, followed."""
    options = {"bodies": LABELS} if hands == 2 else {}
    points, normals = POINTS[: hands * LEDS], NORMALS[: hands * LEDS]
    tracker = rm.Tracker(points, rm.P3P(RIG), noise=NOISE, normals=normals, view_angle=np.radians(VIEW), **options)
    for k in range(frames):
        turn, within = divmod(k, CYCLE)
        covered = () if within < CYCLE - HIDDEN else (0, 1) if turn % 2 else (0, 1, 2, 3)
        scene = frame(seed, k, RIG, hands=hands, covered=covered)
        found, seconds = timed(lambda rows=scene.rows: tracker.update(rows))
        if hands == 2:
            yield from of_bodies(found, scene, seconds, seed)
        else:
            yield judged(found, scene.truth, seconds, seed, minimum=4)


def print_row(name: str, every: list[Outcome]) -> None:
    """Print a row of the table."""
    shown = [one for one in every if one.shown]
    run = longest = 0
    for one, before in zip(every, [None, *every], strict=False):
        run = (run + 1 if before is not None and before.seed == one.seed else 1) if one.wrong else 0
        longest = max(longest, run)
    times = np.array([one.milliseconds for one in every])
    right = sum(one.right for one in shown)
    row(
        name, len(shown), f"{right} ({right / max(len(shown), 1):.3f})", sum(one.matched for one in shown),
        sum(one.wrong for one in every), longest, sum(one.searched for one in every), f"{np.median(times):.1f}",
        f"{np.quantile(times, 0.99):.0f}", f"{times.max():.0f}",
    )  # fmt: skip


def main() -> None:
    ask = parser(__doc__, scenes=40, frames=600, first_seed=1000)
    ask.add_argument("--rows", nargs="+", default=["search", "prior", "bodies", "actors", "flight", "hands"])
    given = ask.parse_args()
    numba.set_num_threads(1)
    kinds = {
        "search": [(f"search, clutter {c}", lambda seed, c=c: search(seed, c)) for c in (0, 2, 5)],
        "prior": [
            (f"prior, {kind}", lambda seed, kind=kind: predicted(seed, kind)) for kind in ("all", "three", "wrong")
        ],
        "bodies": [("bodies", bodies)],
        "actors": [("actors", actors)],
        "flight": [("flight", lambda seed: flight(seed, 1, given.frames))],
        "hands": [("hands", lambda seed: flight(seed, 2, given.frames))],
    }
    head("scenes", "bodies", "right", "matched", "matched and wrong", "run", "searched", "ms: median", "99 %", "worst")
    for what in given.rows:
        count = max(given.scenes // 10, 1) if what in ("flight", "hands") else given.scenes
        for name, work in kinds[what]:
            list(zip(range(3), work(given.first_seed - 1), strict=False))  # kernels are loaded
            every = [one for seed in range(given.first_seed, given.first_seed + count) for one in work(seed)]
            print_row(name, every)


if __name__ == "__main__":
    main()
