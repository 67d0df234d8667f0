"""Cameras and measured directions, from command-line text and JSON camera files."""

from __future__ import annotations

import difflib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.vertical import unit_direction
from rootmatch.errors import InputError
from rootmatch.io.atomic_output import written_whole
from rootmatch.io.csv_tables import read_text

NUMBERS = ("fx", "fy", "cx", "cy")
DISTORTION = ("distortion", "distortion_coefficients", "dist", "distcoeffs", "k1", "k2", "k3", "p1", "p2")
DIRECTIONS = ("vertical_camera", "vertical_world", "axis", "axis2")
EXAMPLE = '{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240}'


@dataclass(frozen=True)
class Calibration:
    """Contents of a camera file: one or two cameras and the measured common directions.

    Directions are unit vectors (3,); None where the file gives none.
    """

    camera: Camera
    camera2: Camera | None = None
    vertical_camera: NDArray[np.float64] | None = None
    vertical_world: NDArray[np.float64] | None = None
    axis: NDArray[np.float64] | None = None
    axis2: NDArray[np.float64] | None = None


def read_camera(path: Path) -> Calibration:
    """Read a JSON object with ``fx, fy, cx, cy`` or ``K``, and optionally ``camera2`` and the measured directions.

    Other keys are ignored, with two exceptions: a nonzero lens distortion, which would spoil every residual, and a key
    so close to a known one that it is probably a typo.
    """
    try:
        content = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}, row {error.lineno}: not JSON ({error.msg}); give {EXAMPLE}") from None
    camera = _camera(path, content, ("camera2", *DIRECTIONS))
    camera2 = _camera(path, content["camera2"], ()) if content.get("camera2") is not None else None
    directions: dict[str, NDArray[np.float64]] = {}
    for name in DIRECTIONS:
        if content.get(name) is not None:
            value = content[name]
            if not isinstance(value, list) or not all(isinstance(number, int | float) for number in value):
                raise InputError(f"{path}: {name} is {value!r}; give three numbers such as [0, 1, 0]")
            directions[name] = unit_direction(value, f"{path}: {name}")
    return Calibration(camera, camera2, **directions)


def write_camera(path: Path, calibration: Calibration) -> None:
    """Write a calibration that `read_camera` reads back unchanged."""
    content: dict[str, Any] = {name: getattr(calibration.camera, name) for name in NUMBERS}
    if calibration.camera2 is not None:
        content["camera2"] = {name: getattr(calibration.camera2, name) for name in NUMBERS}
    for name in DIRECTIONS:
        if getattr(calibration, name) is not None:
            content[name] = np.asarray(getattr(calibration, name), dtype=float).tolist()
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def parse_numbers(text: str, count: int, name: str, example: str) -> list[float]:
    """Parse ``count`` finite numbers from text such as ``"0,1,0"``; ``name`` and ``example`` go into the error."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(f"{name}: {text!r} given; give {count} finite numbers separated by commas, such as {example}")
    return values


def parse_direction(text: str, name: str) -> NDArray[np.float64]:
    """Parse ``"x,y,z"`` as a unit vector (3,)."""
    return unit_direction(parse_numbers(text, 3, name, "0,1,0"), name)


def parse_camera(text: str, name: str) -> Calibration:
    """Parse ``"FX,FY,CX,CY"`` in pixels, or read the camera file (JSON) of that name."""
    if text.lower().endswith(".json") or os.path.exists(text):  # unlike Path.exists, no error for over-long texts
        return read_camera(Path(text))
    try:
        fx, fy, cx, cy = parse_numbers(text, 4, name, "1000,1000,320,240")
        return Calibration(Camera(fx, fy, cx, cy))
    except InputError as error:
        hint = "" if "," in text else ", or the path of a camera file (JSON)"
        raise InputError(f"{name}: {str(error).removeprefix(f'{name}: ').removeprefix('camera: ')}{hint}") from None


def _camera(path: Path, content: Any, more: Sequence[str]) -> Camera:
    """The camera of a JSON object; ``more`` lists its other known keys."""
    if not isinstance(content, dict):
        raise InputError(f"{path}: not a JSON object; give {EXAMPLE}")
    known = (*NUMBERS, "K", *more)
    for key in content:
        if key.lower() in DISTORTION and np.any(np.asarray(content[key]) != 0):
            raise InputError(f"{path}: it has a lens distortion ({key}); undistort the image points, then leave it out")
        near = difflib.get_close_matches(key, [name for name in known if len(name) > 2], n=1, cutoff=0.7)
        if near and key not in known:
            raise InputError(f"{path}: {key!r} is unknown; did you mean {near[0]!r}? Rename it, or leave it out")
    try:
        if "K" in content:
            return Camera.from_matrix(np.array(content["K"], dtype=float))
        missing = [name for name in NUMBERS if name not in content]
        if missing:
            raise InputError(f"{missing[0]} is missing; give fx, fy, cx and cy in pixels, or the matrix K")
        return Camera(*(content[name] for name in NUMBERS))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (TypeError, ValueError):
        raise InputError(f"{path}: K is not a matrix of numbers; give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]") from None
