"""How a mask of possible correspondences narrows the search: hyper-edges looked at, and seconds."""

from __future__ import annotations

import argparse
from typing import Literal

import numpy as np

import rootmatch as rm
from rootmatch.simulation import p3p_scene

PARTS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""Parts of the correspondences that are possible, the true ones among them."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=20000)
    options = parser.parse_args()
    print("| way | scene | part allowed | hyper-edges | of all | part to the 4th | s | of all | accuracy |")
    print("|" + " --- |" * 9)
    ways: tuple[tuple[Literal["exhaustive", "guided"], int, int], ...] = (
        ("exhaustive", 10, 10), ("exhaustive", 14, 10), ("guided", 30, 30), ("guided", 100, 100)
    )  # fmt: skip
    for way, n, clutter in ways:
        first: tuple[float, float] | None = None
        for part in PARTS:
            counts, seconds, accuracies = [], [], []
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                scene = p3p_scene(n, clutter, 0.5, seed)
                mask = np.random.default_rng(seed).random((n, n + clutter)) < part
                mask[np.arange(n), scene.truth] = True
                for _ in range(2):  # the first time compiles
                    match = rm.match(
                        scene.source, scene.target, scene.problem, noise=0.5, hyperedges=way, candidates=mask
                    )
                counts.append(match.hyperedges)
                seconds.append(match.seconds)
                accuracies.append(scene.accuracy(match.assignment))
            count, time = float(np.mean(counts)), float(np.median(seconds))
            first = first or (count, time)
            print(
                f"| {way} | {n} + {clutter} | {part:g} | {count:.3g} | {count / first[0]:.3f} | {part**4:.3f} |"
                f" {time:.3f} | {time / first[1]:.3f} | {np.mean(accuracies):.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
