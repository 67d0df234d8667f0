"""Cameras as arrays of numbers, as the compiled projection takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers, cache_by_identity, cache_by_values
from rootmatch.cameras.base import RIM, CameraModel
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.rig_image import RigImage
from rootmatch.cameras.stereographic import ANTIPODE, Stereographic
from rootmatch.model.compiled.projection import BROWN, KANNALA_BRANDT, NUMBERS, PINHOLE, STEREOGRAPHIC
from rootmatch.model.compiled.unprojection import unproject

NO_MOTION = np.eye(3)[None], np.zeros((1, 3))
INVERTED = {PINHOLE, KANNALA_BRANDT}
"""Kinds of cameras whose rays are compiled."""


class Views(NamedTuple):
    """C cameras in one frame; see `rootmatch.model.compiled.projection.linearise`."""

    kinds: Integers
    numbers: Floats
    rotations: Floats
    translations: Floats
    offsets: Floats
    sizes: Floats
    rims: Floats


def kernel_camera_views(camera: CameraModel) -> Views | None:
    """The numbers of a camera, or of the cameras of a rig; None if one is of another kind than those compiled."""
    if type(camera) is RigImage:
        known = _rig_views(camera.rig)
        if known is None:
            return None
        shifts = known.translations if camera.unit == 1.0 else known.translations / camera.unit
        return known._replace(translations=shifts, offsets=np.ascontiguousarray(camera.offsets, np.float64))
    if isinstance(camera, Camera):
        return _camera_views(camera)
    if isinstance(camera, Stereographic):
        return _stack_views([(STEREOGRAPHIC, (1.0, 1.0, 0.0, 0.0, *camera.basis.ravel().tolist(), ANTIPODE))])
    return None


def camera_frames(camera: CameraModel) -> tuple[Floats, Floats]:
    """Rotations (C, 3, 3) and translations (C, 3) into the frames of the cameras of a rig; no motion for a camera."""
    if type(camera) is not RigImage:
        return NO_MOTION
    return camera.rig.rotations, camera.rig.translations / camera.unit


def unproject_detections(camera: CameraModel, target: Floats) -> Floats:
    """Unit rays (n', 3) of detections (n', 2) in the frames of their cameras; NaN where a lens shows nothing."""
    target = np.array(target, float)
    image, views = camera if type(camera) is RigImage else None, kernel_camera_views(camera)
    if views is not None and INVERTED.issuperset(views.kinds.tolist()):
        rays = np.empty((len(target), 3))
        camera_of = np.zeros(len(target), np.int64) if image is None else np.array(image.camera_of, np.int64)
        unproject(target, camera_of, (views.kinds, views.numbers, views.offsets), rays)
        return rays
    if image is None:
        return _unproject_camera(camera, target)
    return _unproject_rig(image.rig, target, image.offsets, image.camera_of)


@cache_by_values(4)
def _unproject_rig(rig: Rig, target: Floats, offsets: Floats, camera_of: Integers) -> Floats:
    rays = np.empty((len(target), 3))
    for k, (camera, offset) in enumerate(zip(rig.cameras, offsets, strict=True)):
        rays[camera_of == k] = _unproject_camera(camera, target[camera_of == k] - offset)
    return rays


def _unproject_camera(camera: CameraModel, target: Floats) -> Floats:
    """Unit rays (m, 3) of detections (m, 2) of one camera; NaN where its lens shows nothing."""
    return camera.seen_bearings(target) if len(target) else np.empty((0, 3))


@cache_by_identity(64)
def _camera_views(camera: Camera) -> Views | None:
    return _views_of((camera,), None if camera.size is None else (camera.size,))


@cache_by_identity(16)
def _rig_views(rig: Rig) -> Views | None:
    views = _views_of(rig.cameras, rig.sizes)
    return None if views is None else views._replace(rotations=rig.rotations, translations=rig.translations)


def _views_of(cameras: Sequence[CameraModel], sizes: Sequence[tuple[float, float]] | None) -> Views | None:
    """Cameras in one place, with the sizes of their images if they are known; None if one is not compiled."""
    every = [_camera_numbers(camera) for camera in cameras]
    known = [one for one in every if one is not None]
    if len(known) < len(every):
        return None
    views = _stack_views(known)
    if sizes is None:
        return views
    edges = np.array(sizes, dtype=float)
    return views._replace(sizes=edges, rims=RIM * edges[:, 0])


def _camera_numbers(camera: CameraModel) -> tuple[int, tuple[float, ...]] | None:
    """The kind of a camera with its numbers."""
    if not isinstance(camera, Camera):
        return None
    if camera.lens is None:
        return PINHOLE, camera.numbers
    if isinstance(camera.lens, KannalaBrandt):
        return KANNALA_BRANDT, (*camera.numbers, *camera.lens.values, camera.lens.angle)
    if isinstance(camera.lens, Brown) and not any(camera.lens.values[12:]):
        values = (*camera.lens.values, *(0.0,) * 12)[:12]
        return BROWN, (*camera.numbers, *values, camera.lens.fold)
    return None


def _stack_views(every: Sequence[tuple[int, tuple[float, ...]]]) -> Views:
    """Views from one place and in one image."""
    count = len(every)
    numbers = np.zeros((count, NUMBERS))
    for row, (_, values) in zip(numbers, every, strict=True):
        row[: len(values)] = values
    return Views(
        kinds=np.array([kind for kind, _ in every]),
        numbers=numbers,
        rotations=np.tile(np.eye(3), (count, 1, 1)),
        translations=np.zeros((count, 3)),
        offsets=np.zeros((count, 2)),
        sizes=np.full((count, 2), np.inf),
        rims=np.ones(count),
    )
