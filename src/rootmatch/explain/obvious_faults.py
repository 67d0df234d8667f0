"""What is wrong with points, or with detections of a camera, at a glance: no search is needed to see it."""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.checks import are_collinear
from rootmatch.problems.similarity import Similarity

BEYOND = 1.0
"""Pixels beyond the edge of an image at which a detection may be, by its noise. A round value."""
WIDEST = 6.0
"""Largest coordinate x/z or y/z that is taken for one: 80° from the axis. A round value."""

NORMALISED, IN_PIXELS = 2.0, 10.0
"""Coordinates up to which all of an image are taken for x/z and y/z without any trial, 63° from the axis, and focal
length from which a camera is in pixels: no image has all that it shows within two of them. Round values."""

TOGETHER = 4.0
"""Distance in σ within which .98 of the pairs of detections of one thing lie, by the χ² of their difference."""
TWICE = 0.5
"""Share of detections beside another from which advice speaks of it: fewer are neighbours by chance. A round value."""


def obvious_fault(task: MatchingTask) -> str | None:
    """What is wrong with points, or with detections of a camera, at a glance; None if nothing is."""
    source = task.points.source
    if isinstance(task.problem, Similarity) and source.shape[1] == 3 and are_collinear(source):
        return "all points are collinear, which leaves the pose open; add points off the line, or give a `prior`"
    for name in ("source", "target") if isinstance(task.problem, Similarity) else ():
        own, noise = getattr(task.points, name), getattr(task.points, f"{name}_noise")
        if len(own) and (sigma := np.median(noise)) > np.ptp(own, axis=0).max():
            return f"the noise of the {name} is {sigma:.3g}, more than its points lie apart; give it in their unit"
    if len(task.points.target) < task.problem.order:
        return None
    if (fault := unit_fault(task)) is not None:
        return fault
    camera, target = getattr(task.problem, "camera", None), task.points.target
    if isinstance(camera, Camera) and camera.lens is None:
        aside = np.abs((target - (camera.cx, camera.cy)) / (camera.fx, camera.fy)).max(axis=1)
        if np.median(aside) > WIDEST:
            return (
                "this camera would see most detections more than 80° from its axis; give its focal length in pixels: "
                "millimetres divided by the size of a pixel"
            )
    sizes = None if camera is None or task.problem.source_is_image else image_sizes(camera)
    if sizes is not None:
        beyond = np.flatnonzero((target[:, :2] > np.array(sizes, float)[task.camera_of] + BEYOND).any(axis=1))
        if len(beyond):
            width, height = sizes[task.camera_of[beyond[0]]]
            return (
                f"{len(beyond)} of {len(target)} detections lie outside their image, the first at index {beyond[0]}, "
                f"where the image has {width:g} by {height:g} pixels; check its size, (width, height)"
            )
    return None


def unit_fault(task: MatchingTask) -> str | None:
    """What detections of a camera in pixels are instead, at a glance; None if they may be pixels."""
    camera, target = getattr(task.problem, "camera", None), task.points.target
    every = getattr(camera, "cameras", (camera,))
    in_pixels = all(isinstance(own, Camera) and min(own.fx, own.fy) > IN_PIXELS for own in every)
    if in_pixels and target[:, :2].min() >= 0.0 and target[:, :2].max() <= 1.0:
        return (
            "all detections are between 0 and 1, as fractions of the size of the image are, or normalised coordinates "
            "(x/z, y/z), but the camera is in pixels; multiply x by the width and y by the height of the image, and "
            "give the noise in pixels too"
        )
    if in_pixels and np.abs(target[:, :2]).max() < NORMALISED:
        return (
            "the detections look like normalised coordinates (x/z, y/z), but the camera is in pixels; give pixels, "
            "or `Camera(1, 1, 0, 0)` and the noise in these units"
        )
    return None


def image_sizes(camera: Any) -> Any:
    """Sizes of the images of a camera or a rig, as far as they are known."""
    if isinstance(camera, Rig):
        return camera.sizes
    return None if camera.size is None else (camera.size,)


def is_detected_twice(task: MatchingTask) -> bool:
    """Whether most detections are as near to another one of their image as two measurements of one thing."""
    from scipy.spatial import cKDTree  # slow to import

    near = np.zeros(len(task.points.target), bool)
    for camera in np.unique(task.camera_of):
        own = task.camera_of == camera
        target, noise = task.points.target[own], task.points.detection_noise[own]
        away, other = cKDTree(target).query(target, 2)
        near[own] = (other[:, 1] < len(target)) & (away[:, 1] < TOGETHER * noise)
    return bool(near.sum() > TWICE * len(near))
