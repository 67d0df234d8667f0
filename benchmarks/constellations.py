"""Constellations of LEDs most of which are hidden: how often the answer is right, how often it is wrongly trusted, and
how long it takes.

    python benchmarks/constellations.py --seeds 200 --first-seed 20000

The scenes come from ``constellations.py``, which is no part of this repository: a module with ``scene(family, seed)``,
looked for in ``--scenes``, in ROOTMATCH_SCENES, and in the folder ``scenes`` beside the measured data (ROOTMATCH_DATA,
or ``shared/data`` beside the checkout). Where it is absent only the families that are made here are run:
``unrelated-p3p`` and ``unrelated-up2p``, random points against random pixels, which nothing may match.

"full": no match wrong and nine tenths of the visible points matched. "shown": full, or called ambiguous with the full
answer first or among the first five alternatives. "matched and wrong": of the scenes whose status is "matched", those
with a wrong match. Times are processor seconds of one thread with all kernels compiled; a scene is matched from
scratch, as the first frame of a headset would be. Defaults are chosen on seeds below 4000.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from shared import head, is_listed, judge, parser, row, scenes_of, timed

import rootmatch as rm

FAMILIES = (
    "real", "sim-0-0", "sim-0-0-quiet", "sim-0-20", "sim-5-0", "sim-15-0", "sim-15-20", "sim-5-0-near",
    "d6-0-0", "d6-5-0", "d6-15-0", "d10-0-0", "d10-5-0", "d10-15-0", "unrelated-p3p", "unrelated-up2p",
)  # fmt: skip
REAL_SCENES = 40
"""Four views, each shuffled ten times."""
WARMING = 3
"""Scenes of each family that are matched before the clock starts, so that its kernels are compiled."""


@dataclass(frozen=True)
class Outcome:
    """What came of one scene."""

    family: str
    seed: int
    status: str
    right: int
    wrong: int
    visible: int
    full: bool
    shown: bool
    seconds: float
    """Of the processor."""


def unrelated(upright: bool, seed: int) -> dict[str, Any]:
    """Points and pixels that have nothing to do with each other."""
    rng = np.random.default_rng(seed)
    n, n_target = int(rng.integers(8, 21)), int(rng.integers(8, 31))
    source, target = rng.uniform(-2.0, 2.0, (n, 3)), rng.uniform((0.0, 0.0), (640.0, 480.0), (n_target, 2))
    camera = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
    problem = rm.UP2P(camera, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)) if upright else rm.P3P(camera)
    noise = float(rng.choice([0.25, 0.5, 1.0]))
    return {"source": source, "target": target, "problem": problem, "noise": noise, "truth": np.full(n, -1)}


def arguments(family: str, seed: int, scenes: ModuleType | None) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Arguments of `rootmatch.match`, and the truth."""
    if family.startswith("unrelated"):
        made = unrelated(family.endswith("up2p"), seed)
        return made, made.pop("truth")
    assert scenes is not None
    made = scenes.scene(family, seed)
    told = {
        "source": made["source"], "target": made["target"], "problem": rm.P3P(rm.Camera(*made["camera"])),
        "noise": made["noise"], "normals": made["normals"],
    }  # fmt: skip
    return told, np.asarray(made["truth"])


def outcome(family: str, seed: int, scenes: ModuleType | None) -> Outcome:
    """One scene."""
    told, truth = arguments(family, seed, scenes)
    match, seconds = timed(lambda: rm.match(**told, seed=seed))
    right, wrong, full = judge(match.assignment, truth)
    return Outcome(
        family, seed, match.status.name.lower(), right, wrong, int((truth >= 0).sum()), full, is_listed(match, truth),
        seconds,
    )  # fmt: skip


def print_row(family: str, outcomes: list[Outcome]) -> None:
    """Print one row of the table."""
    count = len(outcomes)
    by_status = {
        name: [one for one in outcomes if one.status == name] for name in ("matched", "ambiguous", "untrusted")
    }
    matched, untrusted = by_status["matched"], by_status["untrusted"]
    times = [one.seconds for one in outcomes]
    seen = any(one.visible for one in outcomes)
    row(
        family, count, sum(one.full for one in outcomes) if seen else "–",
        sum(one.shown for one in outcomes) if seen else "–",
        f"{sum(one.wrong > 0 for one in matched)} of {len(matched)}", len(by_status["ambiguous"]),
        len(untrusted), sum(one.full for one in untrusted) if seen else "–",
        f"{np.median(times):.3f}", f"{np.quantile(times, 0.95):.3f}", f"{max(times):.2f}",
    )  # fmt: skip


def main() -> None:
    ask = parser(__doc__, seeds=20, first_seed=1000)
    ask.add_argument("--families", nargs="+", default=list(FAMILIES), help="names such as sim-5-0 or d6-15-0")
    ask.add_argument("--scenes", help="folder of the scenes' module")
    options = ask.parse_args()
    numba.set_num_threads(1)
    scenes = scenes_of("constellations", options.scenes)
    families = [family for family in options.families if scenes is not None or family.startswith("unrelated")]
    print(f"seeds from {options.first_seed}\n")
    head(
        "family", "scenes", "full", "or shown", "matched and wrong", "ambiguous", "untrusted", "full of these",
        "median s", "95 % s", "worst s",
    )  # fmt: skip
    for family in families:
        first, count = (0, min(options.seeds, REAL_SCENES)) if family == "real" else (options.first_seed, options.seeds)
        for seed in range(first, first + WARMING):
            outcome(family, seed, scenes)
        print_row(family, [outcome(family, seed, scenes) for seed in range(first, first + count)])


if __name__ == "__main__":
    main()
