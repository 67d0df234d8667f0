"""Detections outside of a lens's image circle: nothing of the scene is seen there, so they are clutter and left out.

A hot pixel in a corner of a fisheye image is one. That most detections of an image lie there is a wrong lens.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from weakref import WeakSet

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_identity
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.pinhole import Camera, describe_outside_circle
from rootmatch.cameras.rig import Rig
from rootmatch.errors import InputWarning, UnseenPixelError
from rootmatch.explain.body_findings import restore_columns
from rootmatch.explain.finding import Finding
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.zoom_hypotheses import make_candidate
from rootmatch.frozen import copy_with
from rootmatch.model.views import unproject_detections

INNER = 0.8
"""Part of the radius of the image circle within which no detection is asked whether the lens shows it: the inverse of a
lens may take milliseconds. A round value."""
MAXIMUM = 0.5
"""Part of the detections that may lie outside of the circle: with more the lens is wrong. A round value."""
WHATEVER_IS_SEEN = "bodies", "options", "prior_pose", "rivals", "priors", "rivals_of", "found_before"
"""What is known of a task and depends on no detection."""

_warned: WeakSet[Camera] = WeakSet()


def explain_seen(task: MatchingTask, explain: Callable[[MatchingTask], Finding]) -> Finding:
    """The finding of a task by the detections that a lens can show; its indices are those of all.

    Raises `UnseenPixelError` if that is none of them, or, where no pose is predicted, less than half.
    """
    unseen = _find_unseen(task)
    if unseen is None:
        return explain(task)
    _report(task, unseen, wrong=bool(unseen.all() or (not task.is_predicted and unseen.mean() > MAXIMUM)))
    columns = np.flatnonzero(~unseen)
    known = {name: getattr(task, name) for name in WHATEVER_IS_SEEN}
    return _restore_detections(explain(task.subset(None, columns, **known)), task, columns)


@cache_by_identity(16)
def _lens_edges(sensor: CameraModel | None) -> tuple[dict[int, Camera], Floats]:
    """The cameras that have a lens with an edge, by their numbers; rows (C, 5) of what tells what is near the edge.

    Principal point, focal lengths, and the squared distance in these from which a detection is asked for.
    """
    every = sensor.cameras if isinstance(sensor, Rig) else [sensor]
    edges, rows = dict[int, Camera](), np.tile([0.0, 0.0, 1.0, 1.0, np.inf], (len(every), 1))
    for k, one in enumerate(every):
        if isinstance(one, Camera) and one.lens is not None and np.isfinite(one.lens.radius):
            edges[k], rows[k] = one, (one.cx, one.cy, one.fx, one.fy, (INNER * one.lens.radius) ** 2)
    return edges, rows


def _sensor(task: MatchingTask) -> CameraModel | None:
    return None if task.problem.source_is_image else task.problem.sensor


def _find_unseen(task: MatchingTask) -> Bools | None:
    """Which detections (n',) lie where a lens shows nothing; None if none does."""
    edges, rows = _lens_edges(_sensor(task))
    if not edges:
        return None
    pixels, of = task.points.target[:, :2], rows[task.camera_of]
    off = (pixels - of[:, :2]) / of[:, 2:4]
    outer = np.einsum("ij,ij->i", off, off) > of[:, 4]
    if not np.count_nonzero(outer):
        return None
    unseen = np.zeros(len(outer), np.bool_)
    for k, camera in edges.items():
        own = np.flatnonzero(outer & (task.camera_of == k))
        unseen[own] = ~np.isfinite(unproject_detections(camera, pixels[own])).all(axis=1)
    return unseen if unseen.any() else None


def _report(task: MatchingTask, unseen: Bools, *, wrong: bool) -> None:
    """Warn of the detections that are left out, once for each camera, or refuse them."""
    of_rig = task.rig is not None
    for k, camera in _lens_edges(_sensor(task))[0].items():
        own = np.flatnonzero(task.camera_of == k)
        if not unseen[own].any() or (camera in _warned and not wrong):
            continue
        of = " of its camera" if of_rig else ""
        told = describe_outside_circle(camera, task.points.target[own, :2], unseen[own], own, f"detection{{}}{of}")
        if wrong:
            raise UnseenPixelError(
                f"target: {told}: the image was probably taken with another lens; check the calibration and the "
                "image size"
            )
        _warned.add(camera)
        warnings.warn(f"target: {told}, where the lens shows nothing: left out", InputWarning, stacklevel=5)


def _restore_detections(found: Finding, task: MatchingTask, columns: Integers) -> Finding:
    """A finding among some detections, and those of its bodies, as one among all."""
    if found.task.noise_is_estimated and not task.noise_is_estimated:
        task = task.with_noise(found.task.noise)
    known = {name: getattr(task, name) for name in ("points", "calibration_noise", "allowed", "weights")}
    whole = copy_with(found.task, **known)
    parts = found.parts
    if parts is not None:
        each = zip(parts.items(), task.each_body, strict=True)
        parts = {label: _restore_detections(one, part, columns) for (label, one), part in each}
    model = None if found.model is None else make_candidate(whole, []).model
    return copy_with(restore_columns(found, whole, columns), model=model, parts=parts, left=None)
