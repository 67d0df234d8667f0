"""Measured correspondences with ground truth, identities shuffled; skipped where the data are absent."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.predicted_poses import fit_match_poses
from rootmatch.explain.task import MatchingTask

Load = Callable[[str], dict[str, NDArray]]


def shuffled_view(
    data: dict[str, NDArray], view: int, points: NDArray | None, seed: int
) -> tuple[NDArray, NDArray, rm.P3P, NDArray]:
    """Model points, shuffled detections, problem and truth (−1: unseen) of one view, or of some of its points."""
    chosen = np.arange(len(data["points3d"])) if points is None else points
    image = data["points2d"][view][chosen]
    seen = np.flatnonzero(np.isfinite(image).all(axis=1))
    order = np.random.default_rng(seed).permutation(len(seen))
    truth = np.full(len(chosen), -1, dtype=np.int64)
    truth[seen[order]] = np.arange(len(seen))
    problem = rm.P3P(rm.Camera.from_matrix(data["K"][view]))
    return data["points3d"][chosen], image[seen[order]], problem, truth


@pytest.mark.parametrize("seed", range(4))
def test_headset_view_0(load_shared: Load, seed: int) -> None:
    """Another side of the headset explains nearly as much, and in half of the orders it is met first."""
    source, target, problem, truth = shuffled_view(load_shared("vive_hmd_lighthouse"), 0, None, seed=seed)
    assert (len(source), len(target)) == (32, 12)
    match = rm.match(source, target, problem, noise=0.1)
    np.testing.assert_array_equal(match.assignment, truth)


@pytest.mark.parametrize("view", range(4))
def test_headset_with_normals(load_shared: Load, view: int) -> None:
    data = load_shared("vive_hmd_lighthouse")
    source, target, problem, truth = shuffled_view(data, view, None, seed=view)
    match = rm.match(source, target, problem, noise=0.1, normals=data["normals3d"])
    np.testing.assert_array_equal(match.assignment, truth)
    assert match.status is rm.Status.MATCHED


@pytest.mark.parametrize("view", range(4))
def test_film_tracks(load_shared: Load, view: int) -> None:
    source, target, problem, truth = shuffled_view(load_shared("tears_of_steel_01"), view, None, seed=view)
    match = rm.match(source, target, problem, noise=1.3)
    np.testing.assert_array_equal(match.assignment, truth)


@pytest.mark.parametrize("view", range(4))
def test_random_dots_of_the_cavity_target(load_shared: Load, view: int) -> None:
    data = load_shared("openptv_cavity_target")
    seen = np.flatnonzero(np.isfinite(data["points2d"][view]).all(axis=1))
    points = np.random.default_rng(view).choice(seen, 20, replace=False)
    source, target, problem, truth = shuffled_view(data, view, points, seed=view)
    match = rm.match(source, target, problem, noise=0.75)
    np.testing.assert_array_equal(match.assignment, truth)


def test_headset_without_normals_is_right_or_called_ambiguous(load_shared: Load) -> None:
    """View 1 has an inside-out twin."""
    source, target, problem, truth = shuffled_view(load_shared("vive_hmd_lighthouse"), 1, None, seed=1)
    match = rm.match(source, target, problem, noise=0.13)
    shown = [match.assignment, *(other for other, _ in match.alternatives[:5])]
    assert any(np.array_equal(answer, truth) for answer in shown)
    assert match.status is rm.Status.AMBIGUOUS or np.array_equal(match.assignment, truth)


@pytest.mark.parametrize("view", range(4))
def test_dots_among_twice_as_many_real_false_detections(load_shared: Load, view: int) -> None:
    data = load_shared("openptv_cavity_target")
    seen = np.flatnonzero(np.isfinite(data["points2d"][view]).all(axis=1))
    rng = np.random.default_rng(view)
    source, target, problem, truth = shuffled_view(data, view, rng.choice(seen, 20, replace=False), seed=view)
    clutter = rng.permutation(data["clutter2d"][data["clutter_view"] == view])[:40]
    match = rm.match(source, np.concatenate([clutter, target]), problem, noise=0.75)
    assert np.mean(match.assignment == truth + 40) >= 0.95


@pytest.mark.parametrize(("vertical", "minimum"), [("gravity_cam", 0.97), ("gravity_cam_measured", 0.93)])
def test_upright_camera_before_a_facade(load_shared: Load, vertical: str, minimum: float) -> None:
    data = load_shared("berlin_facade")
    right = []
    for seed in range(6):
        rng, view = np.random.default_rng(seed), seed % 3
        seen = np.flatnonzero(np.isfinite(data["points2d"][view]).all(axis=1))
        chosen = rng.choice(seen, 30, replace=False)
        problem = rm.UP2P(
            rm.Camera.from_matrix(data["K"][view]),
            vertical_camera=tuple(data[vertical][view]),
            vertical_world=tuple(data["gravity_world"]),
            vertical_noise=0.0 if vertical == "gravity_cam" else 0.005,
        )
        order = rng.permutation(30)
        match = rm.match(
            data["points3d"][chosen[:15]], data["points2d"][view][chosen][order], problem, noise=data["rms_px"][view]
        )
        right.append(np.mean(match.assignment == np.argsort(order)[:15]))
    assert np.mean(right) >= minimum


def test_two_boards_in_one_image(load_shared: Load) -> None:
    data = load_shared("opencv_chessboard_stereo")
    views = np.flatnonzero(data["camera_id"] == data["camera_id"][0])
    right = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        first, second = rng.choice(views, 2, replace=False)
        chosen = rng.choice(54, 16, replace=False)
        image = np.concatenate([data["points2d"][first][chosen[:8]], data["points2d"][second][chosen[8:]]])
        order = rng.permutation(16)
        problem = rm.P3P(rm.Camera.from_matrix(data["K"][first]))
        match = rm.match(data["points3d"][chosen], image[order], problem, noise=0.3, motions=2)
        right.append(np.mean(match.assignment == np.argsort(order)))
        assert len(set(match.motion_labels[:8]) | set(match.motion_labels[8:])) == 2
    assert np.mean(right) >= 0.95


@pytest.mark.parametrize("view", [0, 8, 52])
def test_raw_pixels_give_the_assignment_of_undistorted_ones(load_shared: Load, view: int) -> None:
    data = load_shared("aicon_targets")
    seen = np.flatnonzero(np.isfinite(data["points2d"][view]).all(axis=1))
    points = np.random.default_rng(view).choice(seen, 24, replace=len(seen) < 24)
    source, raw, pinhole, truth = shuffled_view(data, view, np.unique(points), seed=view)
    lens = rm.Camera.from_opencv(data["K"][view], data["dist"])
    straight = pinhole.camera.project(lens.bearings(raw))
    assert np.abs(straight - raw).max() > 20.0
    matches = [
        rm.match(source, image, problem, noise=0.5) for image, problem in ((raw, rm.P3P(lens)), (straight, pinhole))
    ]
    np.testing.assert_array_equal(matches[0].assignment, truth)
    np.testing.assert_array_equal(matches[1].assignment, truth)


def test_poses_of_raw_pixels_are_those_of_the_calibration(load_shared: Load) -> None:
    data = load_shared("aicon_targets")
    deviations = []
    for view, (R, t) in enumerate(zip(data["R"], data["t"], strict=True)):
        source, raw, _, truth = shuffled_view(data, view, None, seed=view)
        problem = rm.P3P(rm.Camera.from_opencv(data["K"][view], data["dist"]))
        task = MatchingTask.of(problem, source, raw, noise=float(data["rms"][view]))
        ((pose,),) = fit_match_poses(task, [truth], np.where(truth >= 0, 0, -1))
        assert pose is not None
        assert pose.covariance is not None
        error = np.concatenate([Rotation.from_matrix(R @ pose.R.T).as_rotvec(), t - pose.t])
        deviations.append(np.abs(error) / np.sqrt(np.diag(pose.covariance)))
    assert len(deviations) == 57
    assert np.max(deviations) < 3.0
