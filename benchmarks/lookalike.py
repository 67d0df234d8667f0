"""What an image can tell at all of a headset that looks the same after half a turn: the bound of the other benchmarks.

    python benchmarks/lookalike.py --flights 24 --first-seed 20400
    python benchmarks/lookalike.py --images 400 --first-seed 20000

A judge that is told which sensor each detection is of, and that the pose is the true one or its copy after half a turn,
fits both by least squares and takes the more likely. It knows the noise, and what the copy cannot show is clutter. For
flights it adds up the logarithms of the likelihoods of all frames (their noise is independent), and is right in the
frames in which the true pose is ahead. Nothing that is not told the truth can be right more often, but by chance or by
what does not show in the positions: which sensors are hidden is told apart as well with ``--visibility`` (70 degrees
from their normals, to half a degree), which changes little, as the halves face alike.

Scenes and flights are those of benchmarks/bodies.py and benchmarks/tracking.py.
"""

from __future__ import annotations

import math
from types import ModuleType

import bodies
import numpy as np
import tracking
from numpy.typing import NDArray
from shared import parser, scenes_of

import rootmatch as rm
from rootmatch.explain.task import MatchingTask
from rootmatch.model.near_symmetries import find_symmetries

Floats = NDArray[np.float64]

MINIMUM = 4
"""Detections with which poses can be told apart at all."""
FACING = 0.01
"""Margin, in cosines, beyond which a sensor is surely seen, or hidden."""
DECIDED = 30.0
"""Log-odds from which the rest of a flight is decided."""


class Judge:
    """The headset and its copy."""

    def __init__(self, scenes: ModuleType, visibility: bool) -> None:
        self.source, self.normals = scenes.HEADSET, scenes.NORMALS
        self.R, self.t, self.image = find_symmetries(self.source, self.normals)[0]
        self.visibility = visibility
        self.area = float(scenes.W * scenes.H)

    def lead(
        self, target: Floats, truth: NDArray[np.int64], camera: rm.Camera, noise: float, pose: tuple[Floats, Floats]
    ) -> float:
        """By how much the true pose is the more likely one, as a logarithm."""
        shown = truth >= 0
        copy = np.where(self.image >= 0, truth[self.image], -1)
        left_out = int(shown.sum() - (copy >= 0).sum())
        # clutter is as dense as the five points of the scenes
        clutter = left_out * -math.log(tracking.CLUTTER / self.area * 2.0 * math.pi * noise**2)
        if (copy >= 0).sum() < MINIMUM:
            return clutter
        task = MatchingTask.of(rm.P3P(camera), self.source, target, noise=noise)
        here, there = task.problem.poses(task.points, np.array([truth, copy]))
        if here is None or there is None or here.chi2 is None or there.chi2 is None:
            return clutter
        if self.visibility and self.differs(pose, copy):
            return DECIDED
        return 0.5 * (there.chi2 - here.chi2) + clutter

    def differs(self, pose: tuple[Floats, Floats], copy: NDArray[np.int64]) -> bool:
        """Whether the copy of the true pose should show a sensor that is not there, or hide one that is."""
        R, t = pose[0] @ self.R, pose[0] @ self.t + pose[1]
        seen = self.source @ R.T + t
        length = np.linalg.norm(seen, axis=1) * np.linalg.norm(self.normals, axis=1)
        cosine = -((self.normals @ R.T) * seen).sum(axis=1) / length
        edge = math.cos(math.radians(tracking.VIEW))
        return bool(((cosine > edge + FACING) & (copy < 0)).any() or ((cosine < edge - FACING) & (copy >= 0)).any())


def flights(judge: Judge, scenes: ModuleType, seeds: range) -> str:
    """Frames in which the true pose is ahead."""
    shown = wrong = 0
    for seed in seeds:
        made = tracking.flight(seed)
        camera = rm.Camera(made.focal, made.focal, scenes.W / 2, scenes.H / 2)
        total = 0.0
        for k in range(600):
            target, truth = tracking.frame(scenes, made, seed, k)
            if (truth >= 0).sum() < MINIMUM:
                continue
            shown += 1
            if total < DECIDED:
                total += judge.lead(target, truth, camera, tracking.NOISE, made.pose(k / tracking.RATE))
            wrong += total < 0.0
    return (
        f"{len(seeds)} flights: the true pose is ahead in {shown - wrong} of {shown} frames ({1 - wrong / shown:.4f})"
    )


def images(judge: Judge, scenes: ModuleType, seeds: range) -> str:
    """Headsets whose true pose is the more likely one, and how many bodies could be right if all others were."""
    headsets = wrong = others = 0
    for seed in seeds:
        made = bodies.scene(scenes, seed, 5)
        headset = made.labels == "headset"
        for label in bodies.LABELS:
            others += label != "headset" and (made.truth[made.labels == label] >= 0).sum() >= bodies.MIN_VISIBLE
        truth = made.truth[headset]
        if (truth >= 0).sum() < bodies.MIN_VISIBLE:
            continue
        headsets += 1
        wrong += judge.lead(made.target, truth, made.camera, bodies.NOISE, made.poses["headset"]) < 0.0
    every = headsets + others
    return (
        f"{len(seeds)} images: the true pose is the more likely one of {headsets - wrong} of {headsets} headsets; "
        f"with all {others} controllers right {every - wrong} of {every} bodies ({1 - wrong / every:.4f})"
    )


def main() -> None:
    ask = parser(__doc__, flights=0, images=0, first_seed=1000)
    ask.add_argument("--visibility", action="store_true", help="use which sensors are hidden as well")
    ask.add_argument("--scenes", help="folder of the scenes' module")
    given = ask.parse_args()
    scenes = scenes_of("constellations", given.scenes)
    if scenes is None:
        return
    judge = Judge(scenes, given.visibility)
    if given.flights:
        print(flights(judge, scenes, range(given.first_seed, given.first_seed + given.flights)), flush=True)
    if given.images:
        print(images(judge, scenes, range(given.first_seed, given.first_seed + given.images)), flush=True)


if __name__ == "__main__":
    main()
