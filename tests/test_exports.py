"""Matches and poses as other programs read them: COLMAP by pycolmap, ROS, OpenXR, TUM's trajectories."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.io.exports import openxr_record, ros_record, write_trajectory
from rootmatch.report.colmap import write_colmap

K = [[1000.0, 0.0, 640.0], [0.0, 1010.0, 480.0], [0.0, 0.0, 1.0]]
CAMERAS = {
    "PINHOLE": rm.Camera.from_matrix(K),
    "OPENCV": rm.Camera.from_opencv(K, [-0.1, 0.02, 1e-3, -2e-3]),
    "FULL_OPENCV": rm.Camera.from_opencv(K, [-0.1, 0.02, 1e-3, -2e-3, 0.01]),
    "OPENCV_FISHEYE": rm.Camera.from_opencv_fisheye(K, [0.05, -0.02, 0.003, -0.0005]),
}
POINTS = np.random.default_rng(5).uniform((-1, -1, 3), (1, 1, 5), (9, 3))


def matched(camera: rm.Camera, seed: int = 0) -> rm.Match:
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix()
    seen = camera.project(POINTS[:8] @ R.T + (0.1, -0.2, 0.3)) + rng.normal(0, 0.2, (8, 2))
    target = rng.permutation(np.vstack([seen, rng.uniform((100, 100), (1100, 800), (2, 2))]))
    match = rm.match(POINTS, target, rm.P3P(camera), noise=0.2)
    assert match
    return match


@pytest.mark.parametrize("model", CAMERAS)
def test_pycolmap_reads_the_model(tmp_path: Path, model: str) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    images = {"first.jpg": matched(CAMERAS[model], 0), "second.jpg": matched(CAMERAS[model], 1)}
    ids = np.arange(100, 109)
    write_colmap(tmp_path / "model", images, ids=ids, size=(1280, 960))
    read = pycolmap.Reconstruction(tmp_path / "model")
    assert read.num_images() == 2
    (camera,) = read.cameras.values()
    assert (camera.model.name, camera.width, camera.height) == (model, 1280, 960)
    for number, match in enumerate(images.values(), start=1):
        image, pose = read.image(number), match.pose
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose.matrix[:3], atol=1e-12)
        owners = {at: point.point3D_id for at, point in enumerate(image.points2D) if point.has_point3D()}
        assert owners == {int(j): int(ids[i]) for i, j in match.pairs}
        seen = np.array([image.project_point(read.point3D(int(ids[i])).xyz) for i, _ in match.pairs])
        np.testing.assert_allclose(seen, pose.predicted, atol=1e-6)
    tracks = {int(one): read.point3D(int(one)).track.length() for one in ids}
    assert tracks == {int(ids[i]): sum(match.assignment[i] >= 0 for match in images.values()) for i in range(9)}


def test_the_camera_is_read_back_by_its_own_reader_and_by_hand(tmp_path: Path) -> None:
    """Without pycolmap: cameras by `read_cameras`, the rest by COLMAP's documented format."""
    match = matched(CAMERAS["OPENCV"])
    write_colmap(tmp_path, {"a.jpg": match})
    assert rm.read_cameras(tmp_path / "cameras.txt") == {"1": replace(CAMERAS["OPENCV"], size=(1280.0, 960.0))}
    assert (tmp_path / "cameras.txt").read_text().split()[2:4] == ["1280", "960"]  # twice the principal point
    header, detections = (tmp_path / "images.txt").read_text().splitlines()
    cells = header.split()
    rotation = Rotation.from_quat([float(cell) for cell in cells[1:5]], scalar_first=True)
    np.testing.assert_allclose(rotation.as_matrix(), match.pose.R, atol=1e-12)
    np.testing.assert_array_equal([float(cell) for cell in cells[5:8]], match.pose.t)
    assert cells[8:] == ["1", "a.jpg"]
    table = np.array(detections.split(), float).reshape(-1, 3)
    np.testing.assert_array_equal(table[:, :2], match.target)
    assert {(int(i) - 1, j) for j, i in enumerate(table[:, 2]) if i >= 0} == set(map(tuple, match.pairs.tolist()))
    points = [line.split() for line in (tmp_path / "points3D.txt").read_text().splitlines()]
    np.testing.assert_array_equal([[float(cell) for cell in row[1:4]] for row in points], POINTS)


