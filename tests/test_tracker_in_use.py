"""A tracker in a live program: times that make no sense, frames that are no input, threads, bumps and deadlines."""

from __future__ import annotations

import copy
import math
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from commands import run
from rootmatch.deadline import Deadline, OutOfTime
from rootmatch.model.clutter import PIECE, SCALES, estimate_clutter
from rootmatch.model.detection_model import DetectionModel
from rootmatch.tracking import belief
from rootmatch.tracking.followed_places import log_absence, overlooked_chance
from rootmatch.tracking.search_schedule import FIRST_STEPS, warn_of_time_unit
from test_deadline import Clock

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
POINTS = np.random.default_rng(3).uniform(-0.06, 0.06, (10, 3))
BUMP = Rotation.from_rotvec([0.05, -0.2, 0.1])
"""12 degrees."""


def frame(k: int, bumped: bool = False, stray: int = 3) -> NDArray[np.float64]:
    """Detections of a slowly turning body: all of its points, and some strays; the camera may have been bumped."""
    rng = np.random.default_rng(100 + k)
    places = POINTS @ Rotation.from_rotvec([0.3, 0.6 * k / 60.0, 0.1]).as_matrix().T + (0.05, 0.02, 0.7)
    pixels = CAMERA.project(BUMP.apply(places) + np.array([0.03, 0.0, 0.03]) if bumped else places)
    return np.concatenate([pixels + rng.normal(0.0, 0.2, pixels.shape), rng.uniform(0.0, 900.0, (stray, 2))])


def following(frames: int = 12) -> rm.Tracker:
    """A tracker after some frames."""
    tracker = rm.Tracker(POINTS, rm.P3P(CAMERA), noise=0.2)
    for k in range(frames):
        match = tracker.update(frame(k), time=k / 60.0)
    assert match
    return tracker


def test_no_pose_is_predicted_for_the_past() -> None:
    tracker = following()
    now = tracker.predicted(time=11 / 60.0)[None].covariance
    later = tracker.predicted(time=0.3)[None].covariance
    assert now is not None
    assert later is not None
    assert 0.0 < np.diag(now).min() < np.diag(later).min()
    for time in (10 / 60.0, -1.0):
        with pytest.raises(rm.InputError, match="before the last frame"):
            tracker.predicted(time=time)
    with pytest.raises(rm.InputError, match="give seconds"):
        tracker.predicted(time=math.nan)
    with pytest.raises(rm.InputError, match="frames in order"):
        tracker.update(frame(12), time=11 / 60.0)


@pytest.mark.parametrize("pause", [86400.0, 1e10], ids=["a day", "times in nanoseconds"])
def test_frames_are_matched_after_any_pause(pause: float) -> None:
    tracker = following()
    for k in range(12, 14):
        match = tracker.update(frame(k), time=k / 60.0 + pause)
        assert match
        assert match.assignment.tolist() == list(range(10))


@pytest.mark.parametrize(
    ("step", "advice"),
    [
        (16.7, "in milliseconds, divide them by 1000"),
        (1.67e4, "in microseconds, divide them by 1e6"),
        (1.67e7, "in nanoseconds, divide them by 1e9"),
    ],
)
def test_times_that_are_no_seconds_are_named(step: float, advice: str) -> None:
    steps = [step] * (FIRST_STEPS - 1)
    with pytest.warns(rm.InputWarning, match=advice):
        warn_of_time_unit(steps, step)


def test_a_frame_that_is_refused_leaves_the_tracker_as_it_was() -> None:
    tracker = following()
    spoiled, many = frame(12), frame(12, stray=10_000)
    spoiled[0, 0] = math.nan
    elsewhere = rm.Pose(np.eye(3), (0.0, 0.0, 2.0), 1e-4 * np.eye(6))
    undisturbed = copy.deepcopy(tracker)
    for target, prior in ((spoiled, None), (many, None), (spoiled, elsewhere)):
        with pytest.raises(rm.InputError, match="target"):
            tracker.update(target, time=12 / 60.0, prior=prior)
    for k in range(12, 15):
        match, other = (one.update(frame(k), time=k / 60.0) for one in (tracker, undisturbed))
        assert match
        assert match.probability == other.probability
        np.testing.assert_array_equal(match.pose.matrix, other.pose.matrix)  # type: ignore[union-attr]


@pytest.mark.parametrize("cameras", [1, 2])
def test_a_frame_of_too_few_detections_is_answered_whenever_it_comes(cameras: int) -> None:
    """Also while a search that other frames began goes on."""
    rng, size = np.random.default_rng(7), (640, 480)
    camera, shift = rm.Camera(500.0, 500.0, 320.0, 240.0, size=size), np.array([-0.1, 0.0, 0.0])
    rig = rm.Rig([(camera, np.eye(3), np.zeros(3)), (camera, np.eye(3), shift)])
    tracker = rm.Tracker(rng.uniform(-1.0, 1.0, (20, 3)), rm.P3P(camera if cameras == 1 else rig), noise=0.3)
    for k in range(9):
        each = [rng.uniform((0.0, 0.0), size, (1 if k % 3 == 2 else 25, 2)) for _ in range(cameras)]
        match = tracker.update(each if cameras > 1 else each[0])
        assert match.status is rm.Status.UNTRUSTED
        assert ("at least 4 needed" in match.advice) is (k % 3 == 2)


