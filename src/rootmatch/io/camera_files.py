"""Cameras and measured directions, from command-line text and camera files; what we write is JSON."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.vertical import unit_direction
from rootmatch.errors import InputError, quote_value
from rootmatch.io.calibrations.native import DIRECTIONS, camera_entry, camera_from_entry
from rootmatch.io.calibrations.opencv import is_opencv
from rootmatch.io.calibrations.reading import SUFFIXES, load_json, read_cameras, read_small_text
from rootmatch.io.inputs import make_rereadable
from rootmatch.io.outputs import write_text_atomically


@dataclass(frozen=True)
class Calibration:
    """Contents of a camera file: one or two cameras and the measured common directions.

    Directions are unit vectors (3,); None if the file gives none.
    """

    camera: CameraModel
    camera2: CameraModel | None = None
    vertical_camera: Floats | None = None
    vertical_world: Floats | None = None
    axis: Floats | None = None
    axis2: Floats | None = None


def read_camera(path: Path, name: str | None = None) -> Calibration:
    """Read one camera of a file, and what our own format (JSON) adds: ``camera2`` and the measured directions.

    Parameters
    ----------
    path : path
        See `rootmatch.io.calibrations.reading.read_cameras`. Our JSON object has ``fx, fy, cx, cy`` or ``K``, and a
        lens as ``dist`` (OpenCV's coefficients) or ``fisheye`` (four of them); or ``"bearings": true``. Other keys
        are ignored, but for one so close to a known one that it is probably a typo, and one that may be a lens.
    name : str, optional
        Which of several cameras.
    """
    with make_rereadable(path) as file:
        content = load_json(file, read_small_text(file)) if file.suffix.lower() == ".json" else None
        ours = content if isinstance(content, dict) and not is_opencv(content) else None
        if ours is not None and "cameras" not in ours and name is None:
            camera = camera_from_entry(file, ours, ("camera2", *DIRECTIONS))
            camera2 = camera_from_entry(file, ours["camera2"], ()) if ours.get("camera2") is not None else None
            return Calibration(camera, camera2, **_read_directions(file, ours))
        found = read_cameras(file)
        if name is None and len(found) > 1:
            hint = f"choose one by its name, such as {file}#{next(iter(found))}"
            raise InputError(f"{file}: cameras {_list_names(found)}; {hint}")
        if name is not None and name not in found:
            raise InputError(f"{file}: no camera is named {quote_value(name)}; it has {_list_names(found)}")
        chosen = next(iter(found.values())) if name is None else found[name]
        return Calibration(chosen, None, **_read_directions(file, ours or {}))


def write_camera(path: Path, calibration: Calibration) -> None:
    """Write a calibration that `read_camera` reads back unchanged."""
    content = camera_entry(calibration.camera)
    if calibration.camera2 is not None:
        content["camera2"] = camera_entry(calibration.camera2)
    for name in DIRECTIONS:
        if getattr(calibration, name) is not None:
            content[name] = np.asarray(getattr(calibration, name), dtype=float).tolist()
    write_text_atomically(path, json.dumps(content, indent=2) + "\n")


def parse_numbers(text: str, count: int, name: str, example: str) -> list[float]:
    """Parse ``count`` finite numbers from text such as ``"0,1,0"``; ``name`` and ``example`` go into the error."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(
            f"{name}: {quote_value(text)} given; give {count} finite numbers separated by commas, such as {example}"
        )
    return values


def parse_direction(text: str, name: str) -> Floats:
    """Parse ``"x,y,z"`` as a unit vector (3,)."""
    return unit_direction(parse_numbers(text, 3, name, "0,1,0"), name)


def parse_camera(text: str, name: str) -> Calibration:
    """Parse ``"FX,FY,CX,CY"`` in pixels, or read the camera file of that name, a camera of several as ``FILE#NAME``."""
    file, chosen = _split_file_and_name(text)
    if file is not None:
        return read_camera(file, chosen)
    try:
        fx, fy, cx, cy = parse_numbers(text, 4, name, "1000,1000,320,240")
        return Calibration(Camera(fx, fy, cx, cy))
    except InputError as error:
        hint = "" if "," in text else ", or the path of a camera file"
        raise InputError(f"{name}: {str(error).removeprefix(f'{name}: ').removeprefix('camera: ')}{hint}") from None


def path_of_camera_text(text: str) -> Path | None:
    """The file that `parse_camera` reads for a text; None for numbers."""
    return _split_file_and_name(text)[0]


def _split_file_and_name(text: str) -> tuple[Path | None, str | None]:
    if os.path.exists(text):  # unlike Path.exists, no error for over-long texts
        return Path(text), None
    file, mark, chosen = text.rpartition("#")
    if mark and (os.path.exists(file) or file.lower().endswith(SUFFIXES)):
        return Path(file), chosen
    return (Path(text) if text.lower().endswith(SUFFIXES) else None), None


def _list_names(found: dict[str, CameraModel]) -> str:
    names = [quote_value(name)[1:-1] for name in found]
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _read_directions(path: Path, content: dict[str, Any]) -> dict[str, Floats]:
    """The measured directions of a JSON object."""
    directions: dict[str, Floats] = {}
    for name in DIRECTIONS:
        if content.get(name) is not None:
            value = content[name]
            if not isinstance(value, list) or not all(isinstance(number, int | float) for number in value):
                raise InputError(f"{path}: {name} is {quote_value(value)}; give three numbers such as [0, 1, 0]")
            directions[name] = unit_direction(value, f"{path}: {name}")
    return directions
