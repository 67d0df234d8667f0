"""ROS ``camera_info``: the YAML of camera_calibration, and messages as ``rostopic echo`` or ``ros2 topic echo`` do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError, quote_value
from rootmatch.io.calibrations.distortion import coefficients, refuse_unread
from rootmatch.io.calibrations.values import IMAGE_SIZE, prefix_errors, read_3x3, with_image_size

COUNTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4, "fisheye": 4}
"""Coefficients of each distortion model."""


def is_ros(content: dict[str, Any]) -> bool:
    """Whether it has the entry that names a distortion model, and one of the matrices."""
    return "distortion_model" in content and any(name in content for name in ("camera_matrix", "K", "k"))


def read_ros(path: Path, content: dict[str, Any]) -> dict[str, Camera]:
    """The camera of one file, by its ``camera_name``, else ``camera``."""
    model = content["distortion_model"]
    if model not in ("", "none", *COUNTS):
        raise InputError(f"{path}: distortion_model is {quote_value(model)}; give one of {', '.join(COUNTS)}")
    name = next(name for name in ("camera_matrix", "K", "k") if name in content)
    K = read_3x3(path, name, content[name])
    dist, values = coefficients(path, content)
    refuse_unread(path, content)
    if model in COUNTS and values and len(values) != COUNTS[model]:
        raise InputError(f"{path}: {dist} has {len(values)} numbers, and {model} has {COUNTS[model]}; give that many")
    with prefix_errors(path):
        fisheye = model in ("equidistant", "fisheye")
        camera = Camera.from_opencv_fisheye(K, values) if fisheye else Camera.from_opencv(K, values)
        # as files and as messages have it
        camera = with_image_size(with_image_size(camera, content, ("width", "height")), content, IMAGE_SIZE)
    return {str(content.get("camera_name") or "camera")[:80]: camera}
