"""The protocols: which points of which data set, what a method is told, and what is true."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.errors import InputError, quote_value

Data = dict[str, NDArray[Any]]

DAMAGED = (OSError, ValueError, EOFError, RuntimeError, LookupError, MemoryError, zipfile.BadZipFile, zlib.error)
"""What NumPy and the modules below it raise for a file that is no .npz, or not whole."""
VERTICAL_NOISE = 0.005
"""Radians on each of two axes: measured verticals of the façade are 0.3 to 0.5 degrees off."""
MIN_VISIBLE = 15
"""Targets visible in a view of `targets`."""
NEAR_INSTANCE = 10.0
"""Pixels within which a proposed pair belongs to an instance of the object."""


@dataclass(frozen=True, eq=False)
class RealScene:
    """One scene: what a method is told, and what is kept from it."""

    protocol: str
    number: int
    """Together the scene's name."""
    request: dict[str, Any]
    """As JSON can hold it: ``source`` (n, 3|2), ``target`` (n', 2), ``problem`` ("p3p", "up2p", "3p1"), ``camera``
    (``fx fy cx cy`` and perhaps OpenCV's ``dist``), ``noise`` in pixels, and what else is known: ``normals``,
    ``vertical_camera``, ``vertical_world``, ``vertical_noise``, ``camera2``, ``axis``, ``axis2``, ``axis_noise``,
    ``candidates`` (pairs), ``motions``."""
    truth: Integers | None = None
    """(n,) index of each source point's target, −1 where it has none."""
    instances: list[Bools] | None = None
    """(m,) each; in place of ``truth``, for each instance of the object which of the candidates are
    images of it."""

    @property
    def name(self) -> str:
        """``protocol/number``."""
        return f"{self.protocol}/{self.number:02d}"


@dataclass(frozen=True)
class Protocol:
    """Scenes of one kind, always the same."""

    name: str
    file: str
    scenes: int
    make: Callable[[Data, int], RealScene | None]


def protocols() -> list[Protocol]:
    """All protocols, in the order of the table."""
    return [
        Protocol("headset-normals", "vive_hmd_lighthouse", 40, partial(headset, normals=True)),
        Protocol("headset", "vive_hmd_lighthouse", 20, partial(headset, normals=False)),
        Protocol("dots", "openptv_cavity_target", 20, dots),
        Protocol("film", "tears_of_steel_01", 16, film),
        Protocol("facade-upright", "berlin_facade", 15, partial(facade, measured=False)),
        Protocol("facade-measured", "berlin_facade", 15, partial(facade, measured=True)),
        Protocol("facade-pair", "berlin_facade", 15, facade_pair),
        Protocol("boards", "opencv_chessboard_stereo", 10, boards),
        Protocol("targets", "aicon_targets", 20, targets),
        Protocol("candidates", "tless_candidates", 1, candidates),
    ]


def all_scenes(folder: Path, only: list[str] | None = None) -> Iterator[RealScene]:
    """The scenes of the protocols named, or of all whose data are in the folder."""
    known = {protocol.name: protocol for protocol in protocols()}
    for name in only or []:
        if name not in known:
            raise InputError(f"protocol: {quote_value(name)} given; one of {', '.join(known)} expected")
    chosen = [known[name] for name in only] if only else list(known.values())
    if not folder.is_dir():
        raise InputError(f"data: {folder} is not a folder; give the one that holds the .npz files")
    if not only and not any((folder / f"{protocol.file}.npz").is_file() for protocol in chosen):
        raise InputError(f"data: {folder} holds none of {', '.join(sorted({p.file for p in chosen}))} (.npz)")
    for protocol in chosen:
        path = folder / f"{protocol.file}.npz"
        if not only and not path.is_file():
            continue
        data = _load_file(path)
        try:
            made = (protocol.make(data, number) for number in range(protocol.scenes))
            yield from (scene for scene in made if scene is not None)
        except (LookupError, ValueError, TypeError) as error:
            raise InputError(f"data: {path} does not hold what {protocol.name} needs ({quote_value(error)})") from None


