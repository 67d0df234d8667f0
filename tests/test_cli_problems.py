"""``rootmatch match`` with the problems that `test_cli` leaves out: from files to matches and poses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import rootmatch as rm
from commands import rows_of, run
from pose_scenes import CAMERA, PoseScene, planar, point_sets, up2pf


def write(path: Path, points: np.ndarray) -> Path:
    rows = [",".join("xyz"[: points.shape[1]]), *(",".join(map(repr, row)) for row in points.tolist())]
    path.write_text("\n".join(rows) + "\n")
    return path


def plane(scene: PoseScene) -> str:
    return ",".join(map(repr, np.asarray(scene.problem.axis).tolist()))  # type: ignore[attr-defined]


def vertical(scene: PoseScene) -> str:
    return ",".join(map(repr, np.asarray(scene.problem.vertical_camera).tolist()))  # type: ignore[attr-defined]


def options_of(scene: PoseScene, name: str) -> list[object]:
    camera = ",".join(map(str, CAMERA.numbers))
    if name == "planar":
        return ["--camera", camera, "--axis", plane(scene), "--axis2", plane(scene), "--noise", scene.noise]
    if name == "up2pf":
        down = ["--vertical-camera", vertical(scene), "--vertical-world", "0,1,0"]
        return ["--centre", "320,240", *down, "--noise", scene.noise]
    return ["--noise", "0.01,0.01"]


SCENES = {
    "planar": lambda: planar(4, 8),
    "up2pf": lambda: up2pf(1, 7),
    "rigid": lambda: point_sets(2, rm.Rigid(3)),
    "similarity": lambda: point_sets(2, rm.Similarity(3)),
    "rigid in a plane": lambda: point_sets(2, rm.Rigid(2)),
}


@pytest.mark.parametrize("name", list(SCENES))
def test_from_files_to_poses(name: str, tmp_path: Path) -> None:
    scene, problem = SCENES[name](), name.split()[0]
    files = write(tmp_path / "a.csv", scene.source), write(tmp_path / "b.csv", scene.target)
    poses, matches = tmp_path / "poses.json", tmp_path / "matches.csv"
    result = run(
        "match", *files, "--problem", problem, *options_of(scene, problem), "--poses", poses, "--output", matches,
        "--plot", tmp_path / "match.png",
    )  # fmt: skip
    assert result.exit_code == 0, result.output + result.stderr
    rows = rows_of(matches)
    found = {int(row["source"]): int(row["target"]) for row in rows}
    assert sum(scene.assignment[i] == j for i, j in found.items()) >= len(found) - 1 >= len(scene.source) - 2
    assert all(float(row["residual"]) >= 0.0 for row in rows)
    (record,) = json.loads(poses.read_text())
    np.testing.assert_allclose(record["R"], scene.R, atol=0.1)
    last = {"up2pf": "focal", "similarity": "scale"}.get(problem, "tz" if len(scene.t) == 3 else "ty")
    assert record["parameters"][-1] == last
    assert (tmp_path / "match.png").stat().st_size > 10_000


def test_fiducials_against_a_tracker_with_missing_and_stray_markers(tmp_path: Path) -> None:
    """The dimension is that of the file, and TUM's line is the pose."""
    rng = np.random.default_rng(0)
    plan = rng.uniform(-60.0, 60.0, (7, 3))
    reported = np.vstack([plan[[4, 2, 0, 5, 1]] + [100.0, 20.0, -300.0], [[120.0, 10.0, -280.0]]])
    reported[:5] += 0.1 * rng.normal(size=(5, 3))
    files = write(tmp_path / "plan.csv", plan), write(tmp_path / "tracker.csv", reported)
    poses = tmp_path / "poses.csv"
    result = run("match", *files, "--problem", "rigid", "--noise", "0,0.1", "--poses", poses, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["assignment"] == [2, 4, 1, -1, 0, 3, -1]
    (row,) = rows_of(poses)
    numbers = [float(row[name]) for name in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")]
    np.testing.assert_allclose(numbers, [100, 20, -300, 0, 0, 0, 1], atol=1.0)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--noise", "1,2,3"), "SOURCE,TARGET"),
        (("--noise", "0,x"), "SOURCE,TARGET"),
        (("--dimension", "4"), "2 or 3 expected"),
        (("--dimension", "2"), "a column z"),
    ],
)
def test_bad_options_are_one_line(tmp_path: Path, options: tuple[str, str], text: str) -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    files = write(tmp_path / "a.csv", points), write(tmp_path / "b.csv", points)
    result = run("match", *files, "--problem", "rigid", *options)
    assert result.exit_code == 2
    assert text in " ".join(result.stderr.split())


def test_poses_of_a_plane_are_no_quaternions(tmp_path: Path) -> None:
    scene = point_sets(2, rm.Rigid(2))
    files = write(tmp_path / "a.csv", scene.source), write(tmp_path / "b.csv", scene.target)
    poses = tmp_path / "poses"
    result = run(
        "match", *files, "--problem", "rigid", "--noise", "0.01,0.01", "--poses", poses, "--pose-format", "ros"
    )
    assert result.exit_code == 2
    assert "in a plane; give csv or json" in " ".join(result.stderr.split())
    assert not poses.exists()
    table = tmp_path / "poses.csv"
    assert run("match", *files, "--problem", "rigid", "--noise", "0.01,0.01", "--poses", table).exit_code == 0
    (row,) = rows_of(table)
    angle = np.arctan2(scene.R[1, 0], scene.R[0, 0])
    assert float(row["angle"]) == pytest.approx(angle, abs=0.05)
    assert float(row["cov_angle_angle"]) > 0.0
