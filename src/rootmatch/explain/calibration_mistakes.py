"""Calibrations that are wrong, as what matches tells: a focal length, a lens that was left out, a camera of a rig.

A single camera is fitted to what matches with a much larger noise. A camera that is not where its rig has it, as after
a knock, is placed anew by what it sees alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rootmatch.algebra.rotation import one_rotation_matrix, one_rotation_vector
from rootmatch.arrays import Floats
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.explain import explain
from rootmatch.explain.finding import Finding
from rootmatch.explain.mistake import Mistake, scale_noise
from rootmatch.explain.rig_search import camera_task
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.samplers.guided.sampler import Guided

FACTORS = (5.0, 20.0, 60.0)
"""Factors on σ with which matches are sought before the camera is fitted. Of ten points about 1 m away, focal lengths
15 % off are found with the first, distortion of k1 = −.25 needs the last in one of ten (seeds 1000 to 1019)."""
AFTER = 3.0
"""Factor on σ with which they are sought again after that; the fit to these is the answer. A round value."""
SPREAD = 0.5
"""Standard deviation of the logarithm of the focal length over that given, and of k1. A round value."""
FEWEST = 7
"""Matches that tell a camera and a pose: six degrees of freedom are left, as for a larger σ."""
TURNED, MOVED = 0.1, 0.3
"""Standard deviations of how far a camera that was knocked is turned about each axis, in radians, and moved along each,
in those of the cameras' places. Round values."""
NEARLY_ONE = 1e-3
"""Least distance of the cameras that is assumed, in radii of the body: all may be in one place. A round value."""


def wrong_calibration(task: MatchingTask) -> Iterator[Mistake]:
    """That the focal length of a single camera is wrong, and that it lacks its lens."""
    camera = getattr(task.problem, "camera", None)
    if not isinstance(camera, Camera) or task.problem.source_is_image:
        return
    remedy = "calibrate the camera again, or use the calibration of this zoom and image size"
    name, known = partial(_name, camera), dict[tuple[int, float], Finding]()
    yield Mistake("the focal length is wrong", remedy, partial(_calibrate, 1, known), complete=name, fitted=1)
    if camera.lens is None:
        remedy = "calibrate the camera with its lens, Camera.from_opencv(K, dist), or undistort the detections"
        mistake = "the camera's distortion was left out"
        yield Mistake(mistake, remedy, partial(_calibrate, 2, known), complete=name, fitted=2)


def _name(given: Camera, mistake: Mistake, match: Any) -> Mistake:
    """The mistake with the calibration that was found."""
    camera = match.task.problem.camera
    found = f"fx is about {camera.fx:.4g} instead of {given.fx:.4g}"
    if camera.lens is not given.lens:
        found += f", k1 about {camera.lens.values[0]:.2g}"
    return mistake._replace(name=f"{mistake.name}: {found}")


def _calibrate(unknowns: int, known: dict[tuple[int, float], Finding], given: MatchingTask) -> MatchingTask:
    """The task with the camera that fits its matches; raises `InputError` if too few points match with any.

    ``known``: what was found with the camera as given, by body and factor on σ, whatever is fitted to it.
    """
    task = given.without_priors()
    for k, body in enumerate(task.each_body):
        for factor in FACTORS:
            if (k, factor) not in known or known[k, factor].task.deadline.passed():
                known[k, factor] = _explain_noisier(body, factor)
            found = known[k, factor]
            camera = _fit_camera(body, found, unknowns)
            if camera is not None:
                changed = replace(body.problem, camera=camera)  # type: ignore[type-var]
                found = _explain_noisier(replace(body, problem=changed), AFTER)
                camera = _fit_camera(body, found, unknowns)
            if camera is not None and found.status is Status.MATCHED:
                return replace(task, problem=replace(task.problem, camera=camera))  # type: ignore[type-var]
    raise InputError("too few points match to tell the camera")


