"""Several cameras on one body: simulated rigs, the four cameras of the cavity target, and what a rig refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import instances
import rootmatch as rm
from rig_scenes import LENS, four_about
from rootmatch.cli import app
from rootmatch.errors import InputError
from rootmatch.io import Calibration, PointSet, read_camera, write_camera, write_points, write_table
from rootmatch.problems.pose_fit.rig_fit import Copies, rig_fit


@pytest.mark.parametrize("seed", [0, 1])
def test_twenty_points_of_which_each_camera_sees_five(seed: int) -> None:
    points, rows, rig, truth, ((R, t),) = four_about(seed=seed)
    found = rm.match(points, (rows[:, :2], rows[:, 2].astype(int)), rm.P3P(rig), noise=0.5)
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.sightings.assignment, truth)
    np.testing.assert_array_equal(found.assignment, truth.max(axis=0))
    pose = found.poses[0]
    assert pose is found.pose
    error = np.concatenate([_rotation_vector(R @ pose.R.T), t - pose.t])
    assert error @ np.linalg.solve(pose.covariance, error) < 30.0
    assert pose.dof == 2 * 20 - 6
    assert 0.5 < pose.rms_sigma < 1.6
    np.testing.assert_allclose(found.poses_of(found.assignment)[0].t, pose.t, atol=1e-9)
    again = rm.Matcher(points, rm.P3P(rig), noise=0.5).match((rows[:, :2], rows[:, 2]))
    np.testing.assert_array_equal(again.sightings.assignment, truth)


@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_the_vertical_of_a_rig_is_that_of_each_of_its_cameras(tilt: float) -> None:
    """It is part of the pose; one that is 34 degrees off is not believed."""
    points, rows, rig, truth, ((R, t),) = four_about(seed=1)
    down = np.array([0.3, -0.8, 0.5])
    measured = R @ down
    cosine, sine = np.cos(tilt), np.sin(tilt)
    measured = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ measured
    found = rm.match(points, rows, rm.UP2P(rig, tuple(measured), tuple(down), 1e-4), noise=0.5)
    if tilt:
        assert found.status is not rm.Status.MATCHED
        return
    assert found.status is rm.Status.MATCHED
    np.testing.assert_array_equal(found.sightings.assignment, truth)
    error = np.concatenate([_rotation_vector(R @ found.pose.R.T), t - found.pose.t])
    assert error @ np.linalg.solve(found.pose.covariance, error) < 30.0
    alone = rm.match(points, rows, rm.P3P(rig), noise=0.5).pose
    assert np.trace(found.pose.covariance[:3, :3]) < 0.8 * np.trace(alone.covariance[:3, :3])
    up = found.pose.R @ down / np.linalg.norm(down)
    assert np.arccos(min(float(up @ measured) / np.linalg.norm(measured), 1.0)) < 5e-4


def _rotation_vector(R: NDArray) -> NDArray:
    return 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])


def test_the_fit_is_that_of_differences() -> None:
    points, rows, rig, truth, _ = four_about()
    plane = rig.chart(rows, np.full(len(rows), 0.5))[1]
    copies = Copies(rig, points, rig.offsets(rows), rows[:, 2].astype(int))
    fit = rig_fit(copies, plane, np.full(len(rows), 0.5), truth.reshape(1, -1))
    assert fit.chi2[0] < 70.0

    def projected(rotation: NDArray, translation: NDArray) -> NDArray:
        return copies.project(copies.places @ rotation.T + translation)

    step = 1e-6
    for parameter in range(6):
        change = step * np.eye(6)[parameter]
        turned = np.eye(3) + np.cross(change[:3], np.eye(3)).T
        moved = projected(turned @ fit.rotation[0], fit.translation[0] + change[3:])
        still = projected(fit.rotation[0], fit.translation[0])
        np.testing.assert_allclose((moved - still) / step, fit.jacobian[0][..., parameter], rtol=1e-3, atol=0.1)
    images = [copies.of_camera(copies.places @ fit.rotation[0].T + fit.translation[0], k) for k in range(4)]
    for k, places in enumerate(images):
        own = truth[k] >= 0
        pixels = LENS.project(places[own])
        assert np.abs(pixels - rows[truth[k, own], :2]).max() < 4.0


def test_unrelated_points_are_not_trusted() -> None:
    _, rows, rig, _, _ = four_about(seed=3)
    other = np.random.default_rng(9).uniform(-1.0, 1.0, (20, 3))
    assert rm.match(other, rows, rm.P3P(rig), noise=0.5).status is not rm.Status.MATCHED


def test_the_four_cameras_of_the_cavity(load_shared: Callable[[str], dict[str, NDArray]]) -> None:
    data = load_shared("openptv_cavity_target")
    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(data["points3d"]))[:20]
    views, rows, truth = [], [], np.full((4, 20), -1)
    for k in range(4):
        views.append((rm.Camera.from_matrix(data["K"][k]), data["R"][k], data["t"][k]))
        image = data["points2d"][k][chosen]
        seen = np.flatnonzero(np.isfinite(image).all(axis=1))
        clutter = data["clutter2d"][data["clutter_view"] == k]
        truth[k, seen] = len(rows) + np.arange(len(seen))
        pixels = np.concatenate([image[seen], clutter[rng.permutation(len(clutter))[:5]]])
        rows += [(*pixel, k) for pixel in pixels.tolist()]
    R, t = instances.random_rotation(rng), rng.uniform(-50.0, 50.0, 3)
    moved = (data["points3d"][chosen] - t) @ R
    found = rm.match(moved, np.array(rows), rm.P3P(rm.Rig(views)), noise=0.75)
    assert found.status is rm.Status.MATCHED
    right = truth >= 0
    # a lattice point's neighbour lies near where a hidden one would be: what is seen is matched, and rightly
    assert (found.sightings.assignment == truth)[right].mean() > 0.97
    np.testing.assert_allclose(found.poses[0].R, R, atol=0.01)


def test_a_rig_on_the_command_line(tmp_path: Path) -> None:
    points, rows, rig, truth, _ = four_about(seed=1)
    write_camera(tmp_path / "rig.json", Calibration(rig))
    assert read_camera(tmp_path / "rig.json").camera == rig
    write_points(tmp_path / "model.csv", PointSet(points))
    write_table(tmp_path / "image.csv", ("x", "y", "camera"), [(x, y, int(k)) for x, y, k in rows.tolist()])
    arguments = ["match", str(tmp_path / "model.csv"), str(tmp_path / "image.csv"), "--problem", "p3p", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--camera", str(tmp_path / "rig.json"), "--noise", "0.5"])
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["sightings"] == truth.tolist()
    (tmp_path / "rig.json").write_text('{"rig": [{"fx": 1, "fy": 1, "cx": 0, "cy": 0, "R": [1, 2], "t": [0, 0, 0]}]}')
    result = CliRunner().invoke(app, [*arguments, "--camera", str(tmp_path / "rig.json")])
    assert result.exit_code == 2
    assert "R of camera 0" in result.stderr


@pytest.mark.parametrize(
    ("views", "words"),
    [
        ([], "no camera"),
        (5, "list of"),
        ([(LENS, np.eye(3))], "2 entries"),
        ([(np.eye(3), np.eye(3), np.zeros(3))], "Camera with pixels"),
        ([(rm.Bearings(), np.eye(3), np.zeros(3))], "Camera with pixels"),
        ([(LENS, -np.eye(3), np.zeros(3))], "no rotation"),
        ([(LENS, np.eye(2), np.zeros(3))], "shape"),
        ([(LENS, np.eye(3), [0.0, np.nan, 0.0])], "NaN"),
        ([(LENS, "turned", np.zeros(3))], "numbers"),
    ],
)
def test_what_is_no_rig(views: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        rm.Rig(views)  # type: ignore[arg-type]


def test_what_a_rig_does_not_take() -> None:
    points, rows, rig, _, _ = four_about()
    problem = rm.P3P(rig)
    for options in (
        {"motions": 2},
        {"preset": "paper"},
        {"solver": "ascent"},
        {"noise": "auto"},
        {"sampler": "random"},
    ):
        with pytest.raises(InputError, match=next(iter(options))):
            rm.match(points, rows, problem, **options)
    with pytest.raises(InputError, match="camera 7"):
        rm.match(points, (rows[:, :2], np.full(len(rows), 7)), problem)
    with pytest.raises(InputError, match=r"give \(n', 2\)"):
        rm.match(points, (rows[:, :2], rows[:3, 2]), problem)
    for one in (problem, rm.UP2P(rig, (0, 1, 0), (0, 1, 0))):
        index = [list(range(one.order))]
        with pytest.raises(InputError, match="one camera"):
            rm.residuals(points, rows, one, index, index)
    for other in (rm.ThreePlusOne, rm.PlanarMotion):
        with pytest.raises(InputError, match="P3P and UP2P alone"):
            other(rig)
