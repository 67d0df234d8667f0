"""The examples of XR, surgery and photogrammetry at a small size, and what they print held against the truth."""

from __future__ import annotations

import json
import re
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(monkeypatch: pytest.MonkeyPatch, script: str, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
    monkeypatch.syspath_prepend(str((EXAMPLES / script).parent))
    runpy.run_path(str(EXAMPLES / script), run_name="__main__")


@pytest.mark.parametrize("more", [(), ("--no-imu",)], ids=["imu", "alone"])
def test_a_controller_over_a_socket(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], more: tuple[str, ...]
) -> None:
    run(monkeypatch, "xr/round_trip.py", "--frames", 12, *more)
    told = capsys.readouterr().out
    right, wrong = map(int, re.match(r"(\d+) of 12 frames right, (\d+) wrong", told).groups())  # type: ignore[union-attr]
    assert right >= 10, told
    assert wrong == 0, told
    assert "round trip: first" in told


def test_the_imu_is_asked_while_the_controller_is_lost() -> None:
    asked: list[Any] = []
    lost = SimpleNamespace(state=rm.TrackingState.LOST, update=lambda target, time, prior: asked.append(prior))
    answered = runpy.run_path(str(EXAMPLES / "xr/serve.py"))["answered"]
    turn = Rotation.from_rotvec([0.1, 0.2, 0.3])
    for imu in (turn.as_quat().tolist(), None):
        line = json.dumps({"time": 0.0, "pixels": [], "camera": [], "imu": imu})
        assert json.loads(answered(lost, line))["t"] is None
    np.testing.assert_allclose(asked[0].rotation[0], turn.as_matrix())
    assert asked[1] is None


@pytest.mark.parametrize("seed", [1, 2])
def test_tips_of_tools_in_a_plan(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    run(monkeypatch, "surgery/navigate.py", "--seed", seed)
    told = capsys.readouterr().out
    assert "FRE 0." in told
    errors = re.findall(r"expected error ([\d.]+) mm, true ([\d.]+) mm", told)
    assert len(errors) == 2
    for expected, true in errors:
        assert 0.3 < float(expected) < 3.0
        assert float(true) < 3.0 * float(expected)


def test_images_are_placed_in_a_colmap_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(6)
    points, model = rng.uniform((-3, -2, 8), (3, 2, 12), (20, 3)), tmp_path / "model"
    model.mkdir()
    (model / "cameras.txt").write_text("1 OPENCV 1200 900 1000 1000 600 450 -0.1 0.02 0 0\n")
    rows = [f"{100 + i} {x} {y} {z} 255 255 255 0.2" for i, (x, y, z) in enumerate(points)]
    (model / "points3D.txt").write_text("\n".join(rows) + "\n")
    camera = rm.read_cameras(model / "cameras.txt")["1"]
    truth = {}
    for k in range(3):
        R = Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix()
        truth[f"image{k}.jpg"] = rm.Pose(R, rng.normal(0, 0.5, 3))
        seen = camera.project(truth[f"image{k}.jpg"].transform(points[:15])) + rng.normal(0, 0.3, (15, 2))
        if k == 2:
            seen = rng.uniform((0, 0), (1200, 900), (15, 2))  # of something else
        table = np.column_stack([np.vstack([seen, rng.uniform((0, 0), (1200, 900), (3, 2))]), np.full(18, 0.3)])
        np.savetxt(tmp_path / f"image{k}.csv", table, delimiter=",", header="x,y,sigma", comments="")
    images = [tmp_path / f"image{k}.csv" for k in range(3)]
    run(monkeypatch, "photogrammetry/locate.py", model, *images, "--output", tmp_path / "located")
    assert "2 of 3 images in" in capsys.readouterr().out
    pycolmap = pytest.importorskip("pycolmap")
    read = pycolmap.Reconstruction(tmp_path / "located")
    assert {image.name for image in read.images.values()} == {"image0.jpg", "image1.jpg"}
    for image in read.images.values():
        found = rm.Pose(image.cam_from_world().rotation.matrix(), image.cam_from_world().translation)
        off = found @ truth[image.name].inverse()
        assert np.linalg.norm(off.rvec) < 0.01
        assert image.num_points3D >= 14
    # COLMAP's own text has comments, and tracks of different lengths; here also a second camera
    written = tmp_path / "written"
    written.mkdir()
    read.write_text(written)
    with (written / "cameras.txt").open("a") as file:
        file.write("7 PINHOLE 1200 900 1000 1000 600 450\n")
    again = "photogrammetry/locate.py", written, *images, "--output", tmp_path / "again"
    with pytest.raises(SystemExit):
        run(monkeypatch, *again)
    assert "--camera: the cameras of the model are 1, 7; say which one" in capsys.readouterr().err
    run(monkeypatch, *again, "--camera", 1)
    assert "2 of 3 images in" in capsys.readouterr().out
    (camera,) = pycolmap.Reconstruction(tmp_path / "again").cameras.values()
    assert (camera.width, camera.height) == (1200, 900)
