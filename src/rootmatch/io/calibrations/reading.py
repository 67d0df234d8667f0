"""`read_cameras`: the cameras of a calibration file, whatever tool wrote it."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.io.calibrations.colmap import read_colmap_binary, read_colmap_text
from rootmatch.io.calibrations.kalibr import is_kalibr, read_kalibr
from rootmatch.io.calibrations.native import EXAMPLE, parse_cameras
from rootmatch.io.calibrations.opencv import is_opencv, parse_xml, read_opencv
from rootmatch.io.calibrations.ros import is_ros, read_ros
from rootmatch.io.calibrations.values import LARGEST, load_yaml, prefix_errors, run_parser
from rootmatch.io.csv_tables import read_text
from rootmatch.io.inputs import read_bytes

SUFFIXES = (".json", ".yaml", ".yml", ".xml", ".txt", ".bin", ".csv", ".npy")
"""Suffixes of calibration files that can be read."""
REMEDY = "this is not a calibration; give the file of the camera"

EXPECTED = "give a camera matrix (3, 3) of numbers"


def read_cameras(path: str | os.PathLike[str]) -> dict[str, CameraModel]:
    """Read the cameras of a calibration file.

    Parameters
    ----------
    path : str or path
        What OpenCV's FileStorage wrote (YAML, XML or JSON), COLMAP's ``cameras.txt`` or ``cameras.bin``, Kalibr's
        camchain (YAML), ROS' ``camera_info`` (YAML), a camera file of `rootmatch` (JSON), or a camera matrix alone as
        NumPy's ``savetxt`` and ``save`` write it.

    Returns
    -------
    dict of str to Camera
        By name: COLMAP's ids, Kalibr's ``cam0``, …, ROS' ``camera_name``, the names in our JSON; else ``camera``, or
        ``camera1`` and ``camera2``. Pixels are in the convention of the file: the centre of the upper left one is
        (0, 0), but (0.5, 0.5) for COLMAP.

    Raises
    ------
    InputError
        If the file cannot be read, is none of these, or holds a camera that is not valid or an entry that may be a lens
        and is not read.
    RootmatchError
        If a model of COLMAP needs pycolmap (the extra ``colmap``) and it is not installed.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix == ".bin":
        return dict(read_colmap_binary(file, read_bytes(file, LARGEST, REMEDY)))
    if suffix == ".npy":
        return dict(read_npy(file, read_bytes(file, LARGEST, REMEDY)))
    text = read_small_text(file)
    if (rows := parse_matrix_rows(text)) is not None:
        return dict(read_matrix(file, rows))
    if suffix == ".txt":
        return dict(read_colmap_text(file, text))
    if suffix == ".xml" or text.lstrip().startswith("<"):
        return dict(read_opencv(file, parse_xml(file, text)))
    content = load_json(file, text) if suffix == ".json" else load_yaml(file, text)
    if not isinstance(content, dict):
        kind = "a JSON object" if suffix == ".json" else "a mapping of names to values"
        raise InputError(f"{file}: not {kind}; give a calibration file, or {EXAMPLE}")
    if is_kalibr(content):
        return dict(read_kalibr(file, content))
    if is_ros(content):
        return dict(read_ros(file, content))
    if is_opencv(content) or suffix != ".json":
        return dict(read_opencv(file, content))
    return parse_cameras(file, content)


def load_json(path: Path, text: str, expected: str = f"give {EXAMPLE}") -> Any:
    """The value of a JSON text; ``expected`` tells the user what to give."""

    def load() -> Any:
        try:
            return json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"{path}, row {error.lineno}: not JSON ({error.msg}); {expected}") from None

    return run_parser(path, "JSON", load)


def read_small_text(path: Path) -> str:
    """The text of a file that is not too large for a calibration."""
    return read_text(path, LARGEST, REMEDY)


def parse_matrix_rows(text: str) -> list[list[float]] | None:
    """Three rows of three numbers, with spaces or commas between them; None of any other text."""
    rows = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
    rows = [row for row in rows if row]
    try:
        return [list(map(float, row)) for row in rows] if list(map(len, rows)) == [3, 3, 3] else None
    except ValueError:
        return None


def read_matrix(path: Path, rows: Any) -> dict[str, Camera]:
    """The camera of a matrix, by the name of a camera that is alone in its file."""
    with prefix_errors(path):
        return {"camera": Camera.from_matrix(rows)}


def read_npy(path: Path, data: bytes) -> dict[str, Camera]:
    """The camera of an array that `numpy.save` wrote; no other array is loaded."""

    def load() -> Any:
        stream = io.BytesIO(data)
        newer = np.lib.format.read_magic(stream) != (1, 0)
        header = np.lib.format.read_array_header_2_0 if newer else np.lib.format.read_array_header_1_0
        shape, _, dtype = header(stream)
        if shape != (3, 3) or dtype.kind not in "fiu":
            raise InputError(f"{path}: an array of shape {shape} and type {dtype.name[:40]}; {EXPECTED}")
        return np.load(io.BytesIO(data), allow_pickle=False)

    return read_matrix(path, run_parser(path, "an array of NumPy", load))
