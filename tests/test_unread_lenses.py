"""Lenses in calibration files: read by all the usual names of their coefficients, else refused and never dropped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import rootmatch as rm
from rootmatch.errors import InputError
from rootmatch.io import read_camera

K = np.array([[1000.0, 0.0, 640.0], [0.0, 1010.0, 480.0], [0.0, 0.0, 1.0]])
BROWN, FISHEYE = [-0.28, 0.07, 1e-3, -2e-3, 0.01], [0.05, -0.02, 0.003, -0.0005]
WITH_BROWN, WITH_FISHEYE = rm.Camera.from_opencv(K, BROWN), rm.Camera.from_opencv_fisheye(K, FISHEYE)
LENSES = (
    "D", "d", "dist", "dist_coeffs", "dist_coeff", "distCoeffs", "distCoef", "dist-coefs", "distortion",
    "distortion_coeffs", "distortionCoefficients", "Distortion_Coefficients", "DISTORTION",
)  # fmt: skip
UNREAD = (
    "kc", "coeffs", "coefficients", "lens", "radial", "radial_distortion", "lens_coefficients", "dist_coeffs_left",
    "distortion_params", "undist_poly", "brown", "x", "k",
)  # fmt: skip
METADATA: dict[str, object] = {
    "date": "2026-11-22", "image_size": [1280, 960], "image_width": 1280, "rms": 0.3, "avg_reprojection_error": 0.2,
    "n_frames": 31, "frames_used": [0, 4, 5, 8, 9], "per_view_errors": [[0.2], [0.3], [0.2], [0.4]],
    "R": np.eye(3).ravel().tolist(), "T_cam_imu": np.eye(4).tolist(), "rvecs": [[0.1, 0.2, 0.3]] * 4,
    "extrinsic_parameters": [[1, 2, 3, 4, 5, 6]] * 2, "pose": [1, 2, 3, 0, 0, 0, 1], "P1": np.eye(3, 4).tolist(),
    "newcameramtx": K.tolist(), "intrinsics": [1000, 1010, 640, 480], "roi": [0, 0, 1280, 960], "serial": [4, 8, 1, 5],
    "std_dev_distortion": [0.1, 0.2, 0.3, 0.4], "lens": "Fujinon HF8XA", "lens_focal_length_mm": 8, "lens_model": "C 8",
    "focus_distance": 1.5, "distance": 2.0, "undistorted": True, "F": list(range(9)),
    "k1": 0, "radial": [0.0, 0.0], "coeffs": [0, 0, 0, 0],
    "kc": None, "distortion_model": "plumb_bob",
}  # fmt: skip
BESIDE: dict[str, dict[str, object]] = {
    "numbers": {"fx": 1000.0, "fy": 1010.0, "cx": 640.0, "cy": 480.0},
    "K": {"K": K.tolist()},
    "camera_matrix": {"camera_matrix": K.tolist()},
}


KALIBR = {"camera_model": "pinhole", "distortion_model": "none", "intrinsics": [900.0, 900.0, 1.0, 1.0]}


@pytest.mark.parametrize("beside", BESIDE)
def test_coefficients_are_read_by_all_their_usual_names(tmp_path: Path, beside: str) -> None:
    path = tmp_path / "camera.json"
    for name in LENSES:
        for values in (BROWN, [BROWN], {"rows": 5, "cols": 1, "data": BROWN}):
            path.write_text(json.dumps({**BESIDE[beside], name: values}))
            assert rm.read_cameras(path) == {"camera": WITH_BROWN}
            assert read_camera(path).camera == WITH_BROWN
        path.write_text(json.dumps({**BESIDE[beside], name: FISHEYE, "distortion_model": "equidistant"}))
        assert rm.read_cameras(path) == {"camera": WITH_FISHEYE}
        path.write_text(json.dumps({**BESIDE[beside], name: [0, 0, 0, 0]}))
        assert rm.read_cameras(path) == {"camera": rm.Camera.from_matrix(K)}
    path.write_text(json.dumps({**BESIDE[beside], "D": BROWN, "dist_coeffs": BROWN}))
    assert rm.read_cameras(path) == {"camera": WITH_BROWN}
    path.write_text(json.dumps({**BESIDE[beside], "D": BROWN, "dist_coeffs": FISHEYE}))
    with pytest.raises(InputError, match="D and dist_coeffs differ"):
        rm.read_cameras(path)


@pytest.mark.parametrize("suffix", ["json", "yaml", "ros", "xml"])
@pytest.mark.parametrize("name", UNREAD)
def test_what_may_be_a_lens_is_not_dropped(tmp_path: Path, suffix: str, name: str) -> None:
    path = tmp_path / f"camera.{suffix.replace('ros', 'yaml')}"
    if suffix == "json":
        path.write_text(json.dumps({**BESIDE["numbers"], name: BROWN}))
    elif suffix == "xml":
        matrices = {"camera_matrix": (3, 3, K.ravel().tolist()), name: (1, 5, BROWN)}
        entries = [
            f'<{tag} type_id="opencv-matrix"><rows>{rows}</rows><cols>{cols}</cols><dt>d</dt>'
            f"<data>{' '.join(map(str, data))}</data></{tag}>"
            for tag, (rows, cols, data) in matrices.items()
        ]
        path.write_text(f"<opencv_storage>{''.join(entries)}</opencv_storage>")
    else:
        model = {"distortion_model": "plumb_bob"} if suffix == "ros" else {}
        path.write_text(yaml.safe_dump({"camera_matrix": K.tolist(), **model, name: BROWN}))
    for read in (rm.read_cameras, read_camera):
        with pytest.raises(InputError, match=f"'{name}' is .* this may be a lens, but is not read") as caught:
            read(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"radial": [-0.1, 0.02]}, "'radial' is"),
        ({"lens": {"k1": -0.1, "k2": 0.02}}, "'lens' is"),
        ({"radial_distortion": -0.1}, "'radial_distortion' is -0.1"),
        ({"k1": -0.1, "k2": 0.02}, "k1 is given on its own; give all coefficients as a list"),
        ({"D": BROWN, "distortion_type": "fluffy"}, "distortion_type is 'fluffy'"),
    ],
)
@pytest.mark.parametrize("beside", BESIDE)
def test_a_lens_in_another_form_is_not_dropped(
    tmp_path: Path, beside: str, entries: dict[str, object], words: str
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({**BESIDE[beside], **entries}))
    with pytest.raises(InputError, match=words):
        rm.read_cameras(path)
    path.write_text(json.dumps({"cameras": {"left": {**BESIDE["numbers"], **entries}}}))
    with pytest.raises(InputError, match=words):
        rm.read_cameras(path)


@pytest.mark.parametrize("beside", BESIDE)
def test_metadata_is_ignored(tmp_path: Path, beside: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({**METADATA, **BESIDE[beside], "D": BROWN}))
    assert rm.read_cameras(path) == {"camera": WITH_BROWN}


def test_a_camchain_with_a_lens_by_another_name_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump({"cam0": {**KALIBR, "dist_coeffs": BROWN}}))
    with pytest.raises(InputError, match=r"'cam0': 'dist_coeffs' is .* this may be a lens"):
        rm.read_cameras(path)