def _explain_noisier(task: MatchingTask, factor: float) -> Finding:
    return explain(replace(task, points=scale_noise(task.points, 1.0, factor)))


def _fit_camera(task: MatchingTask, found: Finding, unknowns: int) -> Camera | None:
    """The camera with another focal length, and another k1 if two are unknown, that fits matches; None of too few."""
    from scipy.optimize import least_squares  # slow to import

    assignment, start = found.assignment, found.pose
    own = np.flatnonzero(assignment >= 0)
    if start is None or len(own) < FEWEST:
        return None
    points, pixels = task.points.source[own], task.points.target[assignment[own]]
    sigma = task.points.target_noise[assignment[own], None]
    given: Camera = task.problem.camera  # type: ignore[attr-defined]

    def camera_of(values: Floats) -> Camera:
        zoom = float(np.exp(values[0]))
        lens = given.lens if unknowns == 1 else Brown((float(values[1]), 0.0, 0.0, 0.0))
        return replace(given, fx=zoom * given.fx, fy=zoom * given.fy, lens=lens)

    def residuals(values: Floats) -> Floats:
        moved = points @ one_rotation_matrix(values[:3]).T + values[3:6]
        off = (camera_of(values[6:]).project(moved) - pixels) / sigma
        return np.append(np.nan_to_num(off, nan=1e4).ravel(), values[6:] / SPREAD)

    guess = np.array([*one_rotation_vector(start.R), *start.t, *np.zeros(unknowns)])
    return camera_of(least_squares(residuals, guess, loss="soft_l1").x[6:])


def displaced_cameras(task: MatchingTask) -> Iterator[Mistake]:
    """That one of the cameras is somewhere else, or turned."""
    assert task.rig is not None
    if len(task.rig.views) < 2:
        return
    for k in range(len(task.rig.views)):
        remedy = f"calibrate camera {k} again (its pose or its focal length), and leave its detections out until then"
        yield Mistake(f"camera {k} is not where the rig has it", remedy, partial(_replace_camera, k))


def _replace_camera(k: int, given: MatchingTask) -> MatchingTask:
    """The task with a camera where it and the others see the same body.

    Raises `InputError` if no body is told by the camera alone and by the others, or it is where it should be.
    """
    task = given.without_priors()
    assert task.rig is not None
    for body in task.each_body:
        every = np.arange(body.shape[0])
        seen = explain(body.subset(every, np.flatnonzero(body.camera_of != k)))
        if seen.status is not Status.MATCHED or seen.pose is None:
            continue
        views = list(task.rig.views)
        camera, R, t = views[k]
        apart = max(body_radius(task.rig.centres), NEARLY_ONE * body_radius(body.points.source))
        spread = np.repeat([TURNED, MOVED * apart], 3)
        expected = Pose(np.array(R), np.array(t), np.diag(spread**2)) @ seen.pose
        alone = explain(replace(camera_task(body, k, Guided())[2], prior_pose=expected))
        if alone.status is Status.MATCHED and alone.prior_holds and alone.pose is not None:
            found = alone.pose @ seen.pose.inverse()
            if _is_same_pose(found, np.array(R), np.array(t)):
                raise InputError(f"camera {k} is where the rig has it")
            views[k] = camera, found.R, found.t
            changed = replace(task.problem, camera=task.rig.with_views(views))  # type: ignore[type-var]
            return replace(task, problem=changed)
    raise InputError(f"camera {k} and the others do not see the same body")


def _is_same_pose(found: Pose, R: Floats, t: Floats) -> bool:
    """Whether a pose with its covariance is that of R and t."""
    from scipy.stats import chi2  # slow to import

    assert found.covariance is not None
    step = np.array([*one_rotation_vector(found.R @ R.T), *(found.t - t)])
    return float(step @ np.linalg.solve(found.covariance, step)) < float(chi2.isf(TRUST.noise_chance, len(step)))
