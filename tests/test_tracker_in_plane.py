"""Bodies that move in a plane: a vehicle amid a map of reflectors, two trolleys on a floor, a map of unknown scale."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from commands import run
from rootmatch.tracking.motion_filter import MotionFilter, transition
from test_cli_frames import write

Floats = NDArray[np.float64]
INTERVAL = 0.1
DRIVING = rm.TrackingOptions(interval=INTERVAL, motion=rm.MotionOptions(velocity=0.2, acceleration=0.1))
"""1.5 m/s in a hall of reflectors with a radius of some 8 m."""


def turn(angle: float) -> Floats:
    """Rotation (2, 2) by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def drive(seed: int, frames: int, scale: float = 1.0) -> list[tuple[Floats, NDArray[np.int64], rm.Pose]]:
    """Scans (n', 2) of a vehicle, the reflector of each echo, -1 for a stray, and the vehicle's true pose."""
    rng = np.random.default_rng(seed)
    out, place, heading = [], np.array([8.0, 6.0]), 0.3
    for k in range(frames):
        heading += 0.03 * np.sin(0.2 * k)
        place = place + 0.15 * np.array([np.cos(heading), np.sin(heading)])
        R = turn(-heading)
        away = np.linalg.norm(MAP - place, axis=1)
        seen = np.flatnonzero((away < 9.0) & (rng.random(len(MAP)) < 0.9))
        scan = scale * np.concatenate([(MAP[seen] - place) @ R.T, rng.uniform(-8.0, 8.0, (3, 2))])
        label = np.append(seen, [-1] * 3)
        order = rng.permutation(len(scan))
        out.append(((scan + rng.normal(0.0, 0.02, scan.shape))[order], label[order], rm.Pose(R, -scale * R @ place)))
    return out


MAP = np.random.default_rng(5).uniform((0.0, 0.0), (24.0, 14.0), (26, 2))


def wrong_pairs(match: rm.Match, label: NDArray[np.int64]) -> int:
    """Matches that are not of the reflector itself."""
    return sum(int(label[j] != i) for i, j in match.pairs)


def test_a_vehicle_is_followed_below_its_map() -> None:
    """Also through frames of which one shows nothing and one a few strays."""
    tracker = rm.Tracker(MAP, rm.Rigid(), noise=0.02, tracking=DRIVING)
    scans, inside = drive(1, 30), []
    for k, (scan, label, true) in enumerate(scans):
        if k in (12, 13):
            scan, label = scan[:0] if k == 12 else scan[label < 0], label[:0] if k == 12 else label[label < 0]
        match = tracker.update(scan)
        assert bool(match) == (k not in (12, 13))
        assert wrong_pairs(match, label) == 0
        if not match:
            continue
        pose = match.fused_pose or match.pose
        assert pose is not None
        assert pose.R.shape == (2, 2)
        off = np.array([np.arctan2((pose.R @ true.R.T)[1, 0], (pose.R @ true.R.T)[0, 0]), *(pose.t - true.t)])
        inside.append(off @ np.linalg.solve(pose.covariance, off) < 7.81)  # 95 % of three degrees of freedom
    assert np.mean(inside) > 0.8
    (predicted,) = tracker.predicted().values()
    assert predicted.covariance is not None
    assert predicted.covariance.shape == (3, 3)
    assert np.linalg.norm(predicted.t - scans[-1][2].t) < 0.5


def test_what_is_known_of_a_frame_is_taken_in_the_plane() -> None:
    tracker = rm.Tracker(MAP, rm.Rigid(), noise=0.02, tracking=DRIVING)
    for scan, label, true in drive(2, 5):
        heading = rm.PosePrior(rotation=(true.R, 0.02))
        match = tracker.update(scan, prior=heading)
        assert match
        assert match.prior_holds
        assert wrong_pairs(match, label) == 0


def test_a_scale_is_followed_in_the_plane() -> None:
    tracker = rm.Tracker(MAP, rm.Similarity(), noise=(0.0, 0.05), tracking=DRIVING)
    for scan, label, _ in drive(3, 6, scale=2.5):
        match = tracker.update(scan)
        assert match
        assert wrong_pairs(match, label) == 0
        assert match.pose is not None
        assert abs(match.pose.scale / 2.5 - 1.0) < 0.01


def test_two_bodies_that_are_alike_keep_their_names_on_a_floor() -> None:
    rng = np.random.default_rng(4)
    trolley = rng.uniform(-0.5, 0.5, (6, 2))
    bodies = ["left"] * 6 + ["right"] * 6
    tracker = rm.Tracker(np.tile(trolley, (2, 1)), rm.Rigid(), noise=0.004, bodies=bodies)
    names = []
    for k in range(8):
        places = np.array([[0.0, 0.01 * k], [2.0, -0.01 * k]])
        poses = [trolley @ turn(0.02 * k).T + place for place in places]
        match = tracker.update(np.concatenate(poses) + rng.normal(0.0, 0.004, (12, 2)))
        if k:  # which is which is a convention of the first frame
            assert all(match.bodies[name] for name in ("left", "right"))
            names.append(int(match.bodies["left"].assignment[0] < 6))
    assert len(set(names)) == 1


def test_a_filter_in_a_plane_predicts_as_one_of_its_coordinates() -> None:
    """Against the law of one coordinate: what moves in a plane gains nothing out of it."""
    covariance = np.diag([1e-4, 4e-4, 9e-4])
    options = DRIVING.motion
    points = MAP - MAP.mean(axis=0)
    away = rm.Pose(np.eye(2), (100.0, 0.0), covariance)  # not among its points
    filter_ = MotionFilter(points, away, 0.0, options)
    predicted = filter_.predicted(0.5)
    F, added = transition(0.5, options.persistence)
    radius = np.sqrt((points**2).sum(axis=1).mean())
    for k, (variance, speed, push) in enumerate(
        [(1e-4, options.angular_velocity, options.angular_acceleration)]
        + [(one, options.velocity * radius, options.acceleration * radius) for one in (4e-4, 9e-4)]
    ):
        before = np.diag([variance, speed**2, push**2])
        expected = (F @ before @ F.T + push**2 * added)[0, 0]
        assert predicted.covariance is not None
        assert predicted.covariance[k, k] == pytest.approx(expected, rel=1e-6)
    factor = filter_.factor
    for k in range(1, 20):  # frames that show it where it is expected: the plane itself is no evidence of its calm
        filter_.update(rm.Pose(np.eye(2), (100.0, 0.0), covariance), 0.5 * k)
        assert filter_.predicted(0.5 * k).R.shape == (2, 2)
    assert options.min_scale <= filter_.factor < factor


def test_a_plane_on_the_command_line(tmp_path: Path) -> None:
    scans = drive(1, 4)
    model = write(tmp_path / "map.csv", "x,y", MAP.tolist())
    rows = [[k, *point] for k, (scan, _, _) in enumerate(scans) for point in scan.tolist()]
    frames = write(tmp_path / "frames.csv", "frame,x,y", rows)
    options = "--problem", "rigid", "--noise", "0.02", "--rate", 10
    result = run("track", model, frames, *options, "--json")
    told = [json.loads(line) for line in result.stdout.splitlines()]
    assert [one["status"] for one in told] == ["matched"] * 4
    for one, (_, _, true) in zip(told, scans, strict=True):
        assert np.linalg.norm(np.subtract(one["pose"]["t"], true.t)) < 0.1
