"""What knowledge of a pose finds, and how long that takes: nothing, a vertical, a rotation, a position, a whole pose.

    python benchmarks/known.py --seeds 60 --first-seed 24000

One frame of ``few_leds`` of ``xr.py`` a seed: V LEDs of a controller with 14 are visible among C clutter points
(``few-V-C``). The sensors are as good as there: a vertical to 0.5°, a rotation to 2°; positions to 5 cm, or to 20 cm
("rough"), at 0.6 to 1.2 m. "Right": no match wrong and nine tenths of the visible points. "Trusted and wrong": the
status is "matched" and a match is wrong. Times are of the processor. ``--wrong``: the knowledge is that of another
scene. Scenes are found as in benchmarks/constellations.py. Defaults were chosen on seeds below 2000.

``rig-bodies``: two bodies of seven and six points, all visible, and three clutter points in each image of two cameras;
knowledge of both, a position to 5 cm, a rotation to 2°, at 3 m. A row is right if both bodies are.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from shared import head, judge, parser, row, scenes_of, timed

import rootmatch as rm

FAMILIES = ("few-4-6", "few-5-8", "few-5-20", "rig-bodies")
KINDS = ("nothing", "vertical", "position", "rotation", "rotation, rough position", "rotation, position", "Pose")
TURN, TILT, NEAR, ROUGH = np.radians(2.0) / np.sqrt(3.0), np.radians(0.5), 0.05, 0.2
"""Standard deviations: of a rotation about each axis and of a vertical, rad; of positions on each axis, m."""


def knowledge(kind: str, frame: dict[str, Any], seed: int) -> rm.Pose | rm.PosePrior | None:
    """What is known of the pose of a frame's body."""
    ((R, t),), ((measured,), gravity) = frame["poses"], frame["imu"]
    rng = np.random.default_rng([seed, 24])
    near, rough = t + NEAR * rng.normal(size=3), t + ROUGH * rng.normal(size=3)
    if kind == "nothing":
        return None
    if kind == "Pose":
        return rm.Pose(measured, near, np.diag([TURN**2] * 3 + [NEAR**2] * 3))
    given: dict[str, Any] = {}
    if "vertical" in kind:
        given["vertical"] = (R[1], gravity, TILT)
    if "rotation" in kind:
        given["rotation"] = (measured, TURN)
    if "position" in kind:
        given["position"] = (rough, ROUGH) if "rough" in kind else (near, NEAR)
    return rm.PosePrior(**given)


def rig_case(seed: int) -> tuple[dict[str, Any], dict[str, Any], Any]:
    """Two bodies before a rig: arguments of `match`, a frame for `knowledge` of each, and the detections' points."""
    camera, rng = rm.Camera(800.0, 800.0, 320.0, 240.0), np.random.default_rng([seed, 29])
    side = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_matrix()
    views = [(camera, np.eye(3), np.zeros(3)), (camera, side, np.array([-0.6, 0.0, 0.0]))]
    turns = Rotation.random(2, random_state=seed).as_matrix()
    places = np.array([[-0.5, 0.1, 3.0], [0.4, 0.0, 3.0]]) + rng.uniform(-0.1, 0.1, (2, 3))
    bodies = [rng.uniform(-0.3, 0.3, (count, 3)) for count in (7, 6)]
    placed = np.vstack([X @ R.T + t for X, R, t in zip(bodies, turns, places, strict=True)])
    images, truth = [], []
    for _, R, t in views:
        pixels = camera.project(placed @ R.T + t)
        images.append(np.vstack([pixels + rng.normal(0.0, 0.3, pixels.shape), rng.uniform(0, (640, 480), (3, 2))]))
        truth.append(np.arange(13) + sum(len(one) for one in images[:-1]))
    labels = ["a"] * 7 + ["b"] * 6
    frames = {}
    for label, R, t in zip("ab", turns, places, strict=True):
        measured = Rotation.from_rotvec(rng.normal(0.0, TURN, 3)).as_matrix() @ R
        tilted = Rotation.from_rotvec(rng.normal(0.0, TILT, 3)).as_matrix() @ np.array([0.0, 1.0, 0.0])
        frames[label] = {"poses": [(R, t)], "imu": ((measured,), tilted)}
    problem = rm.P3P(rm.Rig(views, sizes=[(640, 480)] * 2))
    given = {"source": np.vstack(bodies), "target": images, "problem": problem, "noise": 0.3, "bodies": labels}
    return given, frames, np.array(truth)


def run_rig(kind: str, seed: int, told: int) -> tuple[bool, bool, bool, float]:
    """Right, trusted and right, trusted and wrong, and seconds of one scene; ``told``: the scene that is known."""
    given, frames, truth = rig_case(seed)
    if told != seed:
        frames = rig_case(told)[1]
    prior: dict[str, Any] = {label: knowledge(kind, frame, seed) for label, frame in frames.items()}
    match, seconds = timed(lambda: rm.match(**given, seed=seed, prior=prior if kind != "nothing" else None))
    found = match.sightings.assignment
    full, bad = bool((found == truth).mean() >= 0.9), bool(((found >= 0) & (found != truth)).any())
    return full and not bad, bool(match) and full and not bad, bool(match) and bad, seconds


def run_few(kind: str, family: str, seed: int, told: int, given: tuple[Any, ...]) -> tuple[bool, bool, bool, float]:
    """The same of a controller before one camera."""
    xr, problem, points, known = given
    _, shown, clutter = family.split("-")
    frame = xr.few_leds(seed, int(shown), int(clutter))
    prior = knowledge(kind, frame if told == seed else xr.few_leds(told, int(shown), int(clutter)), seed)
    match, seconds = timed(lambda: rm.match(points, frame["target"], problem, seed=seed, prior=prior, **known))
    truth = np.full(len(points), -1)
    body, led = frame["owner"].T
    truth[led[body == 0]] = np.flatnonzero(body == 0)
    _, bad, full = judge(match.assignment, truth)
    return bool(full), bool(match) and bool(full), bool(match) and bad > 0, seconds


def main() -> int:
    """Print one row for each family and kind of knowledge."""
    ask = parser(__doc__, seeds=20, first_seed=1000)
    ask.add_argument("--families", nargs="+", default=FAMILIES)
    ask.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    ask.add_argument("--wrong", action="store_true", help="give the knowledge of another scene")
    ask.add_argument("--scenes", help="folder of the scenes")
    given = ask.parse_args()
    xr = scenes_of("xr", given.scenes)
    if xr is None:
        return 1
    points, normals, _ = xr.bodies("R")
    problem = rm.P3P(rm.Camera.from_matrix(xr.ROOM_K))
    known: dict[str, Any] = {"noise": 0.3, "normals": normals, "view_angle": np.radians(70.0)}
    head("scenes", "known", "number", "right", "trusted and right", "trusted and wrong", "ms, median", "ms, mean")
    for family in given.families:
        for kind in given.kinds:
            count, spent = np.zeros(3, int), []
            for seed in range(given.first_seed - 1, given.first_seed + given.seeds):  # the first compiles
                told = seed + 500_000 if given.wrong else seed
                if family == "rig-bodies":
                    *found, seconds = run_rig(kind, seed, told)
                else:
                    *found, seconds = run_few(kind, family, seed, told, (xr, problem, points, known))
                if seed >= given.first_seed:
                    spent.append(1e3 * seconds)
                    count += found
            row(family, kind, given.seeds, *count, f"{np.median(spent):.0f}", f"{np.mean(spent):.0f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
