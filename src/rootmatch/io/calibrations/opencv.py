"""OpenCV's FileStorage (YAML, XML, JSON): a camera matrix and its distortion coefficients, by their usual names."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.io.calibrations.distortion import COEFFICIENTS, coefficients, is_fisheye, refuse_unread
from rootmatch.io.calibrations.values import IMAGE_SIZE, prefix_errors, read_3x3, run_parser, with_image_size

MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "K", "M", "mtx")
FISHEYE_FLAG = "fisheye_model"
"""Nonzero in what OpenCV's calibration sample writes for `cv2.fisheye`."""


def is_opencv(content: dict[str, Any]) -> bool:
    """Whether some entry is a camera matrix as OpenCV writes it, or has its name."""
    return any(
        name not in ("K", "M") or (isinstance(content[name], dict) and "data" in content[name])
        for name, _ in _find_matrix_names(content)
    )


def read_opencv(path: Path, content: dict[str, Any]) -> dict[str, Camera]:
    """Cameras of one file: ``camera`` where there is one, else ``camera1`` and ``camera2``."""
    found: dict[str, Camera] = {}
    flag = str(content.get(FISHEYE_FLAG, "")).strip().lower() in ("1", "1.0", "true", "fisheye", "equidistant")
    fisheye = flag or is_fisheye(path, content)
    known = {FISHEYE_FLAG}
    for name, index in _find_matrix_names(content):
        K = read_3x3(path, name, content[name])
        dist, values = coefficients(path, content, index)
        known |= {coefficient + index for coefficient in COEFFICIENTS}
        try:
            camera = Camera.from_opencv_fisheye(K, values) if fisheye else Camera.from_opencv(K, values)
        except InputError as error:
            raise InputError(f"{path}: {dist if 'distortion' in str(error) else name}: {error}") from None
        with prefix_errors(path):
            found[f"camera{index}"] = with_image_size(camera, content, IMAGE_SIZE)
    if not found:
        raise InputError(f"{path}: it holds no camera matrix; give one as camera_matrix, with distortion_coefficients")
    refuse_unread(path, content, known)
    return found


def parse_xml(path: Path, text: str) -> dict[str, Any]:
    """The entries of an XML file, matrices as mappings with ``data``."""
    if "<!" in text.replace("<!--", ""):
        raise InputError(f"{path}: it declares entities or a document type, which OpenCV does not write; remove them")
    root = run_parser(path, "XML", lambda: ElementTree.fromstring(text))
    if root.tag != "opencv_storage":
        raise InputError(f"{path}: its root is <{root.tag[:40]}>, not <opencv_storage>; give a file of OpenCV")
    content: dict[str, Any] = {}
    for entry in root:
        data = entry.find("data")
        if data is None:
            content[entry.tag] = (entry.text or "").strip()
        else:
            sides = {side: entry.findtext(side, "1") for side in ("rows", "cols")}
            content[entry.tag] = {**sides, "data": (data.text or "").split()}
    return content


def _find_matrix_names(content: dict[str, Any]) -> list[tuple[str, str]]:
    """Names of the camera matrices, and each camera's number: cameraMatrix1 goes with distCoeffs1."""
    found = []
    for index in ("", "1", "2"):
        name = next((name + index for name in MATRICES if name + index in content), None)
        if name is not None:
            found.append((name, index))
    return found
