"""Points that are hidden for a while: clutter that comes near one of them is not taken for it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.tracking.dark_points import DarkPoints
from rootmatch.tracking.followed_places import return_factor
from rootmatch.tracking.foreign_lights import LIT

CAMERA = rm.Camera(800.0, 800.0, 320.0, 240.0)
RATE = 60.0


def flight(seed: int, shown: int, frames: int = 60, gone: int = 25) -> tuple[int, int]:
    """Trusted frames, and those of them with a wrong match, of a body behind an occluder that leaves so many points."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.15, 0.15, (8, 3))
    first, turn = Rotation.random(random_state=seed), rng.normal(0.0, 0.8, 3)
    phase, speed = rng.uniform(0.0, 6.0, 3), rng.normal(0.0, 0.2, 3)
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.25, tracking=rm.TrackingOptions(interval=1.0 / RATE))
    trusted = wrong = 0
    for k in range(frames):
        angle = turn * np.sin(2.0 * k / RATE + phase)
        place = np.array([0.0, 0.0, 1.2]) + speed * np.sin(2.0 * k / RATE + phase)
        pixels = CAMERA.project(points @ (Rotation.from_rotvec(angle) * first).as_matrix().T + place)
        seen = np.flatnonzero((rng.random(8) < 0.95) & (np.arange(8) < (shown if k >= gone else 8)))
        target = np.concatenate([pixels[seen], rng.uniform((0.0, 0.0), (640.0, 480.0), (4, 2))])
        match = tracker.update(target + rng.normal(0.0, 0.25, target.shape))
        if match and k >= gone:
            trusted += 1
            told = match.assignment[match.assignment >= 0]
            wrong += not np.array_equal(seen[np.minimum(told, len(seen) - 1)], np.flatnonzero(match.assignment >= 0))
    return trusted, wrong


def test_clutter_near_a_hidden_point_is_not_taken_for_it() -> None:
    """Two points stay in view, too few for a pose: each further match is clutter."""
    counts = np.sum([flight(seed, 2) for seed in (0, 1, 3, 5)], axis=0)
    assert counts[0] <= 1


def test_three_points_that_stay_in_view_are_trusted() -> None:
    trusted, wrong = np.sum([flight(seed, 3) for seed in range(4)], axis=0)
    assert trusted > 60
    assert wrong == 0


def test_a_hidden_point_is_not_taken_for_a_neighbour_in_frame_after_frame() -> None:
    """Each frame leaves open which of two it is; the prediction must not follow one of them (six frames, once)."""
    assert flight(139, 3)[1] == 0


def finding(assignment: list[int], confidence: list[float], probability: float = 0.99) -> Any:
    """What `DarkPoints` looks at."""
    unmatched = np.where(np.array(assignment) < 0, confidence, 1.0 - np.array(confidence))
    modes = SimpleNamespace(visible=np.ones((1, 3)), assignments=np.array([assignment]), unmatched=unmatched[None])
    told = SimpleNamespace(probabilities=np.ones(1), clutter=0.001, modes=modes, unmatched=unmatched)
    options, model = SimpleNamespace(detection_rate=0.9), SimpleNamespace(images=())
    return SimpleNamespace(
        assignment=np.array(assignment), confidence=np.array(confidence), posterior=told, probability=probability,
        task=SimpleNamespace(options=options), model=model, posterior_and_model=(told, model), mode=0,
        matched_count=int((np.array(assignment) >= 0).sum()),
    )  # fmt: skip


def test_what_is_missed_again_and_again_is_dark() -> None:
    dark = DarkPoints()
    assert dark.at(0.0) is None
    lit: list[NDArray[np.float64]] = []
    for k in range(8):
        dark.take(finding([0, 1, -1 if k else 2], [0.999, 0.999, 0.999]), k / RATE)
        lit.append(dark.at((k + 1) / RATE))
    assert (np.array(lit)[:, :2] > 0.95).all()
    alone = np.array(lit)[:, 2]
    assert (np.diff(alone[:5]) < 0.0).all()
    assert alone[1] > 0.8, "one frame without it tells little"
    assert alone[-1] < 0.1
    assert dark.at(60.0)[2] == pytest.approx(LIT)


def test_what_is_found_again_is_no_surer_than_that_the_body_is_in_view() -> None:
    """Two lights near a wide prediction: the matches before do not vouch for them, nor do the frames after."""
    dark, pair = DarkPoints(), finding([7, -1, 8], [0.98, 0.99, 0.97])
    dark.take(finding([0, 1, 2], [0.999, 0.999, 0.999]), 0.0)
    assert dark.holds > 0.99
    dark.take(pair, 0.05, log_back=-8.0)
    assert dark.holds > 0.99, "more probably it was not found"
    dark.take(pair, 0.06, log_back=-6.0)
    present = return_factor(0.001, -6.0)
    assert 0.6 < present < 0.8
    assert dark.holds == pytest.approx(present**2 * 0.97 / 0.98)
    dark.take(pair, 0.06)
    assert dark.holds == pytest.approx(present**2 * 0.97 / 0.98), "a match is at most as probable as when it was met"


@pytest.mark.parametrize(("columns", "poses"), [(3, 4), (4, 2)])
def test_equal_poses_stay_as_probable_as_each_other(columns: int, poses: int) -> None:
    """Matches that only some of the poses have are not doubtful, given one of these, nor are points dark by that."""
    x, y = np.meshgrid(0.1 * np.arange(columns), 0.1 * np.arange(3))
    board, rng = np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()]), np.random.default_rng(3)
    normals = np.tile([0.0, 0.0, -1.0], (len(board), 1))
    tracker, told = rm.Tracker(board, rm.P3P(CAMERA), noise=0.3, normals=normals), list[float]()
    for k in range(20):
        R = Rotation.from_rotvec([0.5 + 0.01 * k, 0.2, 0.02 * k]).as_matrix()
        pixels = CAMERA.project(board @ R.T + (0.01 * k - 0.2, 0.0, 1.0))
        shown = pixels[rng.random(len(board)) < 0.93]
        match = tracker.update(np.concatenate([shown, rng.uniform((0.0, 0.0), (640.0, 100.0), (2, 2))]))
        told.append(match.probability or 0.0)
        assert match.status is rm.Status.AMBIGUOUS
    assert np.median(told) == pytest.approx(1.0 / poses, rel=0.1)
    assert min(told) > 0.3 / poses


def test_two_points_whose_detections_may_be_exchanged_are_not_dark() -> None:
    """Each has the detection of the other, if not its own: it is detected either way."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.15, 0.15, (8, 3))
    points[1] = points[0] + (0.0004, 0.0, 0.0)
    tracker, told = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3), list[float]()
    for k in range(30):
        R = Rotation.from_rotvec([0.3, 0.01 * k, 0.1]).as_matrix()
        pixels = CAMERA.project(points @ R.T + (0.01 * k - 0.1, 0.0, 1.0))
        match = tracker.update(pixels + rng.normal(0.0, 0.3, pixels.shape))
        told.append(match.probability or 0.0)
    assert min(told) > 0.4
