"""Converters of the benchmark's sources: made-up snapshots in each source's format, whose truth is known."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rootmatch.errors import InputError

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from real_sources import SOURCES, cavity, convert, facade
from real_sources.__main__ import main

cv2 = pytest.importorskip("cv2")


def written(folder: Path, files: dict[str, Any]) -> Path:
    """Text files of a snapshot: rows of numbers, or text."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        rows = content if isinstance(content, str) else "\n".join(" ".join(map(str, row)) for row in content) + "\n"
        path.write_text(rows)
    return folder


def converted(name: str, snapshot: Path, tmp_path: Path) -> dict[str, Any]:
    with np.load(convert(name, snapshot, tmp_path / "data"), allow_pickle=False) as file:
        return {key: file[key] for key in file.files}


def pixels(points: Any, R: Any, t: Any, K: Any) -> Any:
    seen = (points @ np.transpose(R) + t) @ np.transpose(K)
    return seen[:, :2] / seen[:, 2:]


def test_lighthouses_become_cameras(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.1, 0.1, (8, 3))
    R, t = Rotation.from_rotvec([0.2, 0.1, 0.0]).as_matrix(), np.array([0.1, 0.0, 2.0])
    seen = points @ R.T + t
    angles = np.arctan(seen[:, :2] / seen[:, 2:])
    rows = [(k, house, axis, 1024, angles[k, axis], 1.0) for k in range(6) for house in range(2) for axis in range(2)]
    rows += [(7, 0, 1, 1024, 0.3, 1.0), (9, 0, 0, 1024, 0.3, 1.0)]  # one axis only; a sensor of a controller
    files = {"HMD_points.csv": points, "HMD_normals.csv": points, "ptinfo.csv": rows, "olddata/ptinfo.csv": rows}
    data = converted("vive_hmd_lighthouse", written(tmp_path / "attic/dave", files).parent, tmp_path)
    assert data["points2d"].shape == (4, 8, 2)
    assert np.isfinite(data["points2d"]).all(axis=2).sum(axis=1).tolist() == [6] * 4
    assert data["rms_px"].max() < 1e-3
    assert np.allclose(data["t"], t, atol=1e-4)
    assert np.allclose(data["normals3d"], points)


