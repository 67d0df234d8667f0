"""Our own camera files (JSON): a camera or several by name, with the lens."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.colmap import Colmap
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.errors import InputError, quote_value
from rootmatch.io.calibrations.distortion import COEFFICIENTS, coefficients, is_fisheye, normalise_name, refuse_unread
from rootmatch.io.calibrations.values import prefix_errors, read_3x3, read_numbers, with_image_size
from rootmatch.problems.derived.measurements import Bearings

NUMBERS = ("fx", "fy", "cx", "cy")
DIRECTIONS = ("vertical_camera", "vertical_world", "axis", "axis2")
SIZE = ("width", "height")
NOISE, POSE_NOISE = ("focal_noise", "centre_noise"), ("rotation_noise", "position_noise")
LOOSE = ("K", *NUMBERS, *SIZE)
"""Keys that others may look like, so short or common are they."""
EXAMPLE = '{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240}'


def parse_cameras(path: Path, content: dict[str, Any]) -> dict[str, CameraModel]:
    """Cameras of our JSON: those of ``cameras`` by name, or ``camera`` and ``camera2``."""
    if "cameras" in content:
        named = content["cameras"]
        if not isinstance(named, dict) or not named:
            raise InputError(f"{path}: cameras is {quote_value(named)}; give an object of cameras by name")
        return {str(name): camera_from_entry(path, entry, ()) for name, entry in named.items()}
    found = {"camera": camera_from_entry(path, content, ("camera2", *DIRECTIONS))}
    if content.get("camera2") is not None:
        found["camera2"] = camera_from_entry(path, content["camera2"], ())
    return found


def camera_from_entry(path: Path, content: Any, more: Sequence[str]) -> CameraModel:
    """The camera of a JSON object; ``more`` lists its other known keys."""
    if not isinstance(content, dict):
        raise InputError(f"{path}: not a JSON object; give {EXAMPLE}")
    if content.get("bearings") is True:
        return Bearings()
    if "rig" in content:
        return _rig(path, content["rig"])
    known = (*NUMBERS, *SIZE, *NOISE, "K", "fisheye", "colmap", "bearings", "rig", "dist", *more)
    for key in content:
        near = difflib.get_close_matches(key[:40], [name for name in known if name not in LOOSE], n=1, cutoff=0.7)
        if near and key.lower() not in known and key not in known and normalise_name(key) not in COEFFICIENTS:
            raise InputError(
                f"{path}: {quote_value(key)} is unknown; did you mean {near[0]!r}? Rename it, or leave it out"
            )
    refuse_unread(path, content, {*COEFFICIENTS, *known})
    with prefix_errors(path):
        if "K" in content:
            pinhole = Camera.from_matrix(_square_matrix(path, content["K"]))
        else:
            missing = [name for name in NUMBERS if name not in content]
            if missing:
                raise InputError(f"{missing[0]} is missing; give fx, fy, cx and cy in pixels, or the matrix K")
            pinhole = Camera(*(content[name] for name in NUMBERS))
        pinhole = replace(pinhole, **{name: content[name] for name in NOISE if name in content})
        return with_image_size(_attach_lens(path, pinhole, content), content, SIZE)


def _rig(path: Path, views: Any) -> Rig:
    """The rig of a JSON list of cameras, each with R and t, and perhaps with the width and height of its image."""
    if not isinstance(views, list) or not all(isinstance(view, dict) for view in views):
        raise InputError(f"{path}: rig is {quote_value(views)}; give a list of cameras with R and t")
    cameras = []
    for k, view in enumerate(views):
        for key, count in (("R", 9), ("t", 3)):
            if key not in view or len(read_numbers(path, f"{key} of camera {k}", view[key])) != count:
                raise InputError(f"{path}: rig: {key} of camera {k} is missing, or does not have {count} numbers")
        if "rig" in view:
            raise InputError(f"{path}: rig: camera {k} is a rig itself; give cameras")
        rest = {key: value for key, value in view.items() if key not in ("R", "t", *SIZE, *POSE_NOISE)}
        place = read_3x3(path, "R", view["R"]), read_numbers(path, "t", view["t"])
        cameras.append((camera_from_entry(path, rest, ()), *place))
    sizes = [[view[key] for key in SIZE if key in view] for view in views]
    noise = {name: [view.get(name, 0.0) for view in views] for name in POSE_NOISE}
    with prefix_errors(path):
        return Rig(cameras, sizes if any(sizes) else None, **noise)


def _square_matrix(path: Path, value: Any) -> list[list[float]]:
    """A matrix (3, 3) from nested lists."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InputError("K is not a matrix of numbers; give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]") from None
    if array.shape != (3, 3):
        raise InputError(f"camera matrix: shape {array.shape} given, (3, 3) expected")
    return read_3x3(path, "K", value)


def _attach_lens(path: Path, pinhole: Camera, content: dict[str, Any]) -> Camera:
    """The camera with the lens that a JSON object describes."""
    name, values = coefficients(path, content)
    if content.get("colmap") is not None:
        return replace(pinhole, lens=Colmap(str(content["colmap"])[:40], tuple(values)))
    if content.get("fisheye") is not None:
        if values:
            raise InputError(f"fisheye and {name} given; a camera has one lens: leave one of them out")
        return replace(pinhole, lens=KannalaBrandt(tuple(read_numbers(path, "fisheye", content["fisheye"]))))
    if len(values) == 0:
        return pinhole
    if is_fisheye(path, content):
        return replace(pinhole, lens=KannalaBrandt(tuple(values)))
    lens = Brown(tuple(values))
    return replace(pinhole, lens=lens) if any(lens.values) else pinhole


def camera_entry(camera: CameraModel) -> dict[str, Any]:
    """A camera as a JSON object."""
    if isinstance(camera, UnitRays):
        return {"bearings": True}
    if isinstance(camera, Rig):
        entries = [camera_entry(own) | {"R": list(map(list, R)), "t": list(t)} for own, R, t in camera.views]
        for one, size in zip(entries, camera.sizes or (), strict=False):
            one |= dict(zip(SIZE, size, strict=True))
        for one, *noise in zip(entries, camera.rotation_noise, camera.position_noise, strict=True):
            one |= {name: sigma for name, sigma in zip(POSE_NOISE, noise, strict=True) if sigma}
        return {"rig": entries}
    if not isinstance(camera, Camera):
        raise InputError(f"camera: {type(camera).__name__} given, which camera files do not hold; give a Camera")
    entry: dict[str, Any] = dict(zip((*NUMBERS, *SIZE), (*camera.numbers, *(camera.size or ())), strict=False))
    entry |= {name: sigma for name in NOISE if (sigma := getattr(camera, name))}
    if isinstance(camera.lens, KannalaBrandt):
        entry["fisheye"] = list(camera.lens.values)
    elif isinstance(camera.lens, Colmap):
        entry |= {"colmap": camera.lens.model, "dist": list(camera.lens.values)}
    elif isinstance(camera.lens, Brown):
        entry["dist"] = list(camera.lens.values)
    return entry
