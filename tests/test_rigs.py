"""Several cameras on one body: simulated rigs, the four cameras of the cavity target, and what a rig refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import instances
import rootmatch as rm
from rig_scenes import LENS, four_about
from rootmatch.cli import app
from rootmatch.errors import InputError
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.io import Calibration, PointSet, read_camera, write_camera, write_points, write_table
from rootmatch.model.proposals import fit_assignments


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
    one_each = np.full(len(points), -1)
    for camera in range(4):
        seen = np.flatnonzero((truth[camera] >= 0) & (one_each < 0))
        one_each[seen[0]] = truth[camera, seen[0]]
    assert found.poses_of(one_each) == [None], "no camera has the three points that a pose begins with"
    again = rm.Matcher(points, rm.P3P(rig), noise=0.5).match((rows[:, :2], rows[:, 2]))
    np.testing.assert_array_equal(again.sightings.assignment, truth)


def test_detections_may_be_a_list_of_arrays_by_camera() -> None:
    """They count on from one camera to the next; OpenCV's shape (m, 1, 2), and cameras without any, are taken too."""
    points, rows, rig, *_ = four_about(seed=0)
    rows = rows[np.argsort(rows[:, 2], kind="stable")]
    by_camera: list[Any] = [rows[rows[:, 2] == k, :2] for k in range(4)]
    expected = rm.match(points, rows, rm.P3P(rig), noise=0.5)
    np.testing.assert_array_equal(rig.joined(by_camera), rows)
    by_camera[1] = by_camera[1][:, None]
    found = rm.match(points, by_camera, rm.P3P(rig), noise=0.5)
    np.testing.assert_array_equal(found.sightings.assignment, expected.sightings.assignment)
    tracked = rm.Tracker(points, rm.P3P(rig), noise=0.5).update(tuple(by_camera))
    np.testing.assert_array_equal(tracked.sightings.assignment, expected.sightings.assignment)
    by_camera[2] = []
    np.testing.assert_array_equal(rig.joined(by_camera), rows[rows[:, 2] != 2])
    two = rm.Rig(rig.views[:2])
    assert two.joined([[], []]).shape == (0, 3)
    np.testing.assert_array_equal(two.joined([rows[:3, :2], []])[:, 2], 0.0)
    np.testing.assert_array_equal(two.joined([[1.0, 2.0, 0.0], [3.0, 4.0, 1.0]]), [[1, 2, 0], [3, 4, 1]])
    np.testing.assert_array_equal(two.joined([[[1.0, 2.0]], [[3.0, 4.0], [5.0, 6.0]]])[:, 2], [0, 1, 1])


def test_images_of_the_cameras_lie_side_by_side() -> None:
    """In the order of the cameras, each from its left and upper edge on; one that detects nothing takes no room."""
    rng, index = np.random.default_rng(4), np.array([3, 1, 1, 3, 1, 3, 1])
    pixels = np.column_stack([rng.uniform(0.0, 500.0, (7, 2)), index])
    rig = rm.Rig([(LENS, np.eye(3), np.full(3, k)) for k in range(5)])
    offsets, edge = rig.offsets(pixels), 0.0
    assert offsets.shape == (5, 2)
    for k in range(5):
        own = pixels[index == k, :2]
        expected = (edge - own[:, 0].min(), -own[:, 1].min()) if len(own) else (0.0, 0.0)
        np.testing.assert_allclose(offsets[k], expected, atol=1e-12)
        edge += float(np.ptp(own[:, 0])) if len(own) else 0.0


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ([np.ones((3, 2)), np.ones((2, 2)), np.ones((1, 2))], "3 arrays given, and the rig has 2 cameras; give one"),
        (
            [np.ones((3, 2)), np.ones((2, 3))],
            r"shape \(2, 3\) given for camera 1, \(m, 2\) expected; for a rig, give \(pix",
        ),
        ([[[1.0, 2.0], [3.0]], [[1.0, 2.0]]], "target of camera 0: it is not an array of numbers; give shape"),
        ([[[1.0, 2.0]], [[1.0, 2.0], [3.0]]], "target of camera 1: it is not an array of numbers; give shape"),
        (
            np.ones((2, 5, 2)),
            r"shape \(2, 5, 2\) given; for a rig, give \(pixels, camera index of each\) or a list",
        ),
        ([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], r"shape \(3, 2\) given; for a rig, give"),
        (([[1.0, 2.0]], ["left"]), "an index of the camera for each pixel; for a rig, give"),
    ],
)
def test_what_is_no_list_by_camera_is_refused_with_the_right_forms(target: Any, words: str) -> None:
    _, _, rig, *_ = four_about(seed=0)
    with pytest.raises(InputError, match=words):
        rm.Rig(rig.views[:2]).joined(target)


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


def test_the_fit_of_sightings_is_the_least_of_their_squared_deviations() -> None:
    """Of all cameras, from a minimal set of one: against SciPy, from the truth."""
    points, rows, rig, truth, ((R, t),) = four_about()
    model = make_detection_model(MatchingTask.of(rm.P3P(rig), points, rows, noise=0.5))
    none = np.full_like(truth, -1)
    none[0, :2], none[1, 2:4] = 0, 1  # two in each of two cameras
    both = np.array([none.ravel(), truth.ravel()])
    proposals, found, at = fit_assignments(model, both)
    np.testing.assert_array_equal(proposals.assignments, both[1:])
    k, i = np.nonzero(truth >= 0)

    def deviations(change: NDArray) -> NDArray:
        X = points[i] @ (Rotation.from_rotvec(change[:3]).as_matrix() @ R).T + t + change[3:]
        in_camera = [rig.rotations[c] @ x + rig.translations[c] for c, x in zip(k, X, strict=True)]
        return (LENS.project(np.array(in_camera)) - rows[truth[k, i], :2]).ravel() / 0.5

    minimum = least_squares(deviations, np.zeros(6))
    error = np.concatenate([
        Rotation.from_matrix(Rotation.from_rotvec(minimum.x[:3]).as_matrix() @ R @ proposals.rotation[0].T).as_rotvec(),
        t + minimum.x[3:] - (proposals.position[0] - proposals.rotation[0] @ model.centre),
    ])  # fmt: skip
    covariance = np.linalg.inv(minimum.jac.T @ minimum.jac)
    assert np.abs(error / np.sqrt(np.diag(covariance))).max() < 0.05
    assert found.squared[0] == pytest.approx(2.0 * minimum.cost, rel=1e-3)
    step = 1e-6
    for parameter in range(6):
        change = step * np.eye(6)[parameter]
        turned = Rotation.from_rotvec(change[:3]).as_matrix() @ at.rotation
        moved = model.linearise_about(turned, at.position + change[3:]).pixels
        np.testing.assert_allclose((moved - at.pixels) / step, at.jacobian[..., parameter], rtol=1e-3, atol=0.1)


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
        ([(LENS, -np.eye(3), np.zeros(3))], "not a rotation"),
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
        with pytest.raises(InputError, match="only P3P and UP2P"):
            other(rig)
