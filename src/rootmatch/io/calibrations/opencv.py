"""OpenCV's FileStorage (YAML, XML, JSON): a camera matrix and its distortion coefficients, by their usual names."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.io.calibrations.values import matrix, numbers, parsed

MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "K", "M", "mtx")
DISTORTIONS = (
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "dist_coeff", "dist", "D",
)  # fmt: skip
FISHEYE_FLAG = "fisheye_model"
"""Nonzero in what OpenCV's calibration sample writes for `cv2.fisheye`."""


def is_opencv(content: dict[str, Any]) -> bool:
    """Whether some entry is a camera matrix as OpenCV writes it, or has its name."""
    return any(
        name not in ("K", "M") or (isinstance(content[name], dict) and "data" in content[name])
        for name, _, _ in _pairs(content)
    )


def read_opencv(path: Path, content: dict[str, Any]) -> dict[str, Camera]:
    """Cameras of one file: ``camera`` where there is one, else ``camera1`` and ``camera2``.

    Raises
    ------
    InputError
        If there is none, or one of them is not valid.
    """
    found: dict[str, Camera] = {}
    flag = content.get(FISHEYE_FLAG, content.get("distortion_model", ""))
    fisheye = str(flag).strip().lower() in ("1", "1.0", "true", "fisheye", "equidistant")
    for name, dist, index in _pairs(content):
        K = matrix(path, name, content[name])
        values = [] if dist is None else numbers(path, dist, content[dist])
        try:
            camera = Camera.from_opencv_fisheye(K, values) if fisheye else Camera.from_opencv(K, values)
        except InputError as error:
            raise InputError(f"{path}: {dist if 'distortion' in str(error) else name}: {error}") from None
        found[f"camera{index}"] = camera
    if not found:
        raise InputError(f"{path}: no camera matrix; give one as camera_matrix, with distortion_coefficients")
    return found


def xml_content(path: Path, text: str) -> dict[str, Any]:
    """The entries of an XML file, matrices as mappings with ``data``.

    Raises
    ------
    InputError
        If it is not what OpenCV writes.
    """
    if "<!" in text.replace("<!--", ""):
        raise InputError(f"{path}: it declares entities or a document type, which OpenCV does not write; remove them")

    def parse() -> ElementTree.Element:
        try:
            return ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise ValueError(str(error)) from None

    root = parsed(path, "XML", parse)
    if root.tag != "opencv_storage":
        raise InputError(f"{path}: its root is <{root.tag[:40]}>, not <opencv_storage>; give a file of OpenCV")
    content: dict[str, Any] = {}
    for entry in root:
        data = entry.find("data")
        content[entry.tag] = (entry.text or "").strip() if data is None else {"data": (data.text or "").split()}
    return content


def _pairs(content: dict[str, Any]) -> list[tuple[str, str | None, str]]:
    """Names of the matrices and of their coefficients, with the camera's number: cameraMatrix1 goes with distCoeffs1.

    The names of pairs need not be of one style.
    """
    pairs = []
    for index in ("", "1", "2"):
        name = next((name + index for name in MATRICES if name + index in content), None)
        dist = next((name + index for name in DISTORTIONS if name + index in content), None)
        if name is not None:
            pairs.append((name, dist, index))
    return pairs
