"""Dots of a calibration target behind glass and water: a snapshot of OpenPTV/test_cavity.

Read are ``cal/target_on_a_side.txt`` (id and position of the dots in mm), ``parameters/ptv.par`` (image size, pixel
size, refractive indices) and of each camera ``cal/camN.tif_targets`` (blobs) and ``cal/camN.tif.ori`` (its calibrated
orientation). The orientation, with refraction at the glass, tells which blob is which dot; an effective pinhole camera
is then fitted to these.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from real_sources.common import Fields, data_set, folder_with, known_pose, project, table
from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError

CAMERAS = 4
MIN_AREA = 9
"""Pixels of a blob: the thousands of smaller ones are noise of the sensor."""
FARTHEST = 40.0
"""Pixels by which the calibrated orientations miss the dots at most; dots are 50 px apart."""
TOGETHER = 5.0
"""Pixels within which the orientations miss all dots of a camera alike."""
NEAR = 3.0
"""Pixels within which a blob is a dot, after the fit."""
ROUNDS = 4
"""Fits, each to the blobs that the one before it identified."""
MIN_DOTS = 20
"""Dots of a camera from which an effective pinhole can be fitted."""


def convert(snapshot: Path) -> Fields:
    """Fields of ``openptv_cavity_target``."""
    root = folder_with(snapshot, "cal/target_on_a_side.txt", "parameters/ptv.par")
    dots = table(root / "cal/target_on_a_side.txt", 4)
    words = (root / "parameters/ptv.par").read_text(encoding="utf-8").split()
    *_, width, height, pixel, _, _, air, glass, water, thickness = map(float, words[-9:])
    media = (air, glass, water, thickness)
    images, clutter, areas, views = [], [], [], []
    cameras = []
    for view in range(CAMERAS):
        orientation = np.array((root / f"cal/cam{view + 1}.tif.ori").read_text(encoding="utf-8").split(), float)
        blobs = table_of_blobs(root / f"cal/cam{view + 1}.tif_targets")
        expected = through_glass(dots[:, 1:], orientation, media)
        expected = expected / pixel * (1.0, -1.0) + (width / 2.0, height / 2.0)
        focal = orientation[17] / pixel * water / air  # refraction magnifies
        rough = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
        dot, blob, camera = identified(dots[:, 1:], expected, blobs[:, :2], rough)
        image = np.full((len(dots), 2), np.nan)
        image[dot] = blobs[blob, :2]
        rest = np.setdiff1d(np.arange(len(blobs)), blob)
        images.append(image)
        clutter.append(blobs[rest, :2])
        areas.append(blobs[rest, 2])
        views.append(np.full(len(rest), view))
        cameras.append(camera)
    names = [f"cam{view + 1}" for view in range(CAMERAS)]
    K, R, t = (np.array(part) for part in zip(*cameras, strict=True))
    return data_set(
        dots[:, 1:], np.array(images), (int(width), int(height)), names, K=K, R=R, t=t,
        point_id=dots[:, 0].astype(np.int64), clutter2d=np.concatenate(clutter),
        clutter_view=np.concatenate(views), clutter_area=np.concatenate(areas),
    )  # fmt: skip


def table_of_blobs(path: Path) -> Floats:
    """Position and area of the blobs of a ``_targets`` file, (m, 3); its first line is their number."""
    lines = path.read_text(encoding="utf-8").splitlines()
    blobs = np.array([[float(word) for word in line.split()[1:4]] for line in lines[1:] if line.strip()])
    return blobs[blobs[:, 2] >= MIN_AREA]


def through_glass(points: Floats, orientation: Floats, media: tuple[float, float, float, float]) -> Floats:
    """Where points (n, 3) in water appear, (n, 2) in mm on the sensor, y up.

    ``orientation`` holds the camera's centre, three angles, its rotation (3, 3) from camera to world, the principal
    point, the focal length and the vector from the origin to the glass.
    """
    centre, rotation, principal = orientation[:3], orientation[6:15].reshape(3, 3), orientation[15:17]
    focal, wall = orientation[17], orientation[18:21]
    air, glass, water, thickness = media
    reach = np.linalg.norm(wall)
    normal = wall / reach
    before, behind = centre @ normal - reach, reach - points @ normal - thickness
    across = points - centre - np.outer((points - centre) @ normal, normal)
    distance = np.linalg.norm(across, axis=1)
    low, high = np.zeros(len(points)), np.ones(len(points))  # sine of the angle in air: the distance increases with it
    for _ in range(60):
        sine = 0.5 * (low + high)
        reached = sum(
            depth * s / np.sqrt(1.0 - s * s)
            for depth, s in ((before, sine), (thickness, sine * air / glass), (behind, sine * air / water))
        )
        low, high = np.where(reached < distance, sine, low), np.where(reached < distance, high, sine)
    ray = across / np.maximum(distance, 1e-12)[:, None] * low[:, None] - np.outer(np.sqrt(1.0 - low**2), normal)
    seen = ray @ rotation
    return np.asarray(-focal * seen[:, :2] / seen[:, 2:] + principal)


def identified(
    dots: Floats, expected: Floats, blobs: Floats, K: Floats
) -> tuple[Integers, Integers, tuple[Floats, Floats, Floats]]:
    """Which dot is which blob (two index arrays), and the effective pinhole camera K, R, t.

    ``expected`` (n, 2) holds roughly where the dots are, K rough intrinsics.
    """
    tree = cKDTree(blobs)
    shift = np.concatenate([blobs[tree.query_ball_point(one, FARTHEST)] - one for one in expected])
    if not len(shift):
        raise InputError("snapshot: no blob is where the calibrated orientation has a dot")
    maximum = cKDTree(shift).query_ball_point(shift, TOGETHER, return_length=True).argmax()
    predicted, within, camera = expected + shift[maximum], 2.0 * TOGETHER, (K, np.eye(3), np.zeros(3))
    for _ in range(ROUNDS):
        distance, blob = tree.query(predicted)
        dot = np.flatnonzero(distance < within)
        dot = dot[[int((blob[dot] == blob[one]).sum()) == 1 for one in dot]]
        if len(dot) < MIN_DOTS:
            raise InputError(f"snapshot: {len(dot)} blobs are where the calibrated orientation has dots, too few")
        camera = effective_pinhole(dots[dot], blobs[blob[dot]], K)
        predicted, within = project(dots, camera[1], camera[2], camera[0]), NEAR
    return dot, blob[dot], camera


def effective_pinhole(points: Floats, pixels: Floats, K: Floats) -> tuple[Floats, Floats, Floats]:
    """K (square pixels), R and t that fit best in pixels, starting from a K that is roughly right."""
    R, t, _ = known_pose(points, pixels, K)

    def camera(values: Floats) -> tuple[Floats, Floats, Floats]:
        f, cx, cy = values[:3]
        return np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]), Rotation.from_rotvec(values[3:6]).as_matrix(), values[6:]

    def miss(values: Floats) -> Floats:
        K, R, t = camera(values)
        return np.asarray((project(points, R, t, K) - pixels).ravel())

    first = np.array([K[0, 0], K[0, 2], K[1, 2], *Rotation.from_matrix(R).as_rotvec(), *t])
    return camera(least_squares(miss, first, x_scale="jac").x)