def test_half_a_pixel_is_added_to_camera_and_detections(tmp_path: Path) -> None:
    match = matched(CAMERAS["PINHOLE"])
    write_colmap(tmp_path, {"a.jpg": match}, opencv_pixels=True)
    assert rm.read_cameras(tmp_path / "cameras.txt")["1"] == rm.Camera(1000, 1010, 640.5, 480.5, size=(1280.0, 960.0))
    first = (tmp_path / "images.txt").read_text().splitlines()[1].split()[:2]
    np.testing.assert_array_equal([float(cell) for cell in first], match.target[0] + 0.5)


def test_what_colmap_cannot_hold(tmp_path: Path) -> None:
    match = matched(CAMERAS["PINHOLE"])
    thin = rm.Camera.from_opencv(K, [-0.1, 0.02, 0, 0, 0, 0, 0, 0, 1e-4, 0, 0, 0])
    flat = rm.match(POINTS[:, :2], POINTS[::-1, :2], rm.Rigid(2), noise=1e-3)
    for images, more, text in (
        ({}, {}, "none given"),
        ({"a b.jpg": match}, {}, "without spaces"),
        ({"a.jpg": match}, {"ids": [1, 2]}, "9 different whole numbers"),
        ({"a.jpg": match}, {"ids": np.arange(9) - 1}, "0 or more"),
        ({"a.jpg": matched(thin)}, {}, "thin prism"),
        ({"a.jpg": flat}, {}, "rigid has no image"),
    ):
        with pytest.raises(rm.InputError, match=text):
            write_colmap(tmp_path / "model", images, **more)
    assert not (tmp_path / "model").exists()


def test_ros_and_openxr_records() -> None:
    root = np.random.default_rng(3).normal(size=(6, 6))
    pose = rm.Pose(Rotation.from_euler("xyz", [0.3, -0.5, 0.7]).as_matrix(), np.array([0.1, 0.2, 2.0]), root @ root.T)
    record = ros_record(pose, frame_id="cam0_optical", child_frame_id="drone", time=12.25)
    assert record["header"] == {"stamp": {"sec": 12, "nanosec": 250_000_000}, "frame_id": "cam0_optical"}
    assert record["transform"]["translation"] == {"x": 0.1, "y": 0.2, "z": 2.0}
    turn = record["transform"]["rotation"]
    np.testing.assert_allclose(Rotation.from_quat([turn[axis] for axis in "xyzw"]).as_matrix(), pose.R, atol=1e-12)
    spread = np.reshape(record["covariance"], (6, 6))
    np.testing.assert_array_equal(spread[:3, :3], pose.covariance[3:, 3:])  # x, y, z first
    np.testing.assert_array_equal(spread[3:, :3], pose.covariance[:3, 3:])
    assert ros_record(rm.Pose(np.eye(3), np.zeros(3)))["covariance"] is None
    view = openxr_record(pose)
    assert view["position"] == {"x": 0.1, "y": -0.2, "z": -2.0}
    flipped = Rotation.from_quat([view["orientation"][axis] for axis in "xyzw"]).as_matrix()
    np.testing.assert_allclose(flipped, np.diag([1, -1, -1]) @ pose.R, atol=1e-12)


def test_trajectories_are_of_the_camera_in_the_frame_of_the_points(tmp_path: Path) -> None:
    pose = rm.Pose(Rotation.from_euler("y", 0.4).as_matrix(), np.array([0.1, 0.2, 2.0]))
    write_trajectory(tmp_path / "out.tum", [0.0, 0.5, 1.0], [pose, None, pose])
    table = np.loadtxt(tmp_path / "out.tum")
    np.testing.assert_array_equal(table[:, 0], [0.0, 1.0])
    np.testing.assert_allclose(table[0, 1:4], -pose.R.T @ pose.t, atol=1e-12)  # the camera's centre
    np.testing.assert_allclose(Rotation.from_quat(table[0, 4:]).as_matrix(), pose.R.T, atol=1e-12)
    with pytest.raises(rm.InputError, match="give seconds"):
        write_trajectory(tmp_path / "out.tum", [np.nan], [pose])
