"""How well noise="auto" estimates σ, against a fit of the right matches; Markdown rows."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from shared import head, parser, row

import rootmatch as rm
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

FACTOR = 1.5
SIGMAS = (0.1, 0.3, 1.0, 2.0)
"""Pixels, in turn."""
CASES: dict[str, Callable[[float, int], Scene]] = {
    "p3p 10 + 0": lambda sigma, seed: p3p_scene(10, 0, sigma, seed),
    "p3p 10 + 10": lambda sigma, seed: p3p_scene(10, 10, sigma, seed),
    "up2p 10 + 0": lambda sigma, seed: up2p_scene(10, 0, sigma, seed),
    "up2p 10 + 10": lambda sigma, seed: up2p_scene(10, 10, sigma, seed),
    "p3p 20 + 20": lambda sigma, seed: p3p_scene(20, 20, sigma, seed),
    "3p1 b 1, 10 + 0": lambda sigma, seed: three_plus_one_scene(10, 0, sigma, seed, baseline=1.0),
    "3p1 b 5, 10 + 0": lambda sigma, seed: three_plus_one_scene(10, 0, sigma, seed, baseline=5.0),
}


def law(dof: int) -> float:
    """Probability that √(χ² / (c · dof)) is within the factor of 1, for the best c."""
    from scipy.stats import chi2

    centre = 4.0 * math.log(FACTOR) / (FACTOR**2 - FACTOR**-2)
    return float(chi2.cdf(FACTOR**2 * centre * dof, dof) - chi2.cdf(centre * dof / FACTOR**2, dof))


def main() -> None:
    ask = parser(__doc__, seeds=30, first_seed=1000)
    ask.add_argument("--scenes", nargs="+", default=[], help="those whose name contains one of these texts")
    options = ask.parse_args()
    head("scenes", "count", "within 1.5", "from the right matches", "by χ²", "accuracy")
    for name, make in CASES.items():
        if options.scenes and not any(text in name for text in options.scenes):
            continue
        within, best, accuracy, dof = [], [], [], 0
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            sigma = SIGMAS[seed % len(SIGMAS)]
            scene = make(sigma, seed)
            match = rm.match(scene.source, scene.target, scene.problem, noise="auto")
            points = scene.problem.validated(scene.source, scene.target, sigma)
            (pose,) = scene.problem.poses(points, scene.truth[None])
            assert pose is not None
            assert pose.dof is not None
            dof = pose.dof
            centre = 4.0 * math.log(FACTOR) / (FACTOR**2 - FACTOR**-2)
            ideal = math.sqrt(pose.chi2 / (centre * dof))
            within.append(abs(math.log(match.noise / sigma)) < math.log(FACTOR))
            best.append(abs(math.log(ideal)) < math.log(FACTOR))
            accuracy.append(scene.accuracy(match.assignment))
        figures = [np.mean(within), np.mean(best), law(dof), np.mean(accuracy)]
        row(name, options.seeds, *(f"{figure:.3f}" for figure in figures))


if __name__ == "__main__":
    main()