def test_threads_take_turns_with_a_tracker() -> None:
    tracker = following()
    with ThreadPoolExecutor(3) as threads:
        found = list(threads.map(lambda k: tracker.update(frame(12)), range(60)))
    assert all(found)
    assert pickle.loads(pickle.dumps(tracker)).update(frame(12))


def test_a_body_that_jumps_is_trusted_at_once_if_no_other_had_room_before() -> None:
    """After a bump of the camera all is elsewhere; the frame before showed nothing but the body and three strays."""
    tracker = following()
    for k in range(12, 16):
        match = tracker.update(frame(k, bumped=True), time=k / 60.0)
        assert match, match.advice
        np.testing.assert_array_equal(match.assignment, np.arange(10))


def test_a_body_that_jumps_is_ambiguous_if_another_may_have_been_there_and_the_advice_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracker = following()
    monkeypatch.setattr(belief, "overlooked_chance", lambda *_: 1.0)
    match = tracker.update(frame(12, bumped=True), time=12 / 60.0)
    assert match.status is rm.Status.AMBIGUOUS
    assert "a look-alike that came into view" in match.advice


def test_what_the_last_frame_had_no_room_for_was_not_in_view() -> None:
    """Then neither the body nor a copy was there, and either has come since."""
    step = 1.0 / 60.0
    empty = {"ago": step, "overlooked": 0.0}
    assert log_absence(1.0, step, math.inf, **empty) == pytest.approx(0.0, abs=0.3)
    assert log_absence(0.5, 1.0, math.inf, **empty) == pytest.approx(log_absence(1.0, step, math.inf, **empty))
    assert log_absence(0.5, 1.0, math.inf, ago=step) == pytest.approx(log_absence(0.5, 1.0, math.inf))


def test_how_much_is_overlooked_follows_from_the_rate_of_detection() -> None:
    model = DetectionModel(CAMERA, POINTS, frame(0), np.full(13, 0.2), rate=0.9)
    modes: Any = SimpleNamespace(assignments=np.arange(10)[None], visible=np.ones((1, 10)))
    expected = sum(math.comb(10, k) * 0.9**k * 0.1 ** (10 - k) for k in range(8))
    assert overlooked_chance(model, modes, 0, 7) == pytest.approx(expected)
    assert overlooked_chance(model, modes, 0, 10) == 1.0


def test_clutter_looks_at_the_deadline() -> None:
    """With 1,500 detections it takes 50 ms."""
    count = 1500
    rng, clock = np.random.default_rng(5), Clock(step=1.0)
    target = rng.uniform(0.0, 900.0, (count, 2))
    with pytest.raises(OutOfTime), Deadline(5.0, clock=clock).enforce():
        estimate_clutter(target, np.full(count, 0.3), np.array([8.1e5]))
    assert clock.now < 10.0 < SCALES * 256 * count / PIECE


def test_the_command_goes_on_after_a_bad_frame_if_asked_to(tmp_path: Path) -> None:
    rows = [f"{k},{x},{y}" for k in range(4) for x, y in frame(k).tolist()]
    spoiled = 17  # of the second frame
    rows[spoiled] = "1,nan,3"
    (tmp_path / "frames.csv").write_text("\n".join(["frame,x,y", *rows]) + "\n")
    model = ["x,y,z", *(",".join(map(str, point)) for point in POINTS.tolist())]
    (tmp_path / "model.csv").write_text("\n".join(model) + "\n")
    given = ["track", *(str(tmp_path / name) for name in ("model.csv", "frames.csv")), "--problem", "p3p"]
    given += ["--camera", "900,900,640,480", "--noise", "0.2"]
    refused = run(*given)
    assert refused.exit_code == 2
    result = run(*given, "--skip-bad-frames")
    assert result.exit_code == 0
    assert "frame 1 is left out" in result.stderr
    assert f"row {spoiled + 2}" in result.stderr
    assert [row.split(",")[0] for row in result.stdout.splitlines()[1:]] == ["0", "2", "3"]


def test_the_command_goes_on_after_a_late_frame_if_asked_to(tmp_path: Path) -> None:
    rows = [f"{k},{x},{y}" for k in (0, 2, 1, 2, 3) for x, y in frame(k).tolist()]  # a live pipe cannot be sorted
    (tmp_path / "frames.csv").write_text("\n".join(["frame,x,y", *rows]) + "\n")
    model = ["x,y,z", *(",".join(map(str, point)) for point in POINTS.tolist())]
    (tmp_path / "model.csv").write_text("\n".join(model) + "\n")
    given = ["track", *(str(tmp_path / name) for name in ("model.csv", "frames.csv")), "--problem", "p3p"]
    given += ["--camera", "900,900,640,480", "--noise", "0.2"]
    assert run(*given).exit_code == 2
    result = run(*given, "--skip-bad-frames")
    assert result.exit_code == 0
    assert "frame 1 is left out" in result.stderr
    assert "frame 1 after frame 2; frames are out of order" in result.stderr
    assert "frame 2 after frame 2" in result.stderr
    assert [row.split(",")[0] for row in result.stdout.splitlines()[1:]] == ["0", "2", "3"]