def test_frames_of_a_film(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    points, K = rng.uniform(-1, 1, (5, 3)), np.array([[900.0, 0, 1024], [0, 900, 540], [0, 0, 1]])
    poses = [(Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix(), np.array([0, 0, 6.0])) for _ in range(31)]
    markers = [(f + 1, k, *pixels(points, *poses[f], K)[k]) for f in range(31) for k in range(5) if (f, k) != (2, 4)]
    rows = [
        (900, 1024, 540, 0, 0, 0, 0, 0), (31,), *((f + 1, *R.T.ravel(), *t) for f, (R, t) in enumerate(poses)),
        (5,), *((k, *point) for k, point in enumerate(points)), (len(markers),), (1,), *markers,
    ]  # fmt: skip
    snapshot = written(tmp_path / "ceres", {"data/libmv-ba-problems/problem_01.txt": rows})
    data = converted("tears_of_steel_01", snapshot, tmp_path)
    assert data["frame_id"].tolist() == list(range(1, 32, 2))
    assert data["rms_px"].max() < 1e-6
    assert np.isnan(data["points2d"][1, 4]).all()  # frame 3
    assert np.isfinite(data["points2d"]).sum() == 2 * (16 * 5 - 1)


def test_proposed_pairs_keep_their_points(tmp_path: Path) -> None:
    pairs = [(3, 4, 0, 0, 1), (1, 2, 0, 0, 1), (3, 4, 5, 5, 5)]
    poses = [(1, 0, 0, 7, 0, 1, 0, 8, 0, 0, 1, 9)] * 2
    files = {"tless.txt": pairs, "tless_poses.txt": poses, "tless_intrinsics.txt": np.eye(3)}
    data = converted("tless_candidates", written(tmp_path / "snapshot/examples/img", files), tmp_path)
    assert data["points3d"].tolist() == [[0, 0, 1], [5, 5, 5]]
    joined = [(*data["points2d"][j], *data["points3d"][i]) for i, j in data["candidates"]]
    assert joined == pairs
    assert data["t"].tolist() == [[7, 8, 9]] * 2
    assert data["R"].shape == (2, 3, 3)


def test_a_lens_is_calibrated_from_targets(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    points, dist = rng.uniform(-500, 500, (60, 3)), np.array([-0.1, 0.05, 0, 0, 0])
    width, height, sensor = 6000, 4000, 36.0
    pitch, focal = sensor / width, 30.0
    K = np.array([[focal / pitch, 0, 3010], [0, focal / pitch, 1990], [0, 0, 1]])
    measured = []
    for image in range(1, 13):
        turn, t = rng.normal(0, 0.5, 3), np.array([0, 0, 2500.0])
        found = cv2.projectPoints(points, turn, t, K, dist)[0][:, 0]
        metric = (found - 0.5 * np.array([width - 1, height - 1])) * pitch * (1, -1)
        measured += [(image, 100 + k, *metric[k], 1e-4) for k in range(60 if image != 3 else 5)]
    measured.append((1, 999, 0, 0, 1e-4))  # of no object point
    files = {
        "JAICOV/example/example.obc": [(100 + k, *point, 0.1) for k, point in enumerate(points)],
        "JAICOV/example/example.phc": measured,
        "JAICOV/example/example.ior": f"1 -999 -29.0 0.0 0.0 0 0 13.5\n0\n0 0\n0 0\n{sensor} 24.0 {width} {height}\n",
    }
    data = converted("aicon_targets", written(tmp_path / "snapshot", files), tmp_path)
    assert data["view_names"].tolist() == ["image1", "image5", "image7", "image9", "image11"]  # the third shows too few
    assert data["rms"].max() < 1e-2
    assert np.allclose(data["K"][0], K, atol=2.0)
    assert data["dist"][0] == pytest.approx(-0.1, abs=5e-3)


def test_dots_behind_glass_are_identified(tmp_path: Path) -> None:
    """Blobs are traced through glass and water by an orientation that the given one misses by some pixels."""
    rng = np.random.default_rng(3)
    lattice = [(x, y, z) for x in range(-30, 31, 10) for y, z in ((-20, 8), (0, -8), (20, 8))]
    dots = np.array(lattice, dtype=float)
    media, pixel = (1.0, 1.46, 1.33, 6.0), 0.012
    files: dict[str, Any] = {
        "cal/target_on_a_side.txt": [(k + 1, *dot) for k, dot in enumerate(dots)],
        "parameters/ptv.par": "\n".join(
            ["4", *["name"] * 8, "1", "0", "1", "1280", "1024", *["0.012"] * 2, "0", "1", "1.46", "1.33", "6"]
        ),
    }
    truths = []
    for view in range(4):
        turn = Rotation.from_rotvec([0.1, 0.15 * (-1) ** view, 0.02]).as_matrix()
        centre = turn @ (0, 0, 600.0)
        orientation = np.array([*centre, 0, 0, 0, *turn.ravel(), 0, 0, 70.0, 0, 0, 125.0])
        truth = cavity.through_glass(dots, orientation, media) / pixel * (1, -1) + (640, 512)
        clutter = rng.uniform(0, 1000, (100, 2))
        clutter = clutter[np.linalg.norm(clutter[:, None] - truth, axis=2).min(axis=1) > 15.0]
        shown = np.concatenate([truth[1:], clutter]) + rng.normal(0, 0.2, (len(truth) - 1 + len(clutter), 2))
        blobs = [(k, x, y, 30, 5, 6, 900, -1) for k, (x, y) in enumerate(shown)]
        blobs.append((len(blobs), 100, 100, 4, 2, 2, 90, -1))  # too small
        files[f"cal/cam{view + 1}.tif_targets"] = f"{len(blobs)}\n" + "".join(
            " ".join(map(str, blob)) + "\n" for blob in blobs
        )
        orientation[15] += 0.06  # five pixels
        files[f"cal/cam{view + 1}.tif.ori"] = " ".join(map(str, orientation))
        truths.append((truth, len(clutter)))
    data = converted("openptv_cavity_target", written(tmp_path / "snapshot", files), tmp_path)
    for view, (truth, others) in enumerate(truths):
        assert np.isnan(data["points2d"][view, 0]).all()
        assert np.abs(data["points2d"][view, 1:] - truth[1:]).max() < 1.0
        assert (data["clutter_view"] == view).sum() == others
    assert data["rms_px"].max() < 1.0


def picture_of_board(R: Any, t: Any, K: Any) -> Any:
    """A photograph of a board of 9 × 6 inner corners, white around."""
    board = np.full((8 * 40, 11 * 40), 255, np.uint8)
    for row in range(7):
        for column in range(10):
            if (row + column) % 2:
                board[20 + 40 * row : 60 + 40 * row, 20 + 40 * column : 60 + 40 * column] = 0
    corner = np.array([[1 / 40, 0, -59.5 / 40 - 4], [0, 1 / 40, -59.5 / 40 - 2.5], [0, 0, 1]])  # pixels to squares
    return board, K @ np.column_stack([R[:, 0], R[:, 1], t]) @ corner


def test_corners_of_a_board(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    K = np.array([[530.0, 0, 320], [0, 530, 240], [0, 0, 1]])
    (tmp_path / "samples").mkdir()
    for number in range(1, 5):
        for side in ("left", "right"):
            turn = rng.normal(0, 0.2, 3)
            R, t = Rotation.from_rotvec(turn).as_matrix(), np.array([0.1, 0.2, 12.0 + number])
            board, homography = picture_of_board(R, t, K)
            picture = cv2.warpPerspective(board, homography, (640, 480), borderValue=255)
            cv2.imwrite(str(tmp_path / f"samples/{side}0{number}.jpg"), picture)
    cv2.imwrite(str(tmp_path / "samples/left05.jpg"), picture)  # without a right one
    data = converted("opencv_chessboard_stereo", tmp_path / "samples", tmp_path)
    assert data["view_names"].tolist() == [f"{side}0{k}" for k in range(1, 5) for side in ("left", "right")]
    assert data["frame_id"].tolist() == [1, 1, 2, 2, 3, 3, 4, 4]
    assert data["points2d"].shape == (8, 54, 2)
    assert data["rms_px"].max() < 0.3
    assert np.abs(data["points3d"].mean(axis=0)).max() < 1e-12


def test_a_facade_and_its_vertical(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    down, focal, k1, k2 = np.array([0.0, 0, -1]), 0.9, 0.01, 0.001
    points = np.column_stack([rng.uniform(-3, 3, 30), rng.uniform(8, 9, 30), rng.uniform(-2, 2, 30)])
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # world's z is up, y away
    K = np.array([[0.9 * 400, 0, 200], [0, 0.9 * 400, 150], [0, 0, 1]])
    shots, lines = {}, ["OPENSFM_TRACKS_VERSION_v2"]
    snapshot = tmp_path / "data/berlin"
    (snapshot / "images").mkdir(parents=True)
    for view, tilt in enumerate((0.1, 0.2, -0.1)):
        R = Rotation.from_rotvec([tilt, 0.05 * view, 0.02]).as_matrix() @ upright
        t = np.array([0.3 * view, 0.1, 1.0])
        seen = points @ R.T + t
        ray = seen[:, :2] / seen[:, 2:]
        square = (ray**2).sum(axis=1)
        image = focal * ray * (1 + square * (k1 + square * k2))[:, None]
        image[0] += 0.1  # a wrong track
        name = f"0{view + 1}.jpg"
        lines += [f"{name}\t{k}\t{k}\t{x}\t{y}\t0.001\t1\t2\t3\t-1\t-1" for k, (x, y) in enumerate(image)]
        shots[name] = {"rotation": Rotation.from_matrix(R).as_rotvec().tolist(), "translation": t.tolist()}
        photograph = np.full((900, 1200), 200, np.uint8)
        for x in np.linspace(-3, 3, 12):
            ends = pixels(np.array([(x, 8.5, -2.0), (x, 8.5, 2.0)]), R, t, K) * 3
            cv2.line(photograph, *[tuple(round(v) for v in end) for end in ends], 30, 9)
        cv2.imwrite(str(snapshot / "images" / name), photograph)
    known = {
        "cameras": {"one": {"width": 1200, "height": 900, "focal": focal, "k1": k1, "k2": k2}},
        "shots": shots,
        "points": {str(k): {"coordinates": point.tolist()} for k, point in enumerate(points)},
    }
    (snapshot / "reconstruction_example.json").write_text(json.dumps([known]))
    (snapshot / "tracks_example.csv").write_text("\n".join(lines) + "\n")
    data = converted("berlin_facade", tmp_path / "data", tmp_path)
    assert data["points2d"].shape == (3, 29, 2)  # without the wrong track
    assert data["rms_px"].max() < 1e-3
    assert np.degrees(np.arccos(data["gravity_world"] @ down)) < 0.3
    angles = np.degrees(np.arccos((data["gravity_cam"] * data["gravity_cam_measured"]).sum(axis=1)))
    assert angles.max() < 0.5
    with pytest.raises(InputError, match="vertical edges"):
        facade.vertical(_blank(tmp_path), K, (400, 300))


def _blank(folder: Path) -> Path:
    path = folder / "blank.png"
    cv2.imwrite(str(path), np.full((300, 400), 128, np.uint8))
    return path


def test_what_is_missing_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in SOURCES:
        with pytest.raises(InputError, match=r"snapshot: no folder of .* holds"):
            convert(name, tmp_path, tmp_path / "data")
    assert main(["tless_candidates", str(tmp_path / "nowhere"), str(tmp_path)]) == 2
    assert "is not a folder" in capsys.readouterr().err
    assert main(["tless", str(tmp_path), str(tmp_path)]) == 2
    assert "one of vive_hmd_lighthouse" in capsys.readouterr().err
    assert main([]) == 2
    assert "DATA_SET SNAPSHOT OUTPUT" in capsys.readouterr().err
    files = {"tless.txt": "1 2 3\n", "tless_poses.txt": "", "tless_intrinsics.txt": ""}
    with pytest.raises(InputError, match="not a table of 5 numbers"):
        convert("tless_candidates", written(tmp_path / "damaged", files), tmp_path / "data")
    assert not (tmp_path / "data/tless_candidates.npz").exists()
    files = {
        "JAICOV/example.obc": "1 0 0 0\n",
        "JAICOV/example.phc": "1 1 0 0\n",
        "JAICOV/example.ior": "1 1 9 9 9 9 9\n",
    }
    with pytest.raises(InputError, match="does not hold what aicon_targets is made of"):  # OpenCV's error
        convert("aicon_targets", written(tmp_path / "empty", files), tmp_path / "data")
