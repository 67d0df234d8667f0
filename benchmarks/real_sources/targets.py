"""Retro-reflective targets: a snapshot of applied-geodesy/bundle-adjustment, ``JAICOV/example``.

Read are ``example.obc`` (id and adjusted position of each target in mm), ``example.phc`` (image, id, x, y in mm on the
sensor, y up) and ``example.ior`` (a principal distance to start from; size of the sensor in mm and pixels). Every
second image is taken that shows a dozen targets or more; OpenCV calibrates the camera anew from them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from real_sources.common import Fields, data_set, folder_with, opencv, rms, table

MINIMUM = 12
"""Targets of an image."""


def convert(snapshot: Path) -> Fields:
    """Fields of ``aicon_targets``; here pixels are raw and ``dist`` holds the lens."""
    cv2 = opencv()
    root = folder_with(snapshot, "example.obc", "example.phc", "example.ior")
    objects, measured = table(root / "example.obc", 4), table(root / "example.phc", 4)
    inner = [float(word) for word in (root / "example.ior").read_text(encoding="utf-8").split()]
    sensor, width, height = inner[-4], int(inner[-2]), int(inner[-1])
    pitch = sensor / width
    row = {int(name): number for number, name in enumerate(objects[:, 0])}
    numbers = np.unique(measured[:, 0])[::2]
    image = np.full((len(numbers), len(objects), 2), np.nan)
    for view, number in enumerate(numbers):
        for _, name, x, y in measured[measured[:, 0] == number]:
            if int(name) in row:
                image[view, row[int(name)]] = x / pitch + 0.5 * (width - 1), 0.5 * (height - 1) - y / pitch
    enough = np.isfinite(image[:, :, 0]).sum(axis=1) >= MINIMUM
    image, numbers = image[enough], numbers[enough]
    points = objects[:, 1:].copy()
    seen = np.isfinite(image).all(axis=2)
    focal = abs(inner[2]) / pitch
    start = np.array([[focal, 0, 0.5 * (width - 1)], [0, focal, 0.5 * (height - 1)], [0, 0, 1.0]])
    _, K, dist, turns, t = cv2.calibrateCamera(
        [points[one].astype(np.float32) for one in seen],
        [pixels[one].astype(np.float32) for pixels, one in zip(image, seen, strict=True)],
        (width, height), start, None, flags=cv2.CALIB_USE_INTRINSIC_GUESS,
    )  # fmt: skip
    errors = [
        rms(cv2.projectPoints(points, turn, move, K, dist)[0].reshape(-1, 2), pixels)
        for turn, move, pixels in zip(turns, t, image, strict=True)
    ]
    names = [f"image{number:.0f}" for number in numbers]
    fields = data_set(
        points, image, (width, height), names, K=[K] * len(image), dist=dist.ravel(),
        R=[cv2.Rodrigues(turn)[0] for turn in turns], t=[move.ravel() for move in t], rms=errors,
        ids=objects[:, 0].astype(np.int64),
    )  # fmt: skip
    return fields | {"size": np.array([width, height])}
