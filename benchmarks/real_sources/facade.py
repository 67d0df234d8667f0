"""Three photographs of a façade: a snapshot of mapillary/OpenSfM, ``data/berlin``.

Read are the repository's own ``reconstruction_example.json`` (camera, poses, points), ``tracks_example.csv`` (second
format: image, track, feature, x, y, …; x and y from the centre, over the larger side) and ``images/*.jpg``, in whose
line segments the vertical is measured. Pixels are at a third of the photographs' size and without distortion.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from real_sources.common import Fields, data_set, folder_with, opencv, photograph, project
from rootmatch.arrays import Floats
from rootmatch.errors import InputError

REDUCED = 3
"""Factor by which photographs are made smaller."""
WORST = 2.0
"""Pixels by which a track may miss its point, at the reduced size."""
STEEPEST = np.radians(30.0)
"""Maximum lean of segments of vertical edges in the image."""
SHORTEST = 25.0
"""Pixels of a segment, at the reduced size."""
TOWARDS = np.radians(1.0)
"""Between a segment and the direction to the vanishing point, where it is one of a vertical edge."""
TRIES = 2000


def convert(snapshot: Path) -> Fields:
    """Fields of ``berlin_facade``, of the repository's own reconstruction."""
    root = folder_with(snapshot, "reconstruction_example.json", "tracks_example.csv")
    (known, *_) = json.loads((root / "reconstruction_example.json").read_text(encoding="utf-8"))
    (camera,) = known["cameras"].values()
    names, rows = sorted(known["shots"]), {name: number for number, name in enumerate(known["points"])}
    points = np.array([point["coordinates"] for point in known["points"].values()])
    width, height = camera["width"] // REDUCED, camera["height"] // REDUCED
    focal = camera["focal"] * max(width, height)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    R = np.array([Rotation.from_rotvec(known["shots"][name]["rotation"]).as_matrix() for name in names])
    t = np.array([known["shots"][name]["translation"] for name in names])
    image = np.full((len(names), len(points), 2), np.nan)
    for name, track, x, y in _tracks(root / "tracks_example.csv"):
        if name in names and track in rows:
            ray = _undistorted(np.array([x, y]) / camera["focal"], camera["k1"], camera["k2"])
            image[names.index(name), rows[track]] = focal * ray + K[:2, 2]
    for view in range(len(names)):
        predicted = project(points, R[view], t[view], K)
        image[view, np.linalg.norm(predicted - image[view], axis=1) > WORST] = np.nan
    twice = np.isfinite(image[:, :, 0]).sum(axis=0) >= 2
    points, image = points[twice], image[:, twice]
    measured = np.array([vertical(root / "images" / name, K, (width, height)) for name in names])
    down = (R.transpose(0, 2, 1) @ measured[:, :, None])[:, :, 0].mean(axis=0)
    down /= np.linalg.norm(down)
    return data_set(
        points, image, (width, height), names, K=[K] * len(names), R=R, t=t,
        gravity_world=down, gravity_cam=R @ down, gravity_cam_measured=measured,
    )  # fmt: skip


def _tracks(path: Path) -> list[tuple[str, str, float, float]]:
    """Image, track, x and y of every row."""
    first, *lines = path.read_text(encoding="utf-8").splitlines()
    if not first.startswith("OPENSFM_TRACKS_VERSION_v2"):
        raise InputError(f"snapshot: {path} begins with {first[:40]!r}, not with OPENSFM_TRACKS_VERSION_v2")
    rows = [line.split("\t") for line in lines if line]
    return [(row[0], row[1], float(row[3]), float(row[4])) for row in rows]


def _undistorted(seen: Floats, k1: float, k2: float) -> Floats:
    """Where a ray would be without the lens, by iteration: the coefficients are hundredths."""
    ray = seen
    for _ in range(20):
        square = ray @ ray
        ray = seen / (1.0 + square * (k1 + square * k2))
    return ray


def vertical(path: Path, K: Floats, size: tuple[int, int]) -> Floats:
    """Unit *down* in a camera, from the vanishing point of a photograph's steep line segments."""
    cv2 = opencv()
    segments = _steep_segments(cv2.resize(photograph(path), size, interpolation=cv2.INTER_AREA), cv2)
    if len(segments) < 2:
        raise InputError(f"snapshot: {path} shows no vertical edges")
    inverse = np.linalg.inv(K)
    ends = [np.column_stack([end, np.ones(len(end))]) @ inverse.T for end in (segments[:, :2], segments[:, 2:])]
    planes, along = np.cross(*ends), ends[1] - ends[0]
    middle, length = 0.5 * (ends[0] + ends[1]), np.linalg.norm(along, axis=1)
    rng = np.random.default_rng(0)
    best, maximum = np.zeros(len(planes), np.bool_), 0.0
    for _ in range(TRIES):
        one, two = rng.choice(len(planes), 2, replace=False)
        point = np.cross(planes[one], planes[two])
        inside = _towards(point, middle, along) < TOWARDS
        if length[inside].sum() > maximum:
            best, maximum = inside, length[inside].sum()
    # the direction nearest to all planes, each by its segment's length
    normals = planes[best] / np.linalg.norm(planes[best], axis=1, keepdims=True) * length[best, None]
    down = np.linalg.svd(normals)[2][-1]
    return np.asarray(down * np.sign(down[1]))


def _towards(point: Floats, middle: Floats, along: Floats) -> Floats:
    """Angles between segments (of the plane z = 1) and the directions from their middles to a vanishing point."""
    direction = point[:2] - point[2] * middle[:, :2]
    cross = direction[:, 0] * along[:, 1] - direction[:, 1] * along[:, 0]
    norm = np.linalg.norm(direction, axis=1) * np.linalg.norm(along[:, :2], axis=1)
    return np.asarray(np.arcsin(np.minimum(np.abs(cross) / np.maximum(norm, 1e-12), 1.0)))


def _steep_segments(image: Any, cv2: Any) -> Floats:
    """Ends (m, 4) of the long line segments that lean little."""
    found = cv2.createLineSegmentDetector().detect(image)[0]
    if found is None:
        return np.empty((0, 4))
    segments = found.reshape(-1, 4).astype(float)
    along = segments[:, 2:] - segments[:, :2]
    steep = np.abs(along[:, 0]) < np.tan(STEEPEST) * np.abs(along[:, 1])
    return np.asarray(segments[steep & (np.linalg.norm(along, axis=1) > SHORTEST)])
