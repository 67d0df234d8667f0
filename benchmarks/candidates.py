"""How a mask of possible correspondences narrows the search: hyper-edges evaluated, and seconds.

With ROOTMATCH_DATA also the 1,886 pairs of `tless_candidates`, of two instances of one object.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
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
                        scene.source, scene.target, scene.problem, noise=0.5, sampler=search, candidates=mask
                    )
                counts.append(match.evaluated)
                seconds.append(match.seconds)
                accuracies.append(scene.accuracy(match.assignment))
            count, took = float(np.mean(counts)), float(np.median(seconds))
            first = first or (count, took)
            print(
                f"| {search} | {n} + {clutter} | {fraction:g} | {count:.3g} | {count / first[0]:.3f} |"
                f" {fraction**4:.3f} | {took:.3f} | {took / first[1]:.3f} | {np.mean(accuracies):.3f} |",
                flush=True,
            )

    if "ROOTMATCH_DATA" in os.environ:
        instances(Path(os.environ["ROOTMATCH_DATA"], "tless_candidates.npz"))


def instances(path: Path) -> None:
    """Poses of both instances among the proposed pairs, against the reference ones."""
    data = np.load(path)
    camera = rm.Camera.from_matrix(data["K"])
    mask = np.zeros((len(data["points3d"]), len(data["points2d"])), np.bool_)
    mask[tuple(data["candidates"].T)] = True
    print("\n| motions | σ | status | groups | processor s | off, instance 1 | instance 2 |\n|" + " --- |" * 7)
    for motions in (2, "auto"):
        for sigma in (2.0, 3.0, 5.0):
            started = time.process_time()
            match = rm.match(
                data["points3d"], data["points2d"], rm.P3P(camera), noise=sigma, candidates=mask, motions=motions
            )
            seconds = time.process_time() - started
            off = []
            for rotation, t in zip(data["R"], data["t"], strict=True):
                errors = [
                    (
                        float(np.degrees(np.arccos(np.clip(0.5 * (np.trace(pose.R.T @ rotation) - 1.0), -1.0, 1.0)))),
                        float(np.linalg.norm(pose.t - t) / t[2]),
                    )
                    for pose in match.poses
                    if pose is not None
                ]
                angle, shift = min(errors, default=(180.0, 1.0))
                off.append(f"{angle:.1f}°, {100 * shift:.1f} %")
            sizes = ", ".join(str(size) for size in np.bincount(match.motion_labels[match.motion_labels >= 0]))
            print(
                f"| {motions} | {sigma:g} | {match.status.name.lower()} | {sizes} | {seconds:.2f} |"
                f" {off[0]} | {off[1]} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
