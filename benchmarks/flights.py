"""Flights through `Tracker`: a room, a rig with two controllers, a drone before a fisheye, a board, a mirror, a hall.

Also a vehicle that localises itself by reflectors, in a plane; and what nothing but chance could decide, as in
alike_flights.py: two objects of the same kind, and a regular ceiling.

    python benchmarks/flights.py --families room rig drone board mirror --flights 6 --first-seed 20000
    python benchmarks/flights.py --families room --merge 3 --resolution 3  # detections within 3 px are one blob
    python benchmarks/flights.py --families rig --off 0.5  # each camera is turned by 0.5 px about each axis

Right: of the bodies that show five LEDs or more in a frame, those with no match wrong and nine tenths of the shown ones
matched. Wrong: frames of a body that are called matched and have a wrong match; "run": the longest one; "hidden": those
in which the body shows fewer than five LEDs. "Covered": of
the frames that are matched and right, those whose pose is within the 95 % region of its covariance. "Flipped": those
whose pose is more than 20° off, as a board's is with its depth reversed, and the longest run of these. Times are
processor milliseconds a frame of one thread, all kernels compiled, after `gc.freeze()`, the first frame of each flight
left out.
Defaults were chosen on seeds below 2000. Scenes are found as by constellations.py; the board is made here.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from types import ModuleType
from typing import Any

import numba
import numpy as np
from alike_flights import alike_tracker, ceiling_flight, twins_flight
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from shared import parser, scenes_of, squared_error
from vehicle_flight import vehicle_flight, vehicle_tracker

import rootmatch as rm

FRAMES = {
    "room": 60, "rig": 150, "drone": 300, "board": 120, "mirror": 200, "twins": 150, "named": 150, "ceiling": 90,
    "hall": 180, "vehicle": 90,
}  # fmt: skip
RIGS = "rig", "hall"
"""Families before several cameras."""
VIEW = np.radians(70.0)
FEW = 5
"""LEDs that a body shows from which its pose is asked for."""
FLIPPED = np.radians(20.0)
"""Error of a rotation from which a pose counts as another one."""
BOARD = np.column_stack([np.random.default_rng(1).uniform(-0.1, 0.1, (9, 2)), np.zeros(9)])
"""Nine LEDs in a plane, 20 cm wide."""
ROUND = np.random.default_rng(7).uniform(-0.08, 0.08, (10, 3))
"""Ten LEDs that are seen from all sides."""
OCCLUDED = range(80, 140)
"""Frames in which a mirror shows them, and nothing else does."""
CLUSTER = np.random.default_rng(11).uniform(-0.08, 0.08, (5, 3))
"""Five markers of a body before the cameras of a hall."""
HIDDEN = range(60, 120)
"""Frames in which a hall does not show it."""
HALL_CAMERA, HALL_SIZE, AWAY = rm.Camera(900.0, 900.0, 640.0, 480.0), (1280, 960), np.array([0.0, 0.0, 6.0])
TURNS = [Rotation.from_euler("yx", [60.0 * k, -25.0], degrees=True).as_matrix().T for k in range(6)]
"""Of six cameras, 6 m away on a circle."""
BOARD_CAMERA = rm.Camera(500.0, 500.0, 320.0, 240.0)


@dataclass
class Tally:
    """What came of the flights of one family."""

    shown: int = 0
    right: int = 0
    trusted: int = 0
    wrong: int = 0
    hidden: int = 0
    longest: int = 0
    covered: int = 0
    posed: int = 0
    flipped: int = 0
    longest_flipped: int = 0
    wrong_frames: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)


def tracker_of(
    xr: ModuleType, family: str, resolution: float | None, off: float = 0.0
) -> tuple[rm.Tracker, list[tuple[Any, int]]]:
    """A tracker that knows how near detections are one, and label and number of each body.

    ``off``: error of its rig's calibration, the standard deviation in pixels of a turn of each camera about each axis.
    """
    if family in ("twins", "named", "ceiling"):
        return alike_tracker(family), [(None, 0)]
    if family == "board":
        return rm.Tracker(BOARD, rm.P3P(BOARD_CAMERA), noise=0.5, resolution=resolution), [(None, 0)]
    if family == "vehicle":
        return vehicle_tracker(), [(None, 0)]
    camera: Any = rm.Camera(900.0, 900.0, 640.0, 480.0)
    if family == "hall":
        hall = rm.P3P(rm.Rig([(HALL_CAMERA, turn, AWAY) for turn in TURNS], sizes=[HALL_SIZE] * 6))
        return rm.Tracker(CLUSTER, hall, noise=0.25, resolution=resolution), [(None, 0)]
    if family == "mirror":
        return rm.Tracker(ROUND, rm.P3P(camera), noise=0.3, resolution=resolution), [(None, 0)]
    fisheye = rm.Camera.from_opencv_fisheye(xr.FISHEYE_K, xr.FISHEYE_D)
    if family == "drone":
        source = xr.drone()
        return rm.Tracker(source, rm.P3P(fisheye), noise=0.3, resolution=resolution), [(None, 0)]
    kinds = "HLR" if family == "room" else "LR"
    source, normals, labels = xr.bodies(kinds)
    if family == "rig":
        rng, views = np.random.default_rng(6), []
        for K, D, R, t in xr.rig_views():
            turn = Rotation.from_rotvec(off / K[0, 0] * rng.normal(size=3)).as_matrix()
            views.append((rm.Camera.from_opencv_fisheye(K, D), turn @ R, turn @ t))
        camera = rm.Rig(views, sizes=[xr.RIG_SIZE] * 4)
    tracker = rm.Tracker(
        source, rm.P3P(camera), noise=0.3, normals=normals, view_angle=VIEW, bodies=labels, resolution=resolution
    )
    return tracker, [(kind, k) for k, kind in enumerate(kinds)]


def frames_of(xr: ModuleType, family: str, seed: int) -> Iterator[dict[str, Any]]:
    """The frames of one flight."""
    made = {"room": xr.room_flight, "rig": xr.rig_flight, "drone": xr.drone_flight, "board": board_flight}
    made |= {"mirror": mirror_flight, "twins": twins_flight, "ceiling": ceiling_flight, "hall": hall_flight}
    made |= {"vehicle": vehicle_flight}
    made["named"] = partial(twins_flight, named=True)
    flight: Iterator[dict[str, Any]] = made[family](seed, frames=FRAMES[family])
    return flight


def board_flight(seed: int, frames: int) -> Iterator[dict[str, Any]]:
    """A board that turns and drifts 1.2 to 2.5 m before a camera; of its LEDs, 95 % are detected, among three strays.

    At that distance its two poses often differ by less than the noise of .5 px, and they meet where it faces the
    camera.
    """
    rng = np.random.default_rng([seed, 5])
    first, rate, change = Rotation.random(random_state=rng), rng.normal(0.0, 0.6, 3), rng.normal(0.0, 0.4, 3)
    place, speed = rng.uniform((-0.3, -0.2, 1.2), (0.3, 0.2, 2.5)), rng.normal(0.0, 0.15, 3)
    for k in range(frames):
        time_ = k / 60.0
        R = (Rotation.from_rotvec(rate * time_ + change * time_**2) * first).as_matrix()
        t = place + speed * time_
        seen = np.flatnonzero(rng.random(len(BOARD)) < 0.95)
        image = BOARD_CAMERA.project(BOARD[seen] @ R.T + t) + rng.normal(0.0, 0.5, (len(seen), 2))
        target = np.concatenate([image, rng.uniform((0.0, 0.0), (640.0, 480.0), (3, 2))])
        owner = np.full((len(target), 2), -1)
        owner[: len(seen)] = np.column_stack([np.zeros(len(seen), int), seen])
        order = rng.permutation(len(target))
        yield {
            "target": target[order], "camera": np.zeros(len(target), int), "owner": owner[order], "time": time_,
            "poses": [(R, t)],
        }  # fmt: skip


def mirror_flight(seed: int, frames: int) -> Iterator[dict[str, Any]]:
    """A body about 1 m before a camera, and its reflection in a wall behind it; two lamps. It is hidden for a second.

    Without much perspective a reflection is a body in another pose, so that no single image without the body excludes
    it; in the frames after, the body itself is there again.
    """
    rng = np.random.default_rng([seed, 99])
    knots = np.linspace(-0.2, frames / 60.0 + 0.2, 8)
    place = CubicSpline(knots, (-0.15, 0.0, 1.0) + rng.uniform(-1.0, 1.0, (8, 3)) * (0.12, 0.15, 0.15))
    first, turn = Rotation.random(random_state=rng), CubicSpline(knots, rng.uniform(-0.8, 0.8, (8, 3)))
    across = Rotation.from_euler("y", rng.uniform(-20.0, 20.0), degrees=True).apply((0.0, 0.0, 1.0))
    lamps = rng.uniform((0.0, 0.0), (1280.0, 300.0), (2, 2))
    camera = rm.Camera(900.0, 900.0, 640.0, 480.0)
    for k in range(frames):
        R, t = (Rotation.from_rotvec(turn(k / 60.0)) * first).as_matrix(), place(k / 60.0)
        here = ROUND @ R.T + t
        there = here - 2.0 * np.outer(here @ across - 1.5, across)
        images, owners = [lamps], [np.full((2, 2), -1)]
        for number, points in ((0, here), (1, there)):
            seen = np.flatnonzero(rng.random(len(points)) < 0.97)
            seen = seen[: 0 if number == 0 and k in OCCLUDED else None]
            images.append(camera.project(points[seen]))
            owners.append(np.column_stack([np.full(len(seen), number), seen]))
        target, owner = np.concatenate(images), np.concatenate(owners)
        inside = ((target > 0.0) & (target < (1280.0, 960.0))).all(axis=1)
        target = target + rng.normal(0.0, 0.3, target.shape)
        order = rng.permutation(np.flatnonzero(inside))
        yield {
            "target": target[order], "camera": np.zeros(len(order), int), "owner": owner[order], "time": k / 60.0,
            "poses": [(R, t)],
        }  # fmt: skip


def hall_flight(seed: int, frames: int) -> Iterator[dict[str, Any]]:
    """A body of five markers in a hall with six cameras, which see each marker with .8; it is gone for a second.

    Each image has six strays, three of them at rest.
    """
    rng = np.random.default_rng([seed, 77])
    knots = np.linspace(-0.2, frames / 60.0 + 0.2, 8)
    place = CubicSpline(knots, rng.uniform((-1.5, -0.6, -1.5), (1.5, 0.6, 1.5), (8, 3)))
    first, turn = Rotation.random(random_state=rng), CubicSpline(knots, rng.uniform(-1.0, 1.0, (8, 3)))
    still = rng.uniform((0.0, 0.0), HALL_SIZE, (len(TURNS), 3, 2))
    for k in range(frames):
        R, t = (Rotation.from_rotvec(turn(k / 60.0)) * first).as_matrix(), place(k / 60.0)
        images, owners, cameras = [], [], []
        for camera, (view, lamps) in enumerate(zip(TURNS, still, strict=True)):
            pixels = HALL_CAMERA.project((CLUSTER @ R.T + t) @ view.T + AWAY)
            inside = ((pixels > 0.0) & (pixels < HALL_SIZE)).all(axis=1) & (rng.random(len(CLUSTER)) < 0.8)
            seen = np.flatnonzero(inside & (k not in HIDDEN))
            images += [pixels[seen], lamps]
            images[-2:] = [one + rng.normal(0.0, 0.25, one.shape) for one in images[-2:]]
            images.append(rng.uniform((0.0, 0.0), HALL_SIZE, (3, 2)))
            owners += [np.column_stack([np.zeros(len(seen), int), seen]), np.full((6, 2), -1)]
            cameras += [camera] * (len(seen) + 6)
        order = rng.permutation(len(cameras))
        yield {
            "target": np.concatenate(images)[order], "camera": np.array(cameras)[order],
            "owner": np.concatenate(owners)[order], "time": k / 60.0, "poses": [(R, t)],
        }  # fmt: skip


def merged(frame: dict[str, Any], nearer: float) -> dict[str, Any]:
    """A frame in which detections of a camera that are nearer than so many pixels are one, at their mean.

    ``owners`` has all points of each; its ``owner`` is the first of them.
    """
    target, camera, owner = frame["target"], frame["camera"], frame["owner"]
    near = np.linalg.norm(target[:, None] - target[None], axis=2) < nearer
    near &= camera[:, None] == camera
    label = connected_components(near, directed=False)[1] if len(target) else np.empty(0, np.int64)
    first = np.unique(label, return_index=True)[1]
    parts = [np.flatnonzero(label == label[k]) for k in first]
    return frame | {
        "target": np.array([target[own].mean(axis=0) for own in parts]).reshape(-1, 2),
        "camera": camera[first],
        "owner": owner[first],
        "owners": [owner[own] for own in parts],
    }


def fly(
    xr: ModuleType,
    family: str,
    seed: int,
    tally: Tally,
    merge: float = 0.0,
    resolution: float = 0.0,
    off: float = 0.0,
    limit: float | None = None,
) -> None:
    """Add one flight to a tally; ``limit``: seconds for each frame after the first."""
    tracker, bodies = tracker_of(xr, family, resolution or None, off)
    runs, flips = [0] * len(bodies), [0] * len(bodies)
    for k, frame in enumerate(frames_of(xr, family, seed)):
        frame = merged(frame, merge)
        target: Any = (frame["target"], frame["camera"]) if family in RIGS else frame["target"]
        started = time.process_time()
        match = tracker.update(
            target, time=float(frame["time"]), prior=frame.get("prior"), max_seconds=limit if k else None
        )
        if k:
            tally.times.append(1e3 * (time.process_time() - started))
        for place, (label, number) in enumerate(bodies):
            one = match if label is None else match.bodies[label]
            right, wrong, shown = judged(frame, number, one, rig=family in RIGS)
            trusted = one.status is rm.Status.MATCHED
            bad = trusted and wrong
            tally.shown += shown
            tally.right += shown and right
            tally.trusted += trusted
            tally.wrong += bad
            tally.hidden += bad and not shown
            runs[place] = runs[place] + 1 if bad else 0
            tally.longest = max(tally.longest, runs[place])
            if bad:
                tally.wrong_frames.append(f"{seed} frame {k} {label}")
            if trusted and right:
                tally.posed += 1
                tally.covered += _covered(one.pose, *frame["poses"][number])
            flipped = trusted and right and _error(one.pose, frame["poses"][number][0]) > FLIPPED
            tally.flipped += flipped
            flips[place] = flips[place] + 1 if flipped else 0
            tally.longest_flipped = max(tally.longest_flipped, flips[place])


def judged(frame: dict[str, Any], number: int, one: Any, rig: bool) -> tuple[bool, bool, bool]:
    """Whether what is told of a body is right, has a match wrong, and whether it shows `FEW` points."""
    mine = [set(owners[owners[:, 0] == number, 1].tolist()) for owners in frame["owners"]]
    count = sum(bool(points) for points in mine)
    told = one.sightings.assignment if rig else one.assignment[None]
    named = [
        point in mine[detection] and (not rig or frame["camera"][detection] == camera)
        for camera, row in enumerate(np.asarray(told))
        for point, detection in enumerate(row)
        if detection >= 0
    ]
    shown = min(count, len(set().union(*mine)))  # five sightings of two LEDs determine no pose
    return all(named) and sum(named) >= 0.9 * count - 1e-9, not all(named), shown >= FEW


def _error(pose: rm.Pose | None, R: NDArray[np.float64]) -> float:
    """Angle in radians between a rotation and the true one; infinite without a pose."""
    if pose is None:
        return np.inf
    cosine = np.trace(R @ pose.R.T) / 2.0 if len(R) == 2 else (np.trace(R @ pose.R.T) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _covered(pose: rm.Pose | None, R: NDArray[np.float64], t: NDArray[np.float64]) -> bool:
    """Whether the truth lies within the 95 % region of a pose."""
    if pose is None or pose.covariance is None:
        return False
    return squared_error(pose, R, t) <= chi2.ppf(0.95, len(pose.covariance))


def main() -> None:
    ask = parser(__doc__, flights=3, first_seed=1000)
    ask.add_argument("--families", nargs="+", choices=sorted(FRAMES), default=sorted(FRAMES))
    ask.add_argument("--merge", type=float, default=0.0, help="pixels below which detections are one blob")
    ask.add_argument("--resolution", type=float, default=0.0, help="what the tracker is told of that")
    ask.add_argument("--off", type=float, default=0.0, help="pixels by which the cameras of the rig are turned")
    ask.add_argument("--limit", type=float, help="seconds for each frame after the first")
    ask.add_argument("--scenes", help="folder of the scenes")
    given = ask.parse_args()
    numba.set_num_threads(1)
    xr = scenes_of("xr", given.scenes)
    if xr is None:
        return
    for family in given.families:
        fly(xr, family, given.first_seed - 1, Tally(), given.merge, given.resolution, given.off)  # compiles
        gc.freeze()
        tally = Tally()
        for seed in range(given.first_seed, given.first_seed + given.flights):
            fly(xr, family, seed, tally, given.merge, given.resolution, given.off, given.limit)
        print(
            f"{family}: {given.flights} flights from {given.first_seed}: right {tally.right} of {tally.shown} "
            f"({tally.right / max(tally.shown, 1):.3f}); trusted {tally.trusted}, of those wrong {tally.wrong}, "
            f"{tally.hidden} hidden, longest run {tally.longest}; covered {tally.covered} of {tally.posed} "
            f"({tally.covered / max(tally.posed, 1):.3f}), flipped {tally.flipped}, longest run "
            f"{tally.longest_flipped}; ms a frame: median {np.median(tally.times):.2f}, "
            f"99 % {np.quantile(tally.times, 0.99):.1f}, worst {max(tally.times):.1f}",
            flush=True,
        )
        for line in tally.wrong_frames[:20]:
            print("   wrong:", line)


if __name__ == "__main__":
    main()
