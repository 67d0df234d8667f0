"""Tracks of a film: a snapshot of ceres-solver, ``data/libmv-ba-problems/problem_01.txt``.

One text file: f, cx, cy and five coefficients of the lens (zero here); cameras (frame, R column by column, t); points
(track, position); markers (frame, track, pixel). Sixteen frames are taken, evenly from the first to the last.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from real_sources.common import Fields, data_set, folder_with
from rootmatch.errors import InputError

FILE = "libmv-ba-problems/problem_01.txt"
FRAMES = 16
SIZE = (2048, 1080)


def convert(snapshot: Path) -> Fields:
    """Fields of ``tears_of_steel_01``."""
    path = folder_with(snapshot, FILE) / FILE
    numbers = np.array(path.read_text(encoding="utf-8").split(), dtype=float)
    (focal, cx, cy), lens, rest = numbers[:3], numbers[3:8], numbers[8:]
    if lens.any():
        raise InputError(f"snapshot: {path} has a lens with distortion; only problem_01 without one is known here")
    cameras, rest = _block(rest, 13)
    points, rest = _block(rest, 4)
    if rest[1] != 1.0:
        raise InputError(f"snapshot: markers of {path} are not in pixels")
    markers = rest[2:].reshape(int(rest[0]), 4)
    cameras = cameras[np.argsort(cameras[:, 0])]
    cameras = cameras[np.round(np.linspace(0, len(cameras) - 1, FRAMES)).astype(int)]
    R, t = cameras[:, 1:10].reshape(-1, 3, 3).transpose(0, 2, 1), cameras[:, 10:13]
    K = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1.0]])
    image = np.full((FRAMES, len(points), 2), np.nan)
    for view, frame in enumerate(cameras[:, 0]):
        for point, track in enumerate(points[:, 0]):
            found = markers[(markers[:, 0] == frame) & (markers[:, 1] == track)]
            if len(found):
                image[view, point] = found[0, 2:]
    frames = cameras[:, 0].astype(np.int64)
    return data_set(
        points[:, 1:], image, SIZE, [f"frame{frame}" for frame in frames], K=[K] * FRAMES, R=R, t=t,
        track_id=points[:, 0].astype(np.int64), frame_id=frames,
    )  # fmt: skip


def _block(numbers: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a list that begins with their number, and what follows it."""
    end = 1 + int(numbers[0]) * width
    return numbers[1:end].reshape(-1, width), numbers[end:]
