"""Sensors of a headset as two lighthouses measured them: a snapshot of cntools/libsurvive, ``attic/dave``.

Read are ``HMD_points.csv`` and ``HMD_normals.csv`` (32 sensors, metres) and two recordings, ``ptinfo.csv`` and
``olddata/ptinfo.csv``: a row for each sensor, lighthouse and axis, the fifth column the mean angle in radians. A
lighthouse that has both angles of a sensor is a camera with pixels tan(angle) · 1000 + 1000.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from real_sources.common import Fields, data_set, folder_with, known_pose, table

FOCAL = 1000.0
LIGHTHOUSES = 2


def convert(snapshot: Path) -> Fields:
    """Fields of ``vive_hmd_lighthouse``."""
    root = folder_with(snapshot, "HMD_points.csv", "HMD_normals.csv", "ptinfo.csv", "olddata/ptinfo.csv")
    points, normals = table(root / "HMD_points.csv", 3), table(root / "HMD_normals.csv", 3)
    K = np.array([[FOCAL, 0, FOCAL], [0, FOCAL, FOCAL], [0, 0, 1.0]])
    images, poses, names = [], [], []
    for name, file in (("new", "ptinfo.csv"), ("old", "olddata/ptinfo.csv")):
        rows = table(root / file, 5)
        rows = rows[rows[:, 0] < len(points)]  # others are of the controllers
        for lighthouse in range(LIGHTHOUSES):
            image = np.full((len(points), 2), np.nan)
            mine = rows[rows[:, 1] == lighthouse]
            image[mine[:, 0].astype(int), mine[:, 2].astype(int)] = FOCAL * np.tan(mine[:, 4]) + FOCAL
            seen = np.isfinite(image).all(axis=1)
            image[~seen] = np.nan
            images.append(image)
            poses.append(known_pose(points[seen], image[seen], K))
            names.append(f"{name}_lighthouse{lighthouse}")
    R, t, rms = zip(*poses, strict=True)
    size = (int(2 * FOCAL), int(2 * FOCAL))
    return data_set(points, np.array(images), size, names, K=[K] * 4, R=R, t=t, rms_px=rms, normals3d=normals)