def _load_file(path: Path) -> Data:
    try:
        with np.load(path, allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except DAMAGED as error:
        raise InputError(f"data: {path} cannot be read ({quote_value(error)}); fetch it again") from None


def headset(data: Data, number: int, *, normals: bool) -> RealScene:
    """All sensors of the headset against those visible in one of four views."""
    view, rng = number % 4, np.random.default_rng([number // 4, 9])
    source, target, truth, order = _shuffle(data["points3d"], data["points2d"][view], rng=rng)
    request = _request("p3p", source, target, noise=max(float(data["rms_px"][view]), 0.13), K=data["K"][view])
    if normals:
        request["normals"] = data["normals3d"][order].tolist()
    return RealScene("headset-normals" if normals else "headset", number, request, truth)


def dots(data: Data, number: int) -> RealScene:
    """Twenty dots of a view and forty of the false detections in it."""
    view, rng = number % 4, np.random.default_rng(number)
    image = data["points2d"][view].astype(float)
    chosen = rng.choice(np.flatnonzero(np.isfinite(image).all(axis=1)), 20, replace=False)
    clutter = data["clutter2d"][data["clutter_view"] == view]
    clutter = clutter[rng.choice(len(clutter), 40, replace=False)]
    source, target, truth, _ = _shuffle(data["points3d"][chosen], image[chosen], clutter, rng=rng)
    request = _request("p3p", source, target, noise=float(data["rms_px"][view]), K=data["K"][view])
    return RealScene("dots", number, request, truth)


def film(data: Data, number: int) -> RealScene:
    """All tracks against those of one frame."""
    view = number % len(data["points2d"])
    source, target, truth, _ = _shuffle(data["points3d"], data["points2d"][view], rng=np.random.default_rng(number))
    request = _request("p3p", source, target, noise=float(data["rms_px"][view]), K=data["K"][view])
    return RealScene("film", number, request, truth)


def facade(data: Data, number: int, *, measured: bool) -> RealScene:
    """Fifteen points of a view, and fifteen other features of it as clutter."""
    view, rng = number % 3, np.random.default_rng(number)
    image = data["points2d"][view].astype(float)
    chosen = rng.choice(np.flatnonzero(np.isfinite(image).all(axis=1)), 30, replace=False)
    source, target, truth, _ = _shuffle(data["points3d"][chosen[:15]], image[chosen[:15]], image[chosen[15:]], rng=rng)
    request = _request("up2p", source, target, noise=float(data["rms_px"][view]), K=data["K"][view]) | {
        "vertical_camera": data["gravity_cam_measured" if measured else "gravity_cam"][view].tolist(),
        "vertical_world": data["gravity_world"].tolist(),
        "vertical_noise": VERTICAL_NOISE if measured else 0.0,
    }
    return RealScene("facade-measured" if measured else "facade-upright", number, request, truth)


def facade_pair(data: Data, number: int) -> RealScene:
    """Twelve points visible in two of the three views."""
    first, second = [(0, 1), (1, 2), (0, 2)][number % 3]
    rng = np.random.default_rng(number)
    image, image2 = data["points2d"][first].astype(float), data["points2d"][second].astype(float)
    both = np.flatnonzero(np.isfinite(image).all(axis=1) & np.isfinite(image2).all(axis=1))
    chosen = rng.choice(both, 12, replace=False)
    source, target, truth, _ = _shuffle(image[chosen], image2[chosen], rng=rng)
    noise = float(np.sqrt(np.mean(data["rms_px"][[first, second]] ** 2)))
    request = _request("3p1", source, target, noise=noise, K=data["K"][first]) | {
        "camera2": _camera(data["K"][second]),
        "axis": data["gravity_cam"][first].tolist(),
        "axis2": data["gravity_cam"][second].tolist(),
        "axis_noise": 0.0,
    }
    return RealScene("facade-pair", number, request, truth)


def boards(data: Data, number: int) -> RealScene:
    """Eight corners of one pose of the board and eight others of another pose, in one image."""
    rng = np.random.default_rng(number)
    ids = np.unique(data["camera_id"])
    views = np.flatnonzero(data["camera_id"] == ids[rng.integers(0, len(ids))])
    first, second = rng.choice(views, 2, replace=False)
    chosen = rng.choice(len(data["points3d"]), 16, replace=False)
    image = np.concatenate([data["points2d"][first][chosen[:8]], data["points2d"][second][chosen[8:]]])
    source, target, truth, _ = _shuffle(data["points3d"][chosen], image, rng=rng)
    noise = float(np.sqrt(np.mean(data["rms_px"][[first, second]] ** 2)))
    request = _request("p3p", source, target, noise=noise, K=data["K"][first]) | {"motions": 2}
    return RealScene("boards", number, request, truth)


def targets(data: Data, number: int) -> RealScene | None:
    """All targets against those visible in a view, as raw pixels; twenty views evenly among those with enough."""
    image = data["points2d"]
    enough = np.flatnonzero(np.isfinite(image).all(axis=2).sum(axis=1) >= MIN_VISIBLE)
    views = enough[np.unique(np.linspace(0, len(enough) - 1, 20).astype(int))]
    if number >= len(views):
        return None
    view = int(views[number])
    source, target, truth, _ = _shuffle(data["points3d"], image[view], rng=np.random.default_rng(number))
    request = _request("p3p", source, target, noise=float(data["rms"][view]), K=data["K"][view])
    request["camera"]["dist"] = data["dist"].tolist()
    return RealScene("targets", number, request, truth)


def candidates(data: Data, number: int) -> RealScene:
    """Proposed pairs of which some belong to one of two instances of the object."""
    pairs, K = data["candidates"], data["K"]
    instances = []
    for R, t in zip(data["R"], data["t"], strict=True):
        moved = data["points3d"][pairs[:, 0]] @ R.T + t
        pixels = moved @ K.T
        distance = np.linalg.norm(pixels[:, :2] / pixels[:, 2:] - data["points2d"][pairs[:, 1]], axis=1)
        instances.append((distance < NEAR_INSTANCE) & (moved[:, 2] > 0.0))
    request = _request("p3p", data["points3d"], data["points2d"], noise=2.0, K=K)
    request |= {"candidates": pairs.tolist(), "motions": 2}
    return RealScene("candidates", number, request, instances=instances)


def _shuffle(
    points: NDArray[Any], image: NDArray[Any], clutter: NDArray[Any] | None = None, *, rng: np.random.Generator
) -> tuple[Floats, Floats, Integers, Integers]:
    """Points in random order, detections with clutter in another, the truth, and the order of the points."""
    order = rng.permutation(len(points))
    seen = np.isfinite(image[order]).all(axis=1)
    detections = np.concatenate([image[order][seen], np.empty((0, 2)) if clutter is None else clutter])
    shuffle = rng.permutation(len(detections))
    truth = np.full(len(points), -1, np.int64)
    truth[seen] = np.argsort(shuffle)[: seen.sum()]
    return points[order].astype(float), detections[shuffle].astype(float), truth, order


def _request(problem: str, source: Floats, target: Floats, *, noise: float, K: Floats) -> dict[str, Any]:
    return {
        "source": source.tolist(),
        "target": target.tolist(),
        "problem": problem,
        "camera": _camera(K),
        "noise": noise,
    }


def _camera(K: Floats) -> dict[str, Any]:
    return {"fx": float(K[0, 0]), "fy": float(K[1, 1]), "cx": float(K[0, 2]), "cy": float(K[1, 2])}
