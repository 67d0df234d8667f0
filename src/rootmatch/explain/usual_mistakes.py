"""What people get wrong about an input: each mistake with its remedy and the corrected task."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.explain.calibration_mistakes import displaced_cameras, wrong_calibration
from rootmatch.explain.mistake import (
    HANDED_MODEL,
    UNITS,
    Change,
    Mistake,
    format_scaled,
    list_point_set_mistakes,
    list_prior_mistakes,
    make_change,
    mirror_source,
    ratio_of_units,
    scale_noise,
)
from rootmatch.explain.obvious_faults import WIDEST, image_sizes
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.points import PointSets
from rootmatch.problems.similarity import Similarity

FACTORS = (3.0, 10.0)
"""Factors by which σ may have been stated too small. Round values."""
NOISIER = {f"the noise is {factor:g} times as large": factor for factor in FACTORS}
"""The factor of each mistake of that kind."""
OPENGL = np.array([1.0, -1.0, -1.0])
"""Signs that take its axes, y up and the view along −z, to those of a camera here."""


def usual_mistakes(given: MatchingTask) -> Iterator[Mistake]:
    """Possible mistakes, the commonest first; one about the points is tried without what is known of the pose."""
    yield from list_prior_mistakes(given)
    problem, points = given.problem, given.points

    def pointed(**changes: Any) -> Change:
        return make_change(points=replace(points, **changes))

    def posed(**changes: Any) -> Change:
        return make_change(problem=replace(problem, **changes))  # type: ignore[type-var]

    cameras = {name: one for name in ("camera", "camera2") if (one := getattr(problem, name, None)) is not None}

    def filmed(change: Callable[[Camera], Camera]) -> Change:
        return posed(**{name: _change_camera(camera, change) for name, camera in cameras.items()})

    of_normals = _normal_mistakes(points, pointed)
    if isinstance(cameras.get("camera"), Rig):  # whose images are hardly mirrored, as it was calibrated with them
        yield from of_normals
    if isinstance(problem, Similarity):  # Rigid too
        yield from list_point_set_mistakes(problem, points)
    else:
        yield from _axis_mistakes(given, cameras, pointed, posed)
    yield from of_normals
    if hasattr(problem, "vertical_world"):
        upside = tuple(-np.asarray(problem.vertical_world, float))
        remedy = "negate `vertical_world` or `vertical_camera`: both point down, or both up (accelerometers measure up)"
        yield Mistake("one of the verticals is upside down", remedy, posed(vertical_world=upside))
    if hasattr(problem, "axis2"):
        upside = tuple(-np.asarray(problem.axis2, float))
        yield Mistake("one of the axes is reversed", "negate `axis` or `axis2`", posed(axis2=upside))
    yield from _coordinate_mistakes(points, cameras, pointed, filmed)
    yield from _lens_mistakes(cameras, filmed)
    yield from wrong_calibration(given)
    if not given.estimates_noise:
        if any(isinstance(camera, UnitRays) for camera in cameras.values()):
            unit = math.radians(1.0)
            remedy = "give the noise of rays in radians: `np.radians(...)`"
            yield Mistake("the noise is in degrees", remedy, make_change(points=scale_noise(points, 1.0, unit)))
        of_both = problem.noisy_source
        for mistake, factor in NOISIER.items():
            remedy = f"give {format_scaled(given.noise, factor)}"
            yield Mistake(mistake, remedy, make_change(points=scale_noise(points, factor if of_both else 1.0, factor)))


def _normal_mistakes(points: PointSets, pointed: Callable[..., Change]) -> Iterator[Mistake]:
    if points.normals is None:
        return
    if points.view_cosine is not None and (np.arccos(points.view_cosine) < math.pi / 2.0).any():
        yield Mistake("the view angle is too small", "give a larger one, or leave it out", pointed(view_cosine=None))
    yield Mistake("the normals point inwards", "negate nx, ny and nz", pointed(normals=-points.normals))
    yield Mistake("the normals are wrong", "leave them out", pointed(normals=None, view_cosine=None))


def _axis_mistakes(
    task: MatchingTask, cameras: dict[str, Any], pointed: Callable[..., Change], posed: Callable[..., Change]
) -> Iterator[Mistake]:
    """Axes of images and models; a pose cannot tell a mirrored image from a mirrored model."""
    points, camera = task.points, cameras.get("camera")
    flat = points.source.shape[1] == 2
    if isinstance(camera, Rig):
        change = make_change(points=mirror_source(points, np.eye(3)[0]))
        yield Mistake(HANDED_MODEL, "negate one coordinate of points and normals", change)
        each = [(own, np.array(R), np.array(t)) for own, R, t in camera.views]
        other_poses = {
            "the camera poses map to the rig": ("the inverse", [(own, R.T, -R.T @ t) for own, R, t in each]),
            "the positions C of the cameras are given as t": ("t = −R C", [(own, R, -R @ t) for own, R, t in each]),
            "the axes of the cameras are those of OpenGL, y up and z backwards": (
                "R and t with their second and third rows negated",
                [(own, OPENGL[:, None] * R, OPENGL * t) for own, R, t in each],
            ),
        }
        for name, (meant, views) in other_poses.items():
            remedy = f"give each camera with x_camera = R x_rig + t, y down and z forward: {meant}"
            yield Mistake(name, remedy, posed(camera=camera.with_views(views)))
        for one, other in combinations(range(len(camera.views)), 2):
            order = list(camera.views)
            order[one], order[other] = order[other], order[one]
            exchanged = camera.with_views(order)
            remedy = f"swap cameras {one} and {other} of the rig, or the camera indices of their detections"
            yield Mistake(f"cameras {one} and {other} are swapped", remedy, posed(camera=exchanged))
        for wrong, right in UNITS:
            factor = ratio_of_units(wrong, right)
            name = f"the model is in {wrong}, the rig in {right}"
            remedy = "use one unit for the points and the rig's translations"
            scaled = replace(scale_noise(points, factor, 1.0), source=factor * points.source)
            yield Mistake(name, remedy, make_change(points=scaled))
        yield from displaced_cameras(task)
        return
    centres = [_centre(cameras.get("camera2") or camera, task), _centre(camera, task)]

    def mirrored_along(axis: int) -> Change:
        changed = {}
        for name, centre in zip(("target", "source") if flat else ("target",), centres, strict=False):
            changed[name] = getattr(points, name).copy()
            changed[name][:, axis] = 2.0 * centre[axis] - changed[name][:, axis]
        return pointed(**changed)

    remedy = "give y downwards (image height − y), or negate one coordinate of the model and of its normals"
    yield Mistake("y is measured upwards in the image, or the model is left-handed", remedy, mirrored_along(1))
    if hasattr(task.problem, "vertical_world"):  # which tells these two apart
        name, remedy = "x is mirrored, or the model is left-handed", "mirror x, or one horizontal axis of the model"
        yield Mistake(name, remedy, mirrored_along(0))
    if (upright := getattr(task.problem, "upright", None)) is not None:  # that of a mirrored image is mirrored as well
        every = ((HANDED_MODEL, "one level"), ("heights of the model are depths", "the vertical"))
        for (name, which), axis in zip(every, upright.world[:2], strict=True):
            change = make_change(points=mirror_source(points, axis))
            yield Mistake(name, f"negate {which} coordinate of points and normals", change)
    if points.target.shape[1] == 2:
        swapped = {"target": points.target[:, ::-1].copy()}
        if flat:
            swapped["source"] = points.source[:, ::-1].copy()
        yield Mistake(
            "x and y of the image are swapped", "give columns x, y: `np.array(...)[:, ::-1]`", pointed(**swapped)
        )


def _coordinate_mistakes(
    points: PointSets, cameras: dict[str, Any], pointed: Callable[..., Change], filmed: Callable[..., Change]
) -> Iterator[Mistake]:
    """Images in other coordinates than pixels: those of normalised rays, x/z and y/z, or fractions of the image."""
    camera = cameras.get("camera")
    views = {"target": cameras.get("camera2", camera)}
    if points.source.shape[1] == 2:
        views["source"] = camera
    every: list[Any] = [own for view in views.values() for own in getattr(view, "cameras", (view,))]
    given = np.vstack([getattr(points, name)[:, :2] for name in views])
    if not all(isinstance(own, Camera) for own in every) or np.abs(given).max() > WIDEST:
        return

    def in_pixels(scales: dict[str, tuple[Floats, Floats]], sigma_too: bool) -> Change:
        changed: dict[str, Any] = {}
        for name, (scale, offset) in scales.items():
            rows = getattr(points, name).copy()
            rows[:, :2] = rows[:, :2] * scale + offset
            changed |= {name: rows, f"{name}_covariance": None}
            known, factor = getattr(points, f"{name}_covariance"), scale if sigma_too else np.ones_like(scale)
            if known is not None:
                changed[f"{name}_covariance"] = known * factor[:, :, None] * factor[:, None, :]
            size = np.sqrt(factor.prod(axis=1))
            changed[f"{name}_noise"] = getattr(points, f"{name}_noise") * size
            if name == "target" and points.noise_alone is not None:
                changed["noise_alone"] = points.noise_alone * size
        return pointed(**changed)

    rays = {name: _scales(view, getattr(points, name)) for name, view in views.items()}
    in_unit = "; give the noise in pixels too"
    name, remedy = "the image is in normalised coordinates (x/z, y/z)", "give pixels: fx x + cx, fy y + cy"
    raw = in_pixels(rays, sigma_too=False), in_pixels(rays, sigma_too=True)
    distorted = any(own.lens is not None for own in every)
    if distorted:  # what normalises takes the lens out, as a rule
        bare, told = filmed(lambda own: replace(own, lens=None)), f"{remedy}, and the camera without its lens"
        for k, change in enumerate(raw):
            without = partial(lambda raw, task: bare(raw(task)), change)
            yield Mistake(name, f"{told}{in_unit if k else ''}", without, if_nothing_fits=k > 0)
    for k, change in enumerate(raw):
        yield Mistake(name, f"{remedy}{in_unit if k else ''}", change, if_nothing_fits=k > 0 or distorted)
    sizes = [image_sizes(view) for view in views.values()]
    if given.min() >= 0.0 and given.max() <= 1.0 and None not in sizes:
        parts = {name: _scales(view, getattr(points, name), image_sizes(view)) for name, view in views.items()}
        for sigma_too in (False, True):
            told = f"multiply x by the width and y by the height{in_unit if sigma_too else ''}"
            change = in_pixels(parts, sigma_too=sigma_too)
            yield Mistake("the image is in fractions of its size", told, change, if_nothing_fits=sigma_too)


def _scales(camera: Any, rows: Floats, sizes: Any = None) -> tuple[Floats, Floats]:
    """Scale and offset (m, 2) that take coordinates of m detections to pixels: by the camera, or by image sizes."""
    own = np.array([one.numbers for one in getattr(camera, "cameras", (camera,))])
    which = rows[:, 2].astype(int) if isinstance(camera, Rig) else np.zeros(len(rows), int)
    if sizes is not None:
        return np.array(sizes, float)[which], np.zeros((len(rows), 2))
    return own[which, :2], own[which, 2:]


def _lens_mistakes(
    cameras: dict[str, Any], filmed: Callable[[Callable[[Camera], Camera]], Change]
) -> Iterator[Mistake]:
    if not any(isinstance(camera, Camera | Rig) for camera in cameras.values()):
        return

    def shifted(x: float, y: float) -> Change:
        return filmed(lambda own: replace(own, cx=own.cx + x, cy=own.cy + y))

    for factor, size in ((2.0, "half"), (0.5, "twice")):
        mistake = f"the camera was calibrated at {size} the size of the image"
        yield Mistake(mistake, f"multiply fx, fy, cx and cy by {factor:g}", filmed(partial(_scale_camera, factor)))
    lenses = [one.lens for camera in cameras.values() for one in getattr(camera, "cameras", (camera,))]
    if any(isinstance(lens, Brown) and len(lens.values) in (4, 5) for lens in lenses):
        remedy = "use `Camera.from_opencv_fisheye(K, D)`"
        yield Mistake("the lens coefficients are those of a fisheye", remedy, filmed(_to_fisheye))
    if any(isinstance(lens, KannalaBrandt) for lens in lenses):
        yield Mistake("the lens coefficients are Brown's", "use `Camera.from_opencv(K, dist)`", filmed(_to_brown))
    if any(lens is not None for lens in lenses):
        remedy = "give raw pixels, or leave the lens out"
        yield Mistake("the detections were undistorted already", remedy, filmed(lambda own: replace(own, lens=None)))
    remedy = "check the order: fx, fy, cx, cy"
    yield Mistake("cx and cy are swapped", remedy, filmed(lambda own: replace(own, cx=own.cy, cy=own.cx)))
    shifts = [(x, y) for x in (0.5, -0.5) for y in (0.5, -0.5)]
    for half in (0.5, -0.5):
        remedy = f"add {half:g} to cx and cy: OpenCV has the centre of the first pixel at (0, 0), COLMAP at (0.5, 0.5)"
        rivals = tuple(shifted(x, y) for x, y in shifts if (x, y) != (half, half))
        yield Mistake("the principal point is off by half a pixel", remedy, shifted(half, half), rivals=rivals)


def _change_camera(camera: Any, change: Callable[[Camera], Camera]) -> Any:
    """A camera, or each camera of a rig, with a change; anything but a `Camera` stays as it is."""
    if isinstance(camera, Rig):
        return camera.with_views([(_change_camera(own, change), R, t) for own, R, t in camera.views])
    return change(camera) if isinstance(camera, Camera) else camera


def _centre(camera: Any, task: MatchingTask) -> tuple[float, float]:
    """Principal point; the origin for rays, and the problem's centre for a camera of unknown focal length."""
    if isinstance(camera, Camera):
        return camera.cx, camera.cy
    x, y = getattr(task.problem, "centre", (0.0, 0.0))
    return float(x), float(y)


def _scale_camera(factor: float, camera: Camera) -> Camera:
    fx, fy, cx, cy = (factor * one for one in camera.numbers)
    size = None if camera.size is None else (factor * camera.size[0], factor * camera.size[1])
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, size=size)


def _to_fisheye(camera: Camera) -> Camera:
    return replace(camera, lens=KannalaBrandt(camera.lens.values[:4])) if isinstance(camera.lens, Brown) else camera


def _to_brown(camera: Camera) -> Camera:
    return replace(camera, lens=Brown(camera.lens.values)) if isinstance(camera.lens, KannalaBrandt) else camera
