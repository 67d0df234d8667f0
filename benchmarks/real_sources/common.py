"""Functions of all converters: files of a snapshot, OpenCV, poses of known correspondences, fields of a data set."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats
from rootmatch.errors import InputError

Fields = dict[str, NDArray[Any]]


def folder_with(snapshot: Path, *names: str) -> Path:
    """The first folder of a snapshot, in alphabetical order, that holds all these files."""
    for first in sorted(snapshot.rglob(Path(names[0]).name)):
        folder = first.parents[len(Path(names[0]).parts) - 1]
        if all((folder / name).is_file() for name in names):
            return folder
    raise InputError(f"snapshot: no folder of {snapshot} holds {', '.join(names)}")


def table(path: Path, columns: int) -> Floats:
    """The leading columns of a text file of numbers, (rows, columns)."""
    rows = [line.replace(",", " ").split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    try:
        return np.array([[float(word) for word in row[:columns]] for row in rows]).reshape(len(rows), columns)
    except ValueError:
        raise InputError(f"snapshot: {path} is not a table of {columns} numbers or more a row") from None


def opencv() -> Any:
    """OpenCV, which calibrates and fits poses independently of this library."""
    try:
        import cv2
    except ImportError:
        raise InputError("snapshot: OpenCV is needed; pip install opencv-python-headless") from None
    return cv2


def photograph(path: Path) -> Any:
    """A photograph in shades of grey, by OpenCV; an `InputError` if there is none in the file."""
    cv2 = opencv()
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(f"snapshot: {path} cannot be read as an image")
    return image


def opencv_errors() -> tuple[type[Exception], ...]:
    """The exceptions of OpenCV, if it was imported."""
    return (sys.modules["cv2"].error,) if "cv2" in sys.modules else ()


def known_pose(points: Floats, pixels: Floats, K: Floats) -> tuple[Floats, Floats, float]:
    """Pose of known correspondences by OpenCV, and the RMS distance of the pixels from their predictions."""
    cv2 = opencv()
    _, turn, t = cv2.solvePnP(points, pixels, K, None, flags=cv2.SOLVEPNP_SQPNP)
    turn, t = cv2.solvePnPRefineLM(points, pixels, K, None, rvec=turn, tvec=t)
    return cv2.Rodrigues(turn)[0], t.ravel(), rms(cv2.projectPoints(points, turn, t, K, None)[0].reshape(-1, 2), pixels)


def rms(predicted: Floats, measured: Floats) -> float:
    """Root mean square distance in pixels, of the points that are visible."""
    return float(np.sqrt(np.nanmean(np.sum((predicted - measured) ** 2, axis=1))))


def project(points: Floats, R: Floats, t: Floats, K: Floats) -> Floats:
    """Pixels (n, 2) of a pinhole camera."""
    seen = (points @ R.T + t) @ K.T
    return seen[:, :2] / seen[:, 2:]


def data_set(points: Floats, pixels: Floats, size: tuple[int, int], names: list[str], **more: Any) -> Fields:
    """The fields that every data set has, and its own; the RMS of each view follows from K, R and t if not given."""
    views = len(pixels)
    if not more.keys() & {"rms", "rms_px"}:
        poses = zip(more["R"], more["t"], more["K"], pixels, strict=True)
        more["rms_px"] = [rms(project(points, R, t, K), seen) for R, t, K, seen in poses]
    return {
        "points3d": points,
        "points2d": pixels,
        "image_size": np.tile(np.array(size), (views, 1)),
        "view_names": np.array(names),
        "labels": np.zeros(len(points), np.int64),
        **{name: np.asarray(value) for name, value in more.items()},
    }
