"""COLMAP's ``cameras.txt`` and ``cameras.bin``: cameras by their ids."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

from rootmatch.cameras.brown import Brown
from rootmatch.cameras.colmap import Colmap, colmap_parameters
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.lens import Lens
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError, quote_value
from rootmatch.io.calibrations.values import prefix_errors

NAMES = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION",
    "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM",
)  # fmt: skip
"""COLMAP's models by their numbers in binary files."""
COUNTS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4,
}  # fmt: skip
"""Parameters of the models that need no pycolmap."""
LINE = "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"
MAXIMUM = 1_000_000
"""Maximum number of cameras in a file of COLMAP."""


def read_colmap_text(path: Path, text: str) -> dict[str, Camera]:
    """Cameras of ``cameras.txt``: id, model, width, height and parameters on each line."""
    found = {}
    for row, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where, cells = f"{path}, row {row}", line.split()
        if len(cells) < 5 or not cells[0].isdigit():
            raise InputError(f"{where}: {quote_value(line)} given; give {LINE}")
        try:
            values = [float(cell) for cell in cells[4:]]
        except ValueError:
            raise InputError(f"{where}: parameters that are not numbers; give {LINE}") from None
        found[cells[0]] = colmap_camera(where, cells[1], values, (cells[2], cells[3]))
    if not found:
        raise InputError(f"{path}: it holds no camera; give COLMAP's cameras.txt")
    return found


def read_colmap_binary(path: Path, data: bytes) -> dict[str, Camera]:
    """Cameras of ``cameras.bin``."""
    found, at = {}, 8
    try:
        (count,) = struct.unpack_from("<Q", data)
        if not 0 < count < MAXIMUM:
            raise InputError(f"{path}: {count} cameras announced; give COLMAP's cameras.bin")
        for _ in range(count):
            camera_id, model, *extent = struct.unpack_from("<iiQQ", data, at)
            if not 0 <= model < len(NAMES):
                raise InputError(f"{path}: camera {camera_id} has model {model}, which is unknown; export cameras.txt")
            size = COUNTS.get(NAMES[model]) or len(colmap_parameters(NAMES[model])[2])
            values = struct.unpack_from(f"<{size}d", data, at + 24)
            at += 24 + 8 * size
            found[str(camera_id)] = colmap_camera(f"{path}: camera {camera_id}", NAMES[model], list(values), extent)
    except struct.error:
        raise InputError(f"{path}: it ends too early; give COLMAP's cameras.bin, whole") from None
    if at != len(data):
        raise InputError(f"{path}: {len(data) - at} bytes too many; give COLMAP's cameras.bin, unchanged")
    return found


def colmap_camera(where: str, model: str, values: list[float], size: Any) -> Camera:
    """The camera of a model with COLMAP's parameters in COLMAP's order, and an image of a width and height."""
    with prefix_errors(where):
        if model in COUNTS and len(values) != COUNTS[model]:
            raise InputError(f"camera: {len(values)} parameters given, and {model} has {COUNTS[model]}; give that many")
        if not all(math.isfinite(value) for value in values):
            raise InputError("camera: a parameter is NaN or infinite; give finite ones")
        focals = 1 if model in COUNTS and (model.startswith("SIMPLE") or "RADIAL" in model) else 2
        if model not in COUNTS:
            focals = len(colmap_parameters(model)[0])
        if len(values) < focals + 2:
            raise InputError(
                f"camera: {len(values)} parameters of {model} given; give focal length, centre and the rest"
            )
        fx, fy = values[0], values[focals - 1]
        cx, cy, *rest = values[focals:]
        return Camera(fx, fy, cx, cy, _lens(model, rest), size=size)


def _lens(model: str, rest: list[float]) -> Lens | None:
    if model not in COUNTS:
        return Colmap(model, tuple(rest))
    if "FISHEYE" in model:
        return KannalaBrandt((*rest, *(0.0,) * (4 - len(rest))))
    if not any(rest):
        return None
    return Brown((*rest, *(0.0,) * max(0, 4 - len(rest))))
