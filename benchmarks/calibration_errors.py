"""What it is worth to state how well cameras are calibrated: trust, and how often the covariance of a pose covers.

    python benchmarks/calibration_errors.py --scale 1 --first-seed 137000

Calibrations are off by what is stated: the focal length by σ = .2 %, the principal point by .5 px, each camera of a rig
by .05° about each axis and 1 mm along it (of a headset, .2 mm). Each scene is matched three times: with an exact
calibration stated, with a larger noise of the detections, and with the errors as they are. "Covered": poses of right
matches within the 95 % region of their covariance. `--scale 0.1` takes a tenth of the scenes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import flights
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from shared import scenes_of

import rootmatch as rm

Floats = NDArray[np.float64]
FOCAL, CENTRE, TURN, MOVE, MOVE_ON_HEAD = 0.002, 0.5, np.radians(0.05), 1e-3, 2e-4
"""Standard deviations: of the logarithm of a focal length, in pixels, in radians, and in metres."""
CAMERA, SIGMA = rm.Camera(900.0, 900.0, 640.0, 480.0), 0.25
STUDIO = np.random.default_rng(12).uniform(-0.2, 0.2, (10, 3))
WAYS = "exact", "larger noise", "stated"


@dataclass
class Tally:
    """What came of the bodies of one family of scenes."""

    bodies: int = 0
    trusted: int = 0
    right: int = 0
    covered: int = 0

    def add(self, trusted: bool, wrong: bool, squared: float, dof: int) -> None:
        """Count one body; ``squared``: normalised squared error of its pose, with so many degrees of freedom."""
        self.bodies += 1
        self.trusted += trusted
        self.right += trusted and not wrong
        self.covered += trusted and not wrong and squared <= chi2.ppf(0.95, dof)


def draw_camera(camera: rm.Camera, rng: np.random.Generator) -> rm.Camera:
    """A camera as a calibration may have it."""
    zoom, (x, y) = np.exp(FOCAL * rng.normal()), rng.normal(0.0, CENTRE, 2)
    return replace(camera, fx=zoom * camera.fx, fy=zoom * camera.fy, cx=camera.cx + x, cy=camera.cy + y)


def draw_view(view: tuple[rm.Camera, Any, Any], move: float, rng: np.random.Generator) -> tuple[rm.Camera, Any, Any]:
    """A camera of a rig as a calibration may have it."""
    camera, R, t = view
    turn = Rotation.from_rotvec(rng.normal(0.0, TURN, 3)).as_matrix()
    return draw_camera(camera, rng), turn @ R, turn @ np.asarray(t) + rng.normal(0.0, move, 3)


def state(camera: rm.Camera, way: str) -> rm.Camera:
    """A camera with what is told of its calibration."""
    return replace(camera, focal_noise=FOCAL * camera.focal, centre_noise=CENTRE) if way == "stated" else camera


def state_rig(views: list[tuple[rm.Camera, Any, Any]], sizes: Any, move: float, way: str) -> rm.Rig:
    """A rig with what is told of its calibration."""
    known: dict[str, float] = {"rotation_noise": TURN, "position_noise": move} if way == "stated" else {}
    return rm.Rig([(state(camera, way), R, t) for camera, R, t in views], sizes=sizes, **known)


def squared_error(pose: rm.Pose | None, R: Floats, t: Floats, dof: int = 6) -> float:
    """Squared error of a pose by its covariance, in the ``dof`` directions in which that is largest."""
    if pose is None or pose.covariance is None:
        return np.inf
    error = np.concatenate([Rotation.from_matrix(R @ pose.R.T).as_rotvec(), t - pose.t])
    scale = np.sqrt(np.maximum(np.diagonal(pose.covariance), 1e-300))
    values, axes = np.linalg.eigh(pose.covariance / np.outer(scale, scale))
    return float((((error / scale) @ axes[:, 6 - dof :]) ** 2 / values[6 - dof :]).sum())


def match_images(way: str, seeds: range, n: int, upright: bool) -> Tally:
    """Single images of n points, of which nine in ten are detected, among four strays."""
    tally, up = Tally(), np.array([0.0, 1.0, 0.0])
    for seed in seeds:
        rng = np.random.default_rng([seed, 992])
        camera, source = state(draw_camera(CAMERA, rng), way), rng.uniform(-0.15, 0.15, (n, 3))
        R = Rotation.random(random_state=rng).as_matrix()
        t = np.array([*rng.uniform(-0.4, 0.4, 2), rng.uniform(0.8, 2.0)])
        pixels = CAMERA.project(source @ R.T + t) + rng.normal(0.0, SIGMA, (n, 2))
        seen, strays = np.flatnonzero(rng.random(n) < 0.9), rng.uniform((0, 0), (1280, 960), (4, 2))
        order = rng.permutation(len(seen) + 4)
        target, owner = np.concatenate([pixels[seen], strays])[order], np.append(seen, [-1] * 4)[order]
        known = {"vertical_camera": tuple(R @ up), "vertical_world": tuple(up)}
        problem = rm.UP2P(camera, **known) if upright else rm.P3P(camera)
        match = rm.match(source, target, problem, noise=0.7 if way == "larger noise" else SIGMA)
        used, dof = np.flatnonzero(match.assignment >= 0), 4 if upright else 6
        wrong = bool((owner[match.assignment[used]] != used).any())
        tally.add(match.status is rm.Status.MATCHED, wrong, squared_error(match.pose, R, t, dof), dof)
    return tally


def fly(tracker: rm.Tracker, frames: Iterator[dict[str, Any]], bodies: list[tuple[Any, int]], tally: Tally) -> None:
    """Add the bodies of one flight."""
    for frame in frames:
        frame = flights.merged(frame, 0.0)
        rig = frame["camera"].max(initial=0) > 0
        target = (frame["target"], frame["camera"]) if rig else frame["target"]
        match = tracker.update(target, time=float(frame["time"]))
        for label, number in bodies:
            one: Any = match if label is None else match.bodies[label]  # type: ignore[index]
            _, wrong, _ = flights.judged(frame, number, one, rig=rig)
            tally.add(one.status is rm.Status.MATCHED, wrong, squared_error(one.pose, *frame["poses"][number]), 6)


def fly_board(way: str, seeds: range) -> Tally:
    """A board before one camera, 40 frames a flight."""
    tally = Tally()
    for seed in seeds:
        camera = state(draw_camera(flights.BOARD_CAMERA, np.random.default_rng([seed, 994])), way)
        tracker = rm.Tracker(flights.BOARD, rm.P3P(camera), noise=0.9 if way == "larger noise" else 0.5)
        fly(tracker, flights.board_flight(seed, frames=40), [(None, 0)], tally)
    return tally


def fly_studio(way: str, seeds: range) -> Tally:
    """Ten markers before six cameras, 30 frames a flight."""
    tally, flights.CLUSTER = Tally(), STUDIO
    for seed in seeds:
        rng = np.random.default_rng([seed, 991])
        views = [draw_view((flights.HALL_CAMERA, turn, flights.AWAY), MOVE, rng) for turn in flights.TURNS]
        rig = state_rig(views, [flights.HALL_SIZE] * len(views), MOVE, way)
        tracker = rm.Tracker(STUDIO, rm.P3P(rig), noise=0.7 if way == "larger noise" else SIGMA)
        frames = (one for _, one in zip(range(30), flights.hall_flight(seed, frames=180), strict=False))
        fly(tracker, frames, [(None, 0)], tally)
    return tally


def fly_headset(xr: ModuleType, way: str, seeds: range) -> Tally:
    """Two controllers before four fisheyes of a headset, 40 frames a flight."""
    tally = Tally()
    for seed in seeds:
        rng = np.random.default_rng([seed, 993])
        exact = [(rm.Camera.from_opencv_fisheye(K, D), np.asarray(R), t) for K, D, R, t in xr.rig_views()]
        rig = state_rig([draw_view(one, MOVE_ON_HEAD, rng) for one in exact], [xr.RIG_SIZE] * 4, MOVE_ON_HEAD, way)
        source, normals, labels = xr.bodies("LR")
        tracker = rm.Tracker(
            source, rm.P3P(rig), noise=0.7 if way == "larger noise" else 0.3,
            normals=normals, view_angle=flights.VIEW, bodies=labels,
        )  # fmt: skip
        fly(tracker, xr.rig_flight(seed, frames=40), [("L", 0), ("R", 1)], tally)
    return tally


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--scale", type=float, default=0.1, help="of the number of scenes (default: 0.1)")
    ask.add_argument("--first-seed", type=int, default=1000)
    given = ask.parse_args()
    xr = scenes_of("xr", None)

    def seeds(count: int) -> range:
        return range(given.first_seed, given.first_seed + max(round(given.scale * count), 1))

    families = {
        "images, 6 points, one camera": lambda way: match_images(way, seeds(200), 6, False),
        "images, 12 points": lambda way: match_images(way, seeds(200), 12, False),
        "images, 8 points and the vertical": lambda way: match_images(way, seeds(200), 8, True),
        "flights, board": lambda way: fly_board(way, seeds(40)),
        "flights, ten markers before six cameras": lambda way: fly_studio(way, seeds(40)),
    }
    if xr is not None:
        families["flights, headset with four cameras"] = lambda way: fly_headset(xr, way, seeds(20))
    print("| scenes | bodies in frames | " + " | ".join(f"{way}: right (trusted), covered" for way in WAYS) + " |")
    print("|---|---|" + "---|" * len(WAYS))
    for name, run in families.items():
        every = [run(way) for way in WAYS]
        told = [f"{one.right} ({one.trusted}), {one.covered / max(one.right, 1):.2f}" for one in every]
        print(f"| {name} | {every[0].bodies} | " + " | ".join(told) + " |", flush=True)


if __name__ == "__main__":
    main()
