"""How a mask of possible correspondences narrows the search: hyper-edges evaluated, and seconds."""

from __future__ import annotations

import argparse
from typing import Literal

import numpy as np

import rootmatch as rm
from rootmatch.simulation import p3p_scene

FRACTIONS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""Fractions of the correspondences that are possible, including all true ones."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=20000)
    options = parser.parse_args()
    print("| search | scene | fraction allowed | hyper-edges | of all | fraction⁴ | s | of all | accuracy |")
    print("|" + " --- |" * 9)
    searches: tuple[tuple[Literal["exhaustive", "guided"], int, int], ...] = (
        ("exhaustive", 10, 10), ("exhaustive", 14, 10), ("guided", 30, 30), ("guided", 100, 100)
    )  # fmt: skip
    for search, n, clutter in searches:
        first: tuple[float, float] | None = None
        for fraction in FRACTIONS:
            counts, seconds, accuracies = [], [], []
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                scene = p3p_scene(n, clutter, 0.5, seed)
                mask = np.random.default_rng(seed).random((n, n + clutter)) < fraction
                mask[np.arange(n), scene.truth] = True
                for _ in range(2):  # the first call compiles
                    match = rm.match(
                        scene.source, scene.target, scene.problem, noise=0.5, hyperedges=search, candidates=mask
                    )
                counts.append(match.hyperedges)
                seconds.append(match.seconds)
                accuracies.append(scene.accuracy(match.assignment))
            count, time = float(np.mean(counts)), float(np.median(seconds))
            first = first or (count, time)
            print(
                f"| {search} | {n} + {clutter} | {fraction:g} | {count:.3g} | {count / first[0]:.3f} |"
                f" {fraction**4:.3f} | {time:.3f} | {time / first[1]:.3f} | {np.mean(accuracies):.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
