"""Matches as a model of COLMAP: cameras, images with their poses, and points with their tracks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.io import write_folder_atomically

if TYPE_CHECKING:
    from rootmatch.result import Match


def write_colmap(
    folder: Path | str,
    images: Mapping[str, Match],
    *,
    ids: ArrayLike | None = None,
    size: tuple[int, int] | None = None,
    opencv_pixels: bool = False,
) -> None:
    """Write ``cameras.txt``, ``images.txt`` and ``points3D.txt``, which COLMAP and pycolmap read as a model.

    Parameters
    ----------
    folder : path
        Files of these names in it are replaced.
    images : mapping
        From the name of each image to its match, all of the same points in space.
    ids : (n,) array of int, optional
        COLMAP's ids of the points, 0 or more; by default 1 to n. Points that no image shows have an empty track.
    size : two ints, optional
        Width and height of the images in pixels; by default those of the camera, or twice the principal point.
    opencv_pixels : bool
        Whether camera and detections count the centre of the upper left pixel as (0, 0), as OpenCV does; COLMAP counts
        it as (0.5, 0.5), and half a pixel is then added.

    Raises
    ------
    InputError
        If an image has no pose, a camera none of COLMAP's models, or a file cannot be written.
    """
    points, known = _common_points(images, ids)
    shift = 0.5 if opencv_pixels else 0.0
    cameras: dict[CameraModel, int] = {}
    tracks: list[list[str]] = [[] for _ in known]
    lines = []
    for number, (name, match) in enumerate(images.items(), start=1):
        if not name or len(name.split()) != 1:
            raise InputError(f"{name!r}: not a name of an image; COLMAP takes names without spaces")
        pose = match.pose
        if pose is None:
            raise InputError(f"{name}: its match has no pose; leave it out")
        camera = cameras.setdefault(match.problem.camera, len(cameras) + 1)  # type: ignore[attr-defined]
        owner = np.full(len(match.target), -1, np.int64)
        owner[match.pairs[:, 1]] = match.pairs[:, 0]
        for at, i in enumerate(owner.tolist()):
            if i >= 0:
                tracks[i].append(f"{number} {at}")
        numbers = " ".join(map(repr, [*pose.quaternion_wxyz.tolist(), *pose.t.tolist()]))
        lines.append(f"{number} {numbers} {camera} {name}")
        shown = zip((match.target + shift).tolist(), owner.tolist(), strict=True)
        lines.append(" ".join(f"{x!r} {y!r} {known[i] if i >= 0 else -1}" for (x, y), i in shown))
    rows = zip(known, points.tolist(), tracks, strict=True)
    texts = {
        "cameras.txt": [f"{k} {_camera_line(camera, size, shift)}" for camera, k in cameras.items()],
        "images.txt": lines,
        "points3D.txt": [
            " ".join([str(one), *map(repr, x), "255 255 255", "0" if track else "-1", *track]) for one, x, track in rows
        ],
    }
    with write_folder_atomically(Path(folder), force=True) as temporary:
        for file, content in texts.items():
            (temporary / file).write_text("\n".join(content) + "\n", encoding="utf-8")


def _common_points(images: Mapping[str, Match], ids: ArrayLike | None) -> tuple[NDArray[np.float64], list[int]]:
    """Points in space and their ids, alike for all images."""
    if not images:
        raise InputError("images: none given; give a match for each image name")
    points = next(iter(images.values())).source
    for name, match in images.items():
        if match.problem.source_dimension != 3 or not hasattr(match.problem, "camera"):
            raise InputError(f"{name}: {match.problem.name} has no image of points in space; give one of P3P or UP2P")
        if not np.array_equal(match.source, points):
            raise InputError(
                f"{name}: its points in space differ from those of the first image; write a model for each"
            )
    known = np.arange(1, len(points) + 1) if ids is None else np.asarray(ids)
    if known.shape != (len(points),) or known.dtype.kind not in "iu" or len(set(known.tolist())) < len(points):
        raise InputError(f"ids: {known.dtype} of shape {known.shape} given; give {len(points)} different whole numbers")
    if known.min() < 0:
        raise InputError(f"ids: {known.min()} given; give numbers of 0 or more")
    return points, known.tolist()


def _camera_line(camera: CameraModel, size: tuple[int, int] | None, shift: float) -> str:
    """A camera as COLMAP has it: model, width, height and parameters."""
    if not isinstance(camera, Camera):
        raise InputError(f"camera: {type(camera).__name__} given, which COLMAP does not have; give a Camera")
    width, height = (max(1, round(one)) for one in size or camera.size or (2.0 * camera.cx, 2.0 * camera.cy))
    values = () if camera.lens is None else getattr(camera.lens, "values", ())
    model = "PINHOLE"
    if isinstance(camera.lens, KannalaBrandt):
        model = "OPENCV_FISHEYE"
    elif isinstance(camera.lens, Brown):
        if any(values[8:]):
            raise InputError("camera: a lens with a thin prism or a tilt, which COLMAP lacks; calibrate without them")
        full = any(values[4:8])
        model = "FULL_OPENCV" if full else "OPENCV"
        values = (*values, *(0.0,) * 8)[: 8 if full else 4]
    elif camera.lens is not None:
        raise InputError("camera: a lens of pycolmap's own; keep the cameras.txt that it came from")
    numbers = [camera.fx, camera.fy, camera.cx + shift, camera.cy + shift, *values]
    return " ".join([model, str(int(width)), str(int(height)), *map(repr, numbers)])
