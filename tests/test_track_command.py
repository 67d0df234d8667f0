"""What `rootmatch track` says beside the poses: reasons, contradictions, frames that wait; and how bodies move."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from commands import run
from rootmatch.cli import track_summary
from rootmatch.cli.error_messages import rephrase_advice
from rootmatch.cli.track import tracking_options
from rootmatch.cli.track_summary import WAITING, Queue
from rootmatch.problems.pose_fit.pose_checks import quaternion_to_rotation
from test_cli_frames import FRAMES, OPTIONS, folder, write
from test_tracker import frame

__all__ = ["folder"]
DOWN = "vx,vy,vz,wx,wy,wz,v_sigma"


def verticals(folder: Path, sign: float) -> list[list[Any]]:
    """The direction y of the model in each of the first frames, or its opposite."""
    lines = run("track", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--json").stdout.splitlines()
    quaternions = [json.loads(line)["pose"]["quaternion"] for line in lines[:4]]
    turned = [sign * quaternion_to_rotation(one, "xyzw")[:, 1] for one in quaternions]
    return [[k, *one.tolist(), 0, 1, 0, 1] for k, one in enumerate(turned)]


def test_a_vertical_that_is_upside_down_is_said_to_be_contradicted(folder: Path, tmp_path: Path) -> None:
    """A correction of first order does not see it: every frame is matched."""
    rows = [[k, *point] for k in range(4) for point in frame(k)[0].tolist()]
    frames = write(tmp_path / "frames.csv", "frame,x,y", rows)
    for sign in (1.0, -1.0):
        known = write(tmp_path / "known.csv", f"frame,{DOWN}", verticals(folder, sign))
        result = run("track", folder / "model.csv", frames, *OPTIONS, "--known", known, "--json")
        told = [json.loads(line) for line in result.stdout.splitlines()]
        assert all(one["status"] == "matched" for one in told)
        assert [one["prior_holds"] for one in told] == [sign > 0.0] * 4
        assert ("contradicts the prior" in told[3]["advice"]) == (sign < 0.0)
        assert ("warning: 4 of 4 matches contradict what is known" in result.stderr) == (sign < 0.0)


def test_a_first_frame_that_shows_too_little_is_matched_where_its_pose_is_predicted(
    folder: Path, tmp_path: Path
) -> None:
    """And the frames after it follow; a file that is not a pose is refused."""
    image, truth = frame(0)
    few = image[truth[truth >= 0][:4]].tolist()
    rows = [[0, *point] for point in few] + [[1, *point] for point in frame(1)[0].tolist()]
    both = folder / "model.csv", write(tmp_path / "frames.csv", "frame,x,y", rows)
    whole = write(tmp_path / "whole.csv", "frame,x,y", [[0, *point] for point in image.tolist()])
    seen = json.loads(run("track", both[0], whole, *OPTIONS, "--json").stdout)["pose"]
    predicted, covariance = tmp_path / "pose.json", (1e-4 * np.eye(6)).tolist()
    predicted.write_text(json.dumps({"R": seen["R"], "t": seen["t"], "covariance": covariance}))
    alone = run("track", *both, *OPTIONS, "--json").stdout.splitlines()
    told = run("track", *both, *OPTIONS, "--prior", predicted, "--json").stdout.splitlines()
    assert [json.loads(line)["status"] for line in alone] == ["untrusted", "matched"]
    assert [json.loads(line)["status"] for line in told] == ["matched", "matched"]
    refused = run("track", *both, *OPTIONS, "--prior", both[1])
    assert refused.exit_code == 2
    assert "frames.csv" in refused.stderr


def test_why_frames_are_not_matched_is_said_once(folder: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    noise = [[k, *point] for k in range(3) for point in rng.uniform(0.0, 640.0, (3 if k else 8, 2)).tolist()]
    frames = write(tmp_path / "frames.csv", "frame,x,y", noise)
    result = run("track", folder / "model.csv", frames, *OPTIONS)
    assert result.exit_code == 1
    assert (
        "2 of the 3 that are not matched: no trustworthy match: 3 detections given, at least 4 needed" in result.stderr
    )
    assert result.stderr.count("no trustworthy match") == 1
    one = write(tmp_path / "one.csv", "frame,x,y", [row for row in noise if row[0] == 1])
    assert (
        "the one that is not matched: no trustworthy match" in run("track", folder / "model.csv", one, *OPTIONS).stderr
    )
    lines = run("track", folder / "model.csv", frames, *OPTIONS, "--json").stdout.splitlines()
    assert "at least 4 needed" in json.loads(lines[2])["advice"]
    assert json.loads(lines[2])["prior_holds"] is None


def test_an_advice_names_options() -> None:
    told = "`search_budget` ended it; raise it in `TrackingOptions`, or give a larger `noise=`"
    assert rephrase_advice(told) == "`--search-budget` ended it; raise it, or give a larger `--noise`"
    told = "give `noise=0.7`, `noise=(0.1, 0.2)`, a vertical (`UP2P`), or a `prior`; see `confidence` and `diagnose`"
    assert rephrase_advice(told) == (
        "give `--noise 0.7`, `--noise 0.1,0.2`, a vertical (`--problem up2p`), or a `--prior`; see `confidence` and "
        "`rootmatch match --diagnose`"
    )
    assert rephrase_advice("all such bodies with `bodies=`, that `MotionOptions` allows") == (
        "all such bodies with a column `body`, that `--velocity` and `--acceleration` allows"
    )


def test_options_of_motions_are_taken_in_degrees(folder: Path) -> None:
    names = "velocity", "acceleration", "angular_velocity", "angular_acceleration", "search_budget"
    given = dict(zip(names, (0.3, 1.0, 90.0, None, 1000), strict=True))
    options = tracking_options(given)
    assert options.motion == rm.MotionOptions(velocity=0.3, acceleration=1.0, angular_velocity=np.pi / 2)
    assert options.search_budget == 1000
    assert tracking_options(dict.fromkeys(names)) == rm.TrackingOptions()
    both = folder / "model.csv", folder / "frames.csv"
    refused = run("track", *both, *OPTIONS, "--angular-velocity", -1)
    assert "--angular-velocity: -1 given; give a number above 0" in refused.stderr
    assert run("track", *both, *OPTIONS, "--velocity", 20, "--search-budget", 50000).exit_code == 0


@pytest.mark.parametrize(("seconds", "there", "late"), [(0.05, True, True), (0.01, True, False), (0.05, False, False)])
def test_frames_that_wait_longer_and_longer_are_said_once(
    monkeypatch: pytest.MonkeyPatch, seconds: float, there: bool, late: bool
) -> None:
    """Not those of a recording, which are answered sooner than they were taken, nor where none is waiting."""
    monkeypatch.setattr(track_summary, "_is_ready", lambda: there)
    queue, now = Queue(), [0.0]
    monkeypatch.setattr(queue, "_clock", lambda: now[0])
    told = []
    for k in range(6 * WAITING):
        now[0] += seconds
        told.append(queue.take(k / 30.0, seconds))
    said = [one for one in told if one]
    assert len(said) == late
    assert not late or ("50 ms" in said[0] and "--max-seconds" in said[0])


@pytest.mark.parametrize("sigma", [0.35, 0.7, 1.0])
def test_degrees_for_radians_are_asked_about(sigma: float) -> None:
    camera = rm.Camera(800.0, 800.0, 320.0, 240.0)
    down = (0.0, 1.0, 0.0)
    degrees = f"{np.degrees(sigma):.0f}°; degrees for radians"
    with pytest.warns(rm.InputWarning, match=f"prior: vertical: σ of {sigma:g} radians given, {degrees}") as told:
        rm.PosePrior(vertical=(down, down, sigma))
    assert told[0].filename == __file__
    with pytest.warns(rm.InputWarning, match=degrees):
        rm.PosePrior(rotation=(np.eye(3), sigma))
    if sigma < 1.0:
        with pytest.warns(rm.InputWarning, match=f"vertical_noise: σ of {sigma:g} radians given") as told:
            rm.UP2P(camera, vertical_camera=down, vertical_world=down, vertical_noise=sigma)
        assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rm.PosePrior(vertical=(down, down, 0.3), rotation=(np.eye(3), [3.0, 0.01, 3.0]))


def test_nothing_is_asked_of_degrees_on_the_command_line(folder: Path, tmp_path: Path) -> None:
    known = write(tmp_path / "known.csv", f"frame,{DOWN}", [[k, 0, 1, 0, 0, 1, 0, 40] for k in range(FRAMES)])
    result = run("track", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--known", known)
    assert "radians" not in result.stderr


def test_errors_ask_what_was_probably_meant() -> None:
    camera, points = rm.Camera(800.0, 800.0, 320.0, 240.0), np.random.default_rng(1).uniform(-1.0, 1.0, (9, 3))
    pixels = camera.project(points + np.array([0.0, 0.0, 5.0]))
    with pytest.raises(rm.InputError, match="transposed"):
        rm.match(points, pixels.T, rm.P3P(camera))
    with pytest.raises(rm.InputError, match="expected a number or 'auto'"):
        rm.match(points, pixels, rm.P3P(camera), noise="automatic")  # type: ignore[arg-type]
    assert "1 detection given" in rm.Matcher(points, rm.P3P(camera)).match(pixels[:1]).advice
    with pytest.raises(rm.InputError, match=r"indices \(3, 2\) look transposed"):
        rm.AffinityTensor(np.array([[0, 1], [5, 6], [10, 11]]), np.ones(2), (4, 4))


def test_an_empty_cell_is_named_in_the_first_row_of_its_image(tmp_path: Path) -> None:
    path = tmp_path / "image.csv"
    path.write_text(f"x,y,{DOWN}\n" + "".join(f"{k},{k},0,0,1,0,0,1,\n" for k in range(5)))
    with pytest.raises(rm.InputError, match=r"row 2: v_sigma is empty"):
        rm.io.read_points(path, 2, of_image=True)
