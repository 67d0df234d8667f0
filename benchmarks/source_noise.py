"""What noise of model points costs, and whether the poses' covariances cover the truth with it.

    python benchmarks/source_noise.py --seeds 100 --first-seed 24000

The points of a body are known to σ of the model, as those of a drawing or of a survey are, and detected to 0.3 px with
a focal length of 1500 px. Each scene is matched without ``source_noise=`` and with it. "Right": no match wrong and at
most one detected point without a match. "Trusted and wrong": the status is "matched" and a match is wrong. "Covered":
the squared error of the pose over its covariance is below its 95 % quantile, in trusted frames without a wrong match.
Defaults were chosen on seeds from 1000.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from shared import Floats, Integers, head, parser, row, squared_error

import rootmatch as rm

CAMERA = rm.Camera(1500.0, 1500.0, 640.0, 480.0)
SIZE = (1280.0, 960.0)
RIG = rm.Rig([(CAMERA, np.eye(3), np.array([x, 0.0, 0.0])) for x in (-300.0, 0.0, 300.0)], sizes=[SIZE] * 3)
PIXEL, DETECTED = 0.3, 0.85
QUANTILE = 12.592
"""95 % of χ² with six degrees of freedom."""


class Family(NamedTuple):
    """Points, clutter, σ of the model and mean distance in millimetres, and whether three cameras see it."""

    points: int
    clutter: int
    sigma: float
    distance: float
    rig: bool = False


FAMILIES = {
    "cad-8-0": Family(8, 0, 0.5, 1500.0),
    "cad-12-8": Family(12, 8, 0.5, 1500.0),
    "cad-12-8-coarse": Family(12, 8, 1.5, 1500.0),
    "cad-12-8-far": Family(12, 8, 0.5, 4000.0),
    "cad-12-8-fine": Family(12, 8, 0.1, 1500.0),
    "cad-12-8-rig": Family(12, 8, 0.5, 1500.0, rig=True),
}


class Scene(NamedTuple):
    """The points as the model has them, detections, the truth (n,) or (C, n), and the pose."""

    model: Floats
    target: Floats
    truth: Integers
    rotation: Floats
    translation: Floats


@dataclass
class Tally:
    """What came of a family."""

    right: int = 0
    trusted: int = 0
    wrong: int = 0
    covered: int = 0
    seconds: float = 0.0


def scene(family: Family, seed: int) -> Scene:
    """A cloud of points in a box of 200 mm, of which an image shows at least five, or its image in three cameras."""
    rng = np.random.default_rng([seed, 29])
    while True:
        one = drawn(family, rng)
        if (np.atleast_2d(one.truth) >= 0).sum(axis=1).max() >= 5:
            return one


def drawn(family: Family, rng: np.random.Generator) -> Scene:
    """A scene, whatever it shows."""
    model = rng.uniform(-100.0, 100.0, (family.points, 3))
    made = model + rng.normal(0.0, family.sigma, model.shape)
    rotation = Rotation.random(random_state=rng).as_matrix()
    translation = family.distance * np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.15, 0.15), rng.uniform(0.8, 1.2)])
    rows, truth = [], []
    for camera, offset in enumerate((-300.0, 0.0, 300.0) if family.rig else (0.0,)):
        pixels = CAMERA.project(made @ rotation.T + translation + [offset, 0.0, 0.0])
        shown = np.flatnonzero((rng.random(len(made)) < DETECTED) & (pixels > 0.0).all(axis=1) & (pixels < SIZE).all(1))
        image = np.vstack(
            [pixels[shown] + rng.normal(0.0, PIXEL, (len(shown), 2)), rng.uniform((0, 0), SIZE, (family.clutter, 2))]
        )
        order = rng.permutation(len(image))
        own = np.full(family.points, -1)
        own[shown] = sum(map(len, rows)) + np.argsort(order)[: len(shown)]
        truth.append(own)
        rows.append(np.column_stack([image[order], np.full(len(image), camera)]))
    target = np.vstack(rows)
    if family.rig:
        return Scene(model, target, np.array(truth), rotation, translation)
    return Scene(model, target[:, :2], truth[0], rotation, translation)


def count(tally: Tally, match: rm.Match, one: Scene) -> None:
    """Add a match to a tally."""
    found = match.assignment if match.sightings is None else match.sightings.assignment
    wrong = bool(((found >= 0) & (found != one.truth)).any())
    missed = int(((one.truth >= 0) & (found < 0)).sum())
    tally.right += not wrong and missed <= 1
    if not match:
        return
    tally.trusted += not wrong
    tally.wrong += wrong
    pose = match.pose
    if not wrong and pose is not None and pose.covariance is not None:
        tally.covered += squared_error(pose, one.rotation, one.translation) < QUANTILE


def main() -> None:
    """Print one row for each family, without the noise of the model and with it."""
    ask = parser(__doc__, seeds=30, first_seed=1000)
    ask.add_argument("--families", nargs="+", default=list(FAMILIES), choices=FAMILIES)
    given = ask.parse_args()
    head("scenes", "source_noise", "number", "right", "trusted and right", "trusted and wrong", "covered", "ms")
    for name in given.families:
        family = FAMILIES[name]
        for told in (None, family.sigma):
            tally = Tally()
            for seed in range(given.first_seed, given.first_seed + given.seeds):
                one = scene(family, seed)
                started = time.perf_counter()
                problem = rm.P3P(RIG if family.rig else CAMERA)
                match = rm.match(one.model, one.target, problem, noise=PIXEL, source_noise=told, seed=seed)
                tally.seconds += time.perf_counter() - started
                count(tally, match, one)
            row(
                name, "–" if told is None else f"{told:g} mm", given.seeds, tally.right, tally.trusted, tally.wrong,
                f"{tally.covered / max(tally.trusted, 1):.3f}", f"{1e3 * tally.seconds / given.seeds:.0f}",
            )  # fmt: skip


if __name__ == "__main__":
    main()
