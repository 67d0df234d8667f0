"""Cameras of a rig that are not where the rig has them, as after a knock: each is placed anew by what it sees alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from rootmatch.algebra.rotation import one_rotation_vector
from rootmatch.arrays import Floats
from rootmatch.errors import InputError
from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.explain import explain
from rootmatch.explain.mistake import Mistake, each_body
from rootmatch.explain.rig_search import camera_task
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.samplers.guided.sampler import Guided

TURNED, MOVED = 0.1, 0.3
"""Standard deviations of how far a camera that was knocked is turned about each axis, in radians, and moved along each,
in those of the cameras' places. Round values."""
NEARLY_ONE = 1e-3
"""Least distance of the cameras that is assumed, in radii of the body: all may be in one place. A round value."""


def displaced_cameras(task: MatchingTask) -> Iterator[Mistake]:
    """That one of the cameras is somewhere else, or turned."""
    assert task.rig is not None
    if len(task.rig.views) < 2:
        return
    for k in range(len(task.rig.views)):
        remedy = f"calibrate camera {k} again, its pose or its focal length, and leave its detections out until then"
        yield Mistake(f"camera {k} is not where the rig has it", remedy, partial(_replace_camera, k))


def _replace_camera(k: int, given: MatchingTask) -> MatchingTask:
    """The task with a camera where it and the others see the same body.

    Raises
    ------
    InputError
        If no body is told by the camera alone and by the others, or the camera is where it should be.
    """
    task = given.without_priors()
    assert task.rig is not None
    for body in each_body(task):
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
