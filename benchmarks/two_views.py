"""Two views at size: 3P1 among clutter, against the true geometry's own accuracy.

The scenes are those of `rootmatch simulate 3p1`; "own" is what the best assignment under the true relative pose reaches
(`accuracy.own_accuracy`). Times are processor seconds of whole matches; run with NUMBA_NUM_THREADS=1.
"""

from __future__ import annotations

import numpy as np
from accuracy import figures, own_accuracy, right
from accuracy_scenes import of_scene
from shared import head, parser, row, timed

import rootmatch as rm
from rootmatch.simulation import Scene, three_plus_one_scene

SIZES = ((12, 5), (20, 10), (20, 20), (50, 25))
BELOW = {1.0: 0.02, 5.0: 0.04}
"""How far below the true geometry's own the accuracy may lie, by baseline."""
LIMITS = {(20, 20): 0.5, (50, 25): 5.0}
"""Seconds that a match may take."""


def matched(scene: Scene, seed: int) -> tuple[rm.Match, float]:
    """The match of a scene, and its processor seconds."""
    return timed(lambda: rm.match(scene.source, scene.target, scene.problem, noise=scene.noise, seed=seed))


def print_row(n: int, clutter: int, baseline: float, sigma: float, seeds: range, hidden: int) -> None:
    """Print one row of the table."""
    accuracy, own, precision, seconds, trusted, states = [], [], [], [], [], []
    for seed in seeds:
        scene = three_plus_one_scene(n, clutter, sigma, seed, baseline, hidden)
        found, took = matched(scene, seed)
        here = figures(found.assignment, scene.truth)
        accuracy.append(here[0])
        precision.append(here[1])
        own.append(own_accuracy(of_scene(scene)))
        seconds.append(took)
        states.append(found.status.name)
        if found.status:
            trusted.append(right(found.assignment, scene.truth))
    minimum = float(np.mean(own)) - BELOW[baseline]
    limit = LIMITS.get((n, clutter), np.inf)
    reached = np.mean(accuracy) >= minimum and np.median(seconds) <= limit
    unseen = f", {hidden} hidden" if hidden else ""
    row(
        f"{n} + {clutter}{unseen}, b {baseline:g}, σ {sigma:g}", len(seeds), f"{np.mean(accuracy):.4f}",
        f"{np.mean(own):.4f}", f"{minimum:.4f}", f"{np.mean(precision):.4f}", f"{sum(trusted)} of {len(trusted)}",
        states.count("AMBIGUOUS"), states.count("UNTRUSTED"), f"{np.median(seconds):.3f}",
        f"{max(seconds):.2f}", "reached" if reached else "MISSED",
    )  # fmt: skip


def main() -> None:
    ask = parser(__doc__, first_seed=1000, scenes=20, hidden=0)
    ask.add_argument("--rows", nargs="*", default=None, help="sizes such as 20+20; all by default")
    options = ask.parse_args()
    matched(three_plus_one_scene(20, 20, 1.0, 0, 1.0), 0)  # compiles
    head(
        "scenes", "count", "accuracy", "own", "goal", "precision", "matched: right", "ambiguous", "untrusted",
        "median s", "worst s", "",
    )  # fmt: skip
    seeds = range(options.first_seed, options.first_seed + options.scenes)
    for n, clutter in SIZES:
        if options.rows is None or f"{n}+{clutter}" in options.rows:
            for baseline in BELOW:
                for sigma in (0.5, 1.0):
                    print_row(n, clutter, baseline, sigma, seeds, options.hidden)


if __name__ == "__main__":
    main()
