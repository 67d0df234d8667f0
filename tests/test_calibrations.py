"""Calibration files: one of each kind, by its own tool or by its documented format, and what is no calibration."""

from __future__ import annotations

import json
import math
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import rootmatch as rm
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.cli import app
from rootmatch.errors import InputError
from rootmatch.io import Calibration, PointSet, parse_camera, read_camera, write_camera, write_points

K = np.array([[1000.0, 0.0, 640.0], [0.0, 1010.0, 480.0], [0.0, 0.0, 1.0]])
BROWN, FISHEYE = [-0.28, 0.07, 1e-3, -2e-3, 0.01], [0.05, -0.02, 0.003, -0.0005]
WITH_BROWN, WITH_FISHEYE = rm.Camera.from_opencv(K, BROWN), rm.Camera.from_opencv_fisheye(K, FISHEYE)
SIZE = (1280.0, 960.0)


def by_opencv(path: Path, names: tuple[str, str] = ("camera_matrix", "distortion_coefficients")) -> Path:
    cv2 = pytest.importorskip("cv2")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sun Nov 22 01:00:00 2026")
    storage.write("image_width", 1280)
    storage.write("image_height", 960)
    storage.write(names[0], K)
    storage.write(names[1], np.array([BROWN]))
    storage.write("avg_reprojection_error", 0.3)
    storage.release()
    return path


@pytest.mark.parametrize("suffix", ["yml", "yaml", "xml", "json"])
@pytest.mark.parametrize("names", [("camera_matrix", "distortion_coefficients"), ("K", "dist")])
def test_opencv(tmp_path: Path, suffix: str, names: tuple[str, str]) -> None:
    found = rm.read_cameras(by_opencv(tmp_path / f"calibration.{suffix}", names))
    assert found == {"camera": replace(WITH_BROWN, size=SIZE)}


def test_opencv_4_and_stereo_and_fisheye(tmp_path: Path) -> None:
    # the first line that OpenCV 4 writes is no YAML
    path = by_opencv(tmp_path / "calibration.yml", ("cameraMatrix1", "distCoeffs1"))
    text = path.read_text().replace("%YAML 1.2", "%YAML:1.0")
    path.write_text(text)
    assert rm.read_cameras(path) == {"camera1": replace(WITH_BROWN, size=SIZE)}
    entries = "".join(text.partition("cameraMatrix1")[1:]).replace("cameraMatrix1", "M2").replace("distCoeffs1", "D2")
    path.write_text(text + entries)
    assert list(rm.read_cameras(str(path))) == ["camera1", "camera2"]
    flat = {"camera_matrix": K.tolist(), "distortion_coefficients": FISHEYE, "fisheye_model": 1}
    path.write_text(yaml.safe_dump(flat))
    assert rm.read_cameras(path) == {"camera": WITH_FISHEYE}


@pytest.mark.parametrize("name", ["K.txt", "K.csv", "K.npy"])
def test_a_camera_matrix_alone(tmp_path: Path, name: str) -> None:
    path, skewed = tmp_path / name, K.copy()
    skewed[0, 1] = 2.0

    def save(matrix: Any) -> None:
        if name == "K.npy":
            np.save(path, matrix)
        else:
            np.savetxt(path, matrix, delimiter="," if name == "K.csv" else " ", header="of the left camera")

    save(K)
    assert rm.read_cameras(path) == {"camera": rm.Camera.from_matrix(K)}
    assert parse_camera(str(path), "--camera").camera == rm.Camera.from_matrix(K)
    save(skewed)
    with pytest.raises(InputError, match=r"K\.\w+: camera matrix: it has skew, or a last row other than 0 0 1"):
        rm.read_cameras(path)


def test_arrays_of_numpy_that_are_no_camera_matrix(tmp_path: Path) -> None:
    path = tmp_path / "K.npy"
    for array, words in [
        (K[:2], r"K\.npy: an array of shape \(2, 3\) and type float64; give a camera matrix \(3, 3\)"),
        (np.full((3, 3), None), r"K\.npy: an array of shape \(3, 3\) and type object; give a camera matrix"),
    ]:
        np.save(path, array, allow_pickle=True)
        with pytest.raises(InputError, match=words):
            rm.read_cameras(path)
    path.write_bytes(b"no array")
    with pytest.raises(InputError, match=r"K\.npy: not an array of NumPy"):
        rm.read_cameras(path)


