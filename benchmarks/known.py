"""What knowledge of a pose finds, and how long that takes: nothing, a vertical, a rotation, a position, a whole pose.

    python benchmarks/known.py --seeds 60 --first-seed 24000

One frame of ``few_leds`` of ``xr.py`` a seed: V LEDs of a controller with 14 are visible among C clutter points
(``few-V-C``). The sensors are as good as there: a vertical to 0.5°, a rotation to 2°; positions to 5 cm, or to 20 cm
("rough"), at 0.6 to 1.2 m. "Right": no match wrong and nine tenths of the visible points. "Trusted and wrong": the
status is "matched" and a match is wrong. Times are of the processor. ``--wrong``: the knowledge is that of another
scene. Scenes are found as in benchmarks/constellations.py. Defaults were chosen on seeds below 2000.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from shared import head, judge, parser, row, scenes_of, timed

import rootmatch as rm

FAMILIES = ("few-4-6", "few-5-8", "few-5-20")
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
        _, shown, clutter = family.split("-")
        for kind in given.kinds:
            right = trusted = wrong = 0
            spent = []
            for seed in range(given.first_seed - 1, given.first_seed + given.seeds):  # the first compiles
                frame = xr.few_leds(seed, int(shown), int(clutter))
                told = xr.few_leds(seed + 500_000, int(shown), int(clutter)) if given.wrong else frame
                prior = knowledge(kind, told, seed)
                match, seconds = timed(
                    lambda: rm.match(points, frame["target"], problem, seed=seed, prior=prior, **known)  # noqa: B023
                )
                if seed < given.first_seed:
                    continue
                spent.append(1e3 * seconds)
                truth = np.full(len(points), -1)
                body, led = frame["owner"].T
                truth[led[body == 0]] = np.flatnonzero(body == 0)
                _, bad, full = judge(match.assignment, truth)
                right += full
                trusted += bool(match) and full
                wrong += bool(match) and bad > 0
            row(family, kind, given.seeds, right, trusted, wrong, f"{np.median(spent):.0f}", f"{np.mean(spent):.0f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
