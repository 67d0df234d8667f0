"""Proposed pairs of an object's points and pixels: a snapshot of danini/progressive-x, ``examples/img``.

Read are ``tless.txt`` (x, y, X, Y, Z of each pair), ``tless_poses.txt`` (twelve numbers an instance, [R | t] row by
row) and ``tless_intrinsics.txt`` (K).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from real_sources.common import Fields, folder_with, table


def convert(snapshot: Path) -> Fields:
    """Fields of ``tless_candidates``."""
    root = folder_with(snapshot, "tless.txt", "tless_poses.txt", "tless_intrinsics.txt")
    pairs, poses = table(root / "tless.txt", 5), table(root / "tless_poses.txt", 12).reshape(-1, 3, 4)
    pixels, target = np.unique(pairs[:, :2], axis=0, return_inverse=True)
    _, first, source = np.unique(pairs[:, 2:], axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # points in the order of the file
    return {
        "points3d": pairs[first[order], 2:],
        "points2d": pixels,
        "candidates": np.column_stack([np.argsort(order)[source.ravel()], target.ravel()]).astype(np.int64),
        "K": table(root / "tless_intrinsics.txt", 3),
        "R": poses[:, :, :3],
        "t": poses[:, :, 3],
    }
