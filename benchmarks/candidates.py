"""How a mask of possible correspondences narrows the search: hyper-edges evaluated, and seconds.

With ROOTMATCH_DATA also the 1,886 pairs of `tless_candidates`, of two instances of one object.
"""

from __future__ import annotations

import os
from functools import partial
from typing import Literal

import numpy as np
from shared import head, measured_data, parser, row, timed

import rootmatch as rm
from rootmatch.simulation import p3p_scene

FRACTIONS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""Fractions of the correspondences that are possible, including all true ones."""


def main() -> None:
    options = parser(__doc__, seeds=5, first_seed=20000).parse_args()
    head("search", "scene", "fraction allowed", "hyper-edges", "of all", "fraction⁴", "s", "of all", "accuracy")
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
            row(
                search, f"{n} + {clutter}", f"{fraction:g}", f"{count:.3g}", f"{count / first[0]:.3f}",
                f"{fraction**4:.3f}", f"{took:.3f}", f"{took / first[1]:.3f}", f"{np.mean(accuracies):.3f}",
            )  # fmt: skip

    if "ROOTMATCH_DATA" in os.environ:
        instances()


def instances() -> None:
    """Poses of both instances among the proposed pairs, against the reference ones."""
    data = measured_data("tless_candidates")
    camera = rm.Camera.from_matrix(data["K"])
    mask = np.zeros((len(data["points3d"]), len(data["points2d"])), np.bool_)
    mask[tuple(data["candidates"].T)] = True
    print()
    head("motions", "σ", "status", "groups", "processor s", "off, instance 1", "instance 2")
    for motions in (2, "auto"):
        for sigma in (2.0, 3.0, 5.0):
            known = {"noise": sigma, "candidates": mask, "motions": motions}
            match, seconds = timed(partial(rm.match, data["points3d"], data["points2d"], rm.P3P(camera), **known))
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
            row(motions, f"{sigma:g}", match.status.name.lower(), sizes, f"{seconds:.2f}", *off)


if __name__ == "__main__":
    main()
