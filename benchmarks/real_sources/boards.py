"""A chessboard in front of two fixed cameras: OpenCV's samples, as in Debian's package ``opencv-doc``.

Read are the photographs ``left01.jpg`` … and ``right01.jpg`` …, of which both exist. OpenCV detects the inner corners,
calibrates each camera and removes the distortion. Points are in units of a square, from the board's centre.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from real_sources.common import Fields, data_set, folder_with, opencv, photograph
from rootmatch.arrays import Floats
from rootmatch.errors import InputError

COLUMNS, ROWS = 9, 6
"""Inner corners of the board."""
HALF_WINDOW = 5
"""Pixels about a corner that its refinement looks at."""


def convert(snapshot: Path) -> Fields:
    """Fields of ``opencv_chessboard_stereo``."""
    cv2 = opencv()
    root = folder_with(snapshot, "left01.jpg", "right01.jpg")
    both = [path.stem[4:] for path in sorted(root.glob("left*.jpg")) if (root / f"right{path.stem[4:]}.jpg").is_file()]
    both = [number for number in both if number.isdigit()]
    row, column = np.divmod(np.arange(COLUMNS * ROWS), COLUMNS)
    points = np.column_stack([column - 0.5 * (COLUMNS - 1), row - 0.5 * (ROWS - 1), np.zeros(len(row))])
    views: list[dict[str, Any]] = []
    for camera, side in enumerate(("left", "right")):
        images = [photograph(root / f"{side}{number}.jpg") for number in both]
        size = images[0].shape[::-1]
        corners = [_corners(cv2, image, side) for image in images]
        boards = [points.astype(np.float32)] * len(corners)
        _, K, dist, turns, moves = cv2.calibrateCamera(boards, corners, size, None, None)
        for number, found, turn, move in zip(both, corners, turns, moves, strict=True):
            pixels = cv2.undistortPoints(found[:, None], K, dist, P=K).reshape(-1, 2).astype(float)
            R, t = cv2.Rodrigues(turn)[0], move.ravel()
            views.append(
                {"name": f"{side}{number}", "image": pixels, "K": K, "R": R, "t": t, "size": size, "camera": camera,
                 "frame": int(number)}
            )  # fmt: skip
    views.sort(key=lambda view: (view["frame"], view["camera"]))
    get = {key: [view[key] for view in views] for key in views[0]}
    return data_set(
        points, np.array(get["image"]), get["size"][0], get["name"], K=get["K"], R=get["R"], t=get["t"],
        camera_id=get["camera"], frame_id=get["frame"],
    )  # fmt: skip


def _corners(cv2: Any, image: Any, side: str) -> Floats:
    found, corners = cv2.findChessboardCorners(image, (COLUMNS, ROWS))
    if not found:
        raise InputError(f"snapshot: a photograph {side}… shows no board of {COLUMNS} × {ROWS} inner corners")
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    window = (HALF_WINDOW, HALF_WINDOW)
    return np.asarray(cv2.cornerSubPix(image, corners, window, (-1, -1), stop)).reshape(-1, 2)
