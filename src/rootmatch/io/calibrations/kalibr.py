"""Kalibr's camchain YAML: cameras cam0, cam1, … with intrinsics and a distortion model each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rootmatch.cameras.brown import Brown
from rootmatch.cameras.colmap import Colmap
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.lens import Lens
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError, quote_value
from rootmatch.io.calibrations.distortion import refuse_unread
from rootmatch.io.calibrations.values import prefix_errors, read_numbers

COUNTS = {"radtan": 4, "equidistant": 4, "fov": 1, "none": 0}
"""Coefficients of each distortion model."""


def is_kalibr(content: dict[str, Any]) -> bool:
    """Whether all entries that are cameras name their model as Kalibr does."""
    return any(isinstance(entry, dict) and "camera_model" in entry for entry in content.values())


def read_kalibr(path: Path, content: dict[str, Any]) -> dict[str, Camera]:
    """The cameras of one file by their names."""
    found = {}
    for name, entry in content.items():
        if not isinstance(entry, dict) or "camera_model" not in entry:
            continue
        where = f"{path}: {quote_value(name)}"
        if entry["camera_model"] != "pinhole":
            raise InputError(f"{where}: camera_model is {quote_value(entry['camera_model'])}; only pinhole is known")
        model = entry.get("distortion_model", "none")
        if not isinstance(model, str) or model not in COUNTS:
            raise InputError(f"{where}: distortion_model is {quote_value(model)}; give one of {', '.join(COUNTS)}")
        intrinsics = read_numbers(path, f"{name}: intrinsics", entry.get("intrinsics"))
        values = read_numbers(path, f"{name}: distortion_coeffs", entry.get("distortion_coeffs", []))
        refuse_unread(where, entry, ("distortioncoeffs",))
        if len(intrinsics) != 4:
            raise InputError(f"{where}: {len(intrinsics)} intrinsics given; give fx, fy, cx and cy")
        if len(values) != COUNTS[model]:
            raise InputError(f"{where}: {len(values)} distortion_coeffs given, and {model} has {COUNTS[model]}")
        with prefix_errors(where):
            fx, fy, cx, cy = intrinsics
            lens = _lens(str(model), tuple(values))
            found[str(name)] = Camera(fx, fy, cx, cy, lens, size=entry.get("resolution"))
    return found


def _lens(model: str, values: tuple[float, ...]) -> Lens | None:
    if model == "radtan" and any(values):
        return Brown(values)
    if model == "equidistant":
        return KannalaBrandt(values)
    if model == "fov":
        return Colmap("FOV", values)
    return None