def test_colmap(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    models: dict[str, list[float]] = {
        "SIMPLE_PINHOLE": [900.0, 640.0, 480.0],
        "PINHOLE": [1000.0, 1010.0, 640.0, 480.0],
        "SIMPLE_RADIAL": [900.0, 640.0, 480.0, -0.2],
        "RADIAL": [900.0, 640.0, 480.0, -0.2, 0.05],
        "OPENCV": [1000.0, 1010.0, 640.0, 480.0, *BROWN[:4]],
        "FULL_OPENCV": [1000.0, 1010.0, 640.0, 480.0, *BROWN, 0.1, 0.02, 0.003],
        "OPENCV_FISHEYE": [1000.0, 1010.0, 640.0, 480.0, *FISHEYE],
        "SIMPLE_RADIAL_FISHEYE": [900.0, 640.0, 480.0, 0.05],
        "RADIAL_FISHEYE": [900.0, 640.0, 480.0, 0.05, -0.02],
        "FOV": [1000.0, 1010.0, 640.0, 480.0, 0.8],
        "THIN_PRISM_FISHEYE": [1000.0, 1010.0, 640.0, 480.0, 0.01, 2e-3, 1e-3, 1e-3, 1e-3, 1e-4, 1e-3, -1e-3],
    }
    reconstruction = pycolmap.Reconstruction()
    theirs = {}
    for index, (model, parameters) in enumerate(models.items(), start=1):
        camera = pycolmap.Camera(model=model, width=1280, height=960, params=parameters, camera_id=index)
        reconstruction.add_camera(camera)
        theirs[str(index)] = camera
    reconstruction.write_text(str(tmp_path))
    reconstruction.write_binary(str(tmp_path))
    texts, binaries = rm.read_cameras(tmp_path / "cameras.txt"), rm.read_cameras(tmp_path / "cameras.bin")
    assert texts == binaries
    assert set(texts) == set(theirs)
    points = np.random.default_rng(0).uniform((-0.6, -0.5, 1.0), (0.6, 0.5, 1.1), (50, 3))
    for name, camera in texts.items():
        pixels = np.asarray(theirs[name].img_from_cam(points))
        np.testing.assert_allclose(camera.project(points), pixels, rtol=0, atol=1e-9)
        rays = points / np.linalg.norm(points, axis=1)[:, None]
        np.testing.assert_allclose(camera.bearings(pixels), rays, rtol=0, atol=1e-8)
        assert camera.sees(points).all()
        assert camera.size == SIZE
    whole = Calibration(texts["10"])
    write_camera(tmp_path / "camera.json", whole)
    assert read_camera(tmp_path / "camera.json") == whole


def test_kalibr(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    left = {
        "cam_overlaps": [1],
        "camera_model": "pinhole",
        "distortion_coeffs": BROWN[:4],
        "distortion_model": "radtan",
        "intrinsics": [1000.0, 1010.0, 640.0, 480.0],
        "resolution": [1280, 960],
        "rostopic": "/cam0/image_raw",
    }
    right = {**left, "distortion_coeffs": FISHEYE, "distortion_model": "equidistant", "T_cn_cnm1": np.eye(4).tolist()}
    path.write_text(yaml.safe_dump({"cam0": left, "cam1": right}))
    expected = {"cam0": rm.Camera.from_opencv(K, BROWN[:4]), "cam1": WITH_FISHEYE}
    expected = {name: replace(camera, size=SIZE) for name, camera in expected.items()}
    assert rm.read_cameras(path) == expected
    assert parse_camera(f"{path}#cam1", "--camera").camera == expected["cam1"]
    with pytest.raises(InputError, match=r"cam0, cam1; choose one .*camchain.yaml#cam0"):
        parse_camera(str(path), "--camera")
    with pytest.raises(InputError, match="no camera is named 'cam7'"):
        parse_camera(f"{path}#cam7", "--camera")


@pytest.mark.parametrize("fisheye", [False, True])
def test_ros(tmp_path: Path, fisheye: bool) -> None:
    path, model = tmp_path / "camera_info.yaml", "equidistant" if fisheye else "plumb_bob"
    dist, camera = (FISHEYE, WITH_FISHEYE) if fisheye else (BROWN, WITH_BROWN)
    content = {
        "image_width": 1280,
        "image_height": 960,
        "camera_name": "narrow_stereo/left",
        "camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": len(dist), "data": dist},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": np.eye(3, 4).ravel().tolist()},
    }
    path.write_text(yaml.safe_dump(content))
    assert rm.read_cameras(path) == {"narrow_stereo/left": replace(camera, size=SIZE)}
    message = {"header": {"seq": 1}, "distortion_model": model, "d": dist, "k": K.ravel().tolist()}
    path.write_text(yaml.safe_dump(message))
    assert rm.read_cameras(path) == {"camera": camera}
    path.write_text(yaml.safe_dump(message | {"width": 1280, "height": 960}))
    assert rm.read_cameras(path) == {"camera": replace(camera, size=SIZE)}
    path.write_text(yaml.safe_dump(message | {"width": 1280, "height": -960}))
    with pytest.raises(InputError, match=r"camera_info.yaml: camera: size is \(1280, -960\); give a positive width"):
        rm.read_cameras(path)


@pytest.mark.parametrize(
    "camera",
    [
        WITH_BROWN,
        replace(WITH_FISHEYE, size=SIZE),
        rm.Camera.from_matrix(K),
        rm.Bearings(),
        rm.Rig([(replace(WITH_BROWN, size=SIZE), np.eye(3), np.zeros(3))]),
    ],
)
def test_our_own_come_back_unchanged(tmp_path: Path, camera: rm.Camera) -> None:
    path = tmp_path / "camera.json"
    write_camera(path, Calibration(camera, WITH_BROWN, axis=np.array([0.0, 1.0, 0.0])))
    back = read_camera(path)
    assert (back.camera, back.camera2) == (camera, WITH_BROWN)
    assert rm.read_cameras(path) == {"camera": camera, "camera2": WITH_BROWN}
    assert isinstance(back.camera, UnitRays | rm.Camera | rm.Rig)
    path.write_text(json.dumps({"cameras": {"a": json.loads(path.read_text()), "b": {"K": K.tolist()}}}))
    assert list(rm.read_cameras(path)) == ["a", "b"]
    assert parse_camera(f"{path}#b", "--camera").camera == rm.Camera.from_matrix(K)


def bad_yaml(**changes: object) -> str:
    content = {
        "camera_matrix": K.tolist(), "distortion_model": "plumb_bob", "distortion_coefficients": BROWN, **changes
    }  # fmt: skip
    return yaml.safe_dump(content)


def kalibr(**changes: object) -> str:
    camera = {"camera_model": "pinhole", "distortion_model": "none", "intrinsics": [900.0, 900.0, 1.0, 1.0], **changes}
    return yaml.safe_dump({"cam0": camera})


OWN = {"fx": 1000, "fy": 1000, "cx": 320, "cy": 240}
BOMB = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 8)}]\n" for k in range(1, 12)
)
BOMB += "camera_matrix: *a11\n"
"""Five hundred bytes that unfold to 69 billion entries."""
BAD: dict[str, tuple[str, str | bytes, str]] = {
    "nested": ("json", "[" * 5000 + "]" * 5000, "nested too deeply"),
    "nested dist": ("json", json.dumps(OWN)[:-1] + ', "dist": ' + "[" * 5000 + "]" * 5000 + "}", "nested too deeply"),
    "nested yaml": ("yaml", "camera_matrix: " + "[" * 500 + "]" * 500, "nested too deeply"),
    "nested xml": ("xml", "<opencv_storage>" + "<a>" * 5000 + "</a>" * 5000 + "</opencv_storage>", "no camera matrix"),
    "digits": ("json", json.dumps(OWN).replace("1000", "1" * 5000), "not JSON"),
    "fewer digits": ("json", json.dumps(OWN).replace("1000", "1" * 400), "hundreds of digits"),
    "digits in yaml": ("yaml", bad_yaml().replace("1000.0", "1" * 5000), "not YAML"),
    "digits in txt": ("txt", "1 PINHOLE 1 1 " + "9" * 5000 + " 1 1 1", "NaN or infinite"),
    "ragged": ("json", json.dumps({**OWN, "dist": [[0, 0], [0]]}), "different lengths"),
    "ragged K": ("json", '{"K": [[1, 0, 0], [0, 1], [0, 0, 1]]}', "not a matrix"),
    "count": ("json", json.dumps({**OWN, "dist": [0.1, 0.1, 0.1]}), "4, 5, 8, 12 or 14"),
    "fisheye count": ("json", json.dumps({**OWN, "fisheye": [0.1]}), "give 4"),
    "two lenses": ("json", json.dumps({**OWN, "fisheye": FISHEYE, "dist": BROWN}), "one lens"),
    "text": ("json", json.dumps({**OWN, "dist": ["wide", 0, 0, 0]}), "give numbers"),
    "bool": ("json", json.dumps({**OWN, "dist": [True, 0, 0, 0]}), "give numbers"),
    "nan": ("json", json.dumps({**OWN, "dist": [math.nan, 0, 0, 0]}), "NaN"),
    "nan focal": ("json", json.dumps({**OWN, "fx": math.nan}), "finite"),
    "tiny": ("json", json.dumps({**OWN, "fx": 1e-300}), "far below a pixel"),
    "negative": ("json", json.dumps({**OWN, "fy": -5}), "positive"),
    "direction": ("json", json.dumps({**OWN, "axis": [10**400, 0, 0]}), "three numbers"),
    "several": ("json", json.dumps({"cameras": {"a": OWN, "b": OWN}}), "a, b; choose one"),
    "none": ("json", json.dumps({"cameras": {}}), "cameras by name"),
    "colmap": ("json", json.dumps({**OWN, "colmap": "OWL"}), "no model|needs pycolmap"),
    "ros model": ("yaml", bad_yaml(distortion_model="fluffy"), "'fluffy'; give one of plumb_bob"),
    "ros count": ("yaml", bad_yaml(distortion_coefficients=BROWN[:4]), "plumb_bob has 5"),
    "ros K": ("yaml", bad_yaml(camera_matrix=[1.0, 2.0]), "9 of a 3"),
    "kalibr model": ("yaml", kalibr(camera_model="omni"), "only pinhole"),
    "kalibr distortion": ("yaml", kalibr(distortion_model="fluffy"), "radtan"),
    "kalibr count": ("yaml", kalibr(distortion_model="radtan", distortion_coeffs=[1.0]), "radtan has 4"),
    "kalibr intrinsics": ("yaml", kalibr(intrinsics=[1.0]), "fx, fy, cx and cy"),
    "kalibr none": ("yaml", kalibr(intrinsics=None), "list of numbers"),
    "python": ("yaml", "camera_matrix: !!python/object/apply:os.getcwd []", "not YAML"),
    "laughs": ("yaml", "a: &a [1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b]\ncamera_matrix: *c", "."),
    "itself": ("yaml", "camera_matrix: &a [1, *a]", "list or mapping that contains it"),
    "kalibr list": ("yaml", kalibr(distortion_model=["none"]), "radtan"),
    "list": ("yaml", "- 1\n- 2", "not a mapping"),
    "empty": ("yaml", "", "not a mapping"),
    "other yaml": ("yaml", "name: camera", "no camera matrix"),
    "entities": ("xml", '<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage/>', "entities"),
    "xml root": ("xml", "<calibration/>", "opencv_storage"),
    "xml": ("xml", "<opencv_storage>", "not XML"),
    "line": ("txt", "1 PINHOLE 640 480", "CAMERA_ID MODEL"),
    "line count": ("txt", "1 PINHOLE 640 480 1000 1000 320", "PINHOLE has 4"),
    "line model": ("txt", "1 OWL 640 480 1000 1000 320", "no model|needs pycolmap"),
    "line words": ("txt", "1 PINHOLE 640 480 a b c d", "not numbers"),
    "comments": ("txt", "# nothing", "no camera"),
    "short": ("bin", struct.pack("<QiiQQ", 1, 1, 1, 5, 5), "ends too early"),
    "announced": ("bin", struct.pack("<Q", 2**60), "announced"),
    "model": ("bin", struct.pack("<QiiQQ", 1, 1, 99, 5, 5), "model 99"),
    "too long": ("bin", struct.pack("<QiiQQ4d", 1, 1, 1, 5, 5, 9, 9, 1, 1) + b"more", "4 bytes too many"),
    "latin": ("yaml", b"name: \xe9", "UTF-8"),
    "bomb": ("yaml", BOMB, "its aliases expand to more than"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_calibration_is_one_clear_line(tmp_path: Path, case: str) -> None:
    suffix, content, words = BAD[case]
    path = tmp_path / f"camera.{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(rm.RootmatchError, match=words) as caught:
        read_camera(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))
    if "needs pycolmap" not in str(caught.value):
        assert isinstance(caught.value, InputError)
        assert str(caught.value).startswith(str(path))
    if case not in ("several", "direction"):
        with pytest.raises(rm.RootmatchError):
            rm.read_cameras(path)


BOMBS = {
    "matrix": "camera_matrix: *a9",
    "flag": "camera_matrix: [[900, 0, 1], [0, 900, 1], [0, 0, 1]]\nfisheye_model: *a9",
    "name": "camera_matrix: [[900, 0, 1], [0, 900, 1], [0, 0, 1]]\ndistortion_model: none\ncamera_name: *a9",
    "kalibr": "cam0: {camera_model: *a9}",
    "merged": "camera_matrix: {<<: *m9}",
}
"""Each with nine levels of ten aliases before it, a thousand million entries."""


def test_aliases_that_stand_for_gigabytes_are_refused_before_they_are_built(tmp_path: Path) -> None:
    """In a process that may take 2 GB of addresses, most of them its libraries', and 20 seconds of processor time."""
    pytest.importorskip("resource")
    levels = "a0: &a0 [1,1,1,1,1,1,1,1,1,1]\nm0: &m0 {x: 1}\n"
    for k in range(1, 10):
        ten = ",".join([f"*a{k - 1}"] * 10)
        levels += f"a{k}: &a{k} [{ten}]\nm{k}: &m{k} {{<<: [{ten.replace('a', 'm')}]}}\n"
    for name, bomb in BOMBS.items():
        (tmp_path / f"{name}.yaml").write_text(levels + bomb)
    program = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, (2 * 10**9, 2 * 10**9))
resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
import rootmatch as rm
from rootmatch.errors import quote_value
for path in sorted(Path(sys.argv[1]).glob("*.yaml")):
    try:
        rm.read_cameras(path)
    except rm.InputError as error:
        assert "aliases expand to more than" in str(error), error
        print(path.stem)
value = [1]
for _ in range(12):
    value = [value] * 8
assert len(quote_value(value)) == 60
try:
    rm.read_cameras("/dev/zero")
except rm.InputError as error:
    print("no end" if "more than the 10,000,000 bytes that are read" in str(error) else error)
"""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    result = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, env=environment
    )
    assert result.stderr == ""
    assert result.stdout.split("\n")[:-1] == [*sorted(BOMBS), "no end"]


def test_what_is_no_file(tmp_path: Path) -> None:
    for name, words in [("no.yaml", "no such file"), ("no.bin", "no such file"), (".", "folder")]:
        with pytest.raises(InputError, match=words):
            rm.read_cameras(tmp_path / name)
    (tmp_path / "large.yaml").write_bytes(b" " * 10_000_001)
    with pytest.raises(InputError, match="this is not a calibration"):
        rm.read_cameras(tmp_path / "large.yaml")


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        (lambda path: path / "missing.yaml", "no such file"),
        (lambda path: path / "bad.yaml", "plumb_bob has 5"),
        (lambda path: f"{path / 'two.json'}", "choose one"),
        (lambda path: f"{path / 'two.json'}#c", "no camera is named 'c'"),
    ],
)
def test_bad_camera_files_on_the_command_line(tmp_path: Path, camera: Callable[[Path], object], words: str) -> None:
    (tmp_path / "bad.yaml").write_text(bad_yaml(distortion_coefficients=[0.1]))
    (tmp_path / "two.json").write_text(json.dumps({"cameras": {"a": OWN, "b": OWN}}))
    write_points(tmp_path / "model.csv", PointSet(np.random.default_rng(0).normal(size=(5, 3))))
    write_points(tmp_path / "image.csv", PointSet(np.random.default_rng(1).normal(size=(5, 2))))
    arguments = ["match", str(tmp_path / "model.csv"), str(tmp_path / "image.csv"), "--problem", "p3p"]
    result = CliRunner().invoke(app, [*arguments, "--camera", str(camera(tmp_path))], catch_exceptions=False)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("camera", ["fisheye", "bearings"])
def test_a_scene_of_another_camera_goes_through_its_files(tmp_path: Path, camera: str) -> None:
    calibration = WITH_FISHEYE if camera == "fisheye" else rm.Bearings()
    write_camera(tmp_path / "lens.json", Calibration(calibration))
    sigma = 0.2 if camera == "fisheye" else 2e-4
    scene = ["simulate", "p3p", "--points", "9", "--outliers", "2", "--noise", str(sigma), "--seed", "3"]
    folder = tmp_path / "scene"
    made = CliRunner().invoke(app, [*scene, "--camera", str(tmp_path / "lens.json"), "--output", str(folder)])
    assert made.exit_code == 0, made.stderr
    command = made.stdout.splitlines()[-1].split()[1:]
    assert read_camera(folder / "camera.json").camera == calibration
    matched = CliRunner().invoke(app, [*command, "--json"], catch_exceptions=False)
    assert matched.exit_code == 0, matched.stderr
    assert json.loads(matched.stdout)["status"] == "matched"
    header = (folder / "image.csv").read_text().splitlines()[0]
    assert header == ("x,y" if camera == "fisheye" else "x,y,z")
    picture = CliRunner().invoke(app, [*command, "--plot", str(tmp_path / "match.png")], catch_exceptions=False)
    assert picture.exit_code == 0, picture.stderr
