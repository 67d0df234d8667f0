"""Detections outside of a lens's image circle: clutter that is left out, unless most of them lie there."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import rootmatch as rm
from rootmatch.cli.app import app

POINTS = np.random.default_rng(1).uniform(-1.0, 1.0, (9, 3))
HOT = 1270.0, 1015.0


def fisheye(focal: float) -> rm.Camera:
    """A camera of which no other test has warned."""
    camera = rm.Camera.from_opencv_fisheye(
        [[focal, 0.0, 640.0], [0.0, 330.0, 512.0], [0.0, 0.0, 1.0]], [0.03, -0.01, 0.002, -0.0004]
    )
    return rm.Camera(*camera.numbers, lens=camera.lens, size=(1280.0, 1024.0))


def image(camera: rm.Camera, t: tuple[float, float, float] = (0.0, 0.0, 2.0)) -> NDArray[np.float64]:
    """The points and a hot pixel at index 3."""
    rng = np.random.default_rng(2)
    return np.insert(camera.project(POINTS + np.array(t)) + rng.normal(0.0, 0.2, (9, 2)), 3, HOT, axis=0)


AFTER = np.arange(9) + (np.arange(9) >= 3)
"""The detection of each point."""


def test_a_hot_pixel_is_left_out_with_one_warning() -> None:
    camera = fisheye(330.1)
    seen, problem = image(camera), rm.P3P(camera)
    with pytest.warns(rm.InputWarning, match=r"1 of 10 detections, at index 3, \(1270, 1015\), lies outside .* 667 px"):
        found = rm.match(POINTS, seen, problem, noise=0.2)
    without = rm.match(POINTS, np.delete(seen, 3, axis=0), problem, noise=0.2)
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.assignment, AFTER)
    assert found.log_odds == without.log_odds
    assert found.pose is not None
    assert without.pose is not None
    np.testing.assert_array_equal(found.pose.t, without.pose.t)
    assert found.advice == without.advice
    assert len(found.target) == found.soft_assignment.shape[1] == 10
    assert found.alternative_poses is not None
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # once for each camera
        tracker = rm.Tracker(POINTS, problem, noise=0.2)
        for _ in range(3):
            np.testing.assert_array_equal(tracker.update(seen).assignment, AFTER)
        bodies = rm.match(POINTS, seen, problem, noise=0.2, bodies=[0] * 5 + [1] * 4).bodies
    assert bodies is not None
    np.testing.assert_array_equal(bodies[1].assignment, AFTER[5:])
    assert bodies[1].pose is not None


def test_one_of_a_rig_is_left_out() -> None:
    cameras = fisheye(330.2), fisheye(330.3)
    shift = np.array([-0.3, 0.0, 0.0])
    rig = rm.Rig([(cameras[0], np.eye(3), np.zeros(3)), (cameras[1], np.eye(3), shift)])
    pixels = np.concatenate(
        [cameras[0].project(POINTS + np.array([0.0, 0.0, 2.0])), image(cameras[1], (-0.3, 0.0, 2.0))]
    )
    with pytest.warns(rm.InputWarning, match="1 of 10 detections of its camera, at index 12"):
        found = rm.match(POINTS, (pixels, np.repeat([0, 1], [9, 10])), rm.P3P(rig), noise=0.2)
    assert found.sightings is not None
    np.testing.assert_array_equal(found.sightings.assignment, [np.arange(9), AFTER + 9])


def test_what_is_left_out_is_no_error_of_the_advice() -> None:
    rng, camera = np.random.default_rng(7), fisheye(330.9)
    with pytest.warns(rm.InputWarning, match="left out"):
        found = rm.match(POINTS, [*rng.uniform(300.0, 700.0, (5, 2)), HOT], rm.P3P(camera), noise=0.2, max_seconds=5.0)
    assert found.status is not rm.Status.MATCHED
    assert found.advice
    assert "evaluate more hyper-edges" in found.finding.longer_search


def test_a_lens_that_shows_less_than_half_is_wrong() -> None:
    camera = fisheye(330.4)
    seen = np.concatenate([image(camera)[:4], np.array(HOT) - np.arange(4)[:, None]])
    told = r"5 of 8 detections, the first at index 3, \(1270, 1015\), lie outside the lens's image circle"
    with pytest.raises(rm.InputError, match=told):
        rm.match(POINTS, seen, rm.P3P(camera), noise=0.2)
    assert "another lens" in rm.Matcher(POINTS, rm.P3P(camera), noise=0.2).match(seen).advice


def test_a_noisy_model_has_its_noise_beside_a_hot_pixel() -> None:
    camera = fisheye(330.5)
    with pytest.warns(rm.InputWarning, match="left out"):
        found = rm.match(POINTS, image(camera), rm.P3P(camera), noise=0.2, source_noise=0.001)
    np.testing.assert_array_equal(found.assignment, AFTER)


def test_a_hot_pixel_blinds_no_flight_on_the_command_line(tmp_path: Path) -> None:
    camera = fisheye(330.0)
    (tmp_path / "camera.json").write_text(
        '{"fx": 330.6, "fy": 330, "cx": 640, "cy": 512, "fisheye": [0.03, -0.01, 0.002, -0.0004], '
        '"width": 1280, "height": 1024}'
    )
    np.savetxt(tmp_path / "model.csv", POINTS, delimiter=",", header="x,y,z", comments="")
    rows = np.vstack([np.column_stack([np.full(10, k), image(camera)]) for k in range(3)])
    np.savetxt(tmp_path / "frames.csv", rows, delimiter=",", header="frame,x,y", comments="")
    paths = [str(tmp_path / name) for name in ("model.csv", "frames.csv")]
    options = ["--problem", "p3p", "--camera", str(tmp_path / "camera.json"), "--noise", "0.3"]
    result = CliRunner().invoke(app, ["track", *paths, *options])
    assert result.exit_code == 0
    assert "3 matched" in result.stderr
    assert result.stderr.count("rootmatch: warning: target: 1 of 10 detections") == 1
