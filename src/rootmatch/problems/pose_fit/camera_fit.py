"""Maximum-likelihood poses of a calibrated camera from points in space and their image, with their covariance.

The model of an image fits tens of assignments roughly, to compare them (`rootmatch.model.proposals`). Here few are
fitted to the bottom: from many starts, as a plane seen from afar has two valleys, and four points may have more.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.cameras.base import CameraModel
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.descent import KEPT, ROUGH_STEPS, State, descend, select_lowest, state_covariance
from rootmatch.problems.pose_fit.fitted_pose import make_pose_of_fit, to_callers_frame
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.prior_residuals import Prior, Upright
from rootmatch.problems.pose_fit.projection_model import ProjectionModel, whitening
from rootmatch.problems.pose_fit.starts import reflect_poses, select_best_apart, starting_poses

REWEIGHTED = 2
"""How often covariances of projections are taken anew. Not tuned: the first fit has them to a few per cent."""
AHEAD = 0.0, 0.0, 1.0


class PackedMatches(NamedTuple):
    """K assignments of at most m matches each, fewer with weights of 0."""

    centre: Floats
    """(3,) mean of all source points."""
    unit: float
    """Their root mean square distance from it, on each axis."""
    source: Integers
    """(K, m) source points."""
    target: Integers
    """(K, m) detections."""
    places: Floats
    """(K, m, 3) source points from the centre, in that unit."""
    weight: Floats
    """(K, m) inverse σ of the detections."""


def pack_matches(points: PointSets, assignments: Integers) -> PackedMatches:
    """Pack assignments (K, n), −1 where unmatched."""
    centre = points.source.mean(axis=0)
    unit = float(np.sqrt(((points.source - centre) ** 2).mean()))
    used = assignments >= 0
    maximum = int(used.sum(axis=1).max(initial=0))
    source = np.argsort(~used, axis=1, kind="stable")[:, :maximum]
    target = np.maximum(np.take_along_axis(assignments, source, axis=1), 0)
    weight = np.where(np.take_along_axis(used, source, axis=1), 1.0 / points.target_noise[target], 0.0)
    places = (points.source[source] - centre) / unit
    return PackedMatches(centre, unit, source=source, target=target, places=places, weight=weight)


def camera_poses(
    points: PointSets,
    camera: CameraModel,
    assignments: Integers,
    upright: Upright | None = None,
    prior: Pose | None = None,
    start: Pose | None = None,
) -> list[Pose | None]:
    """The most likely pose of each assignment (K, n), None if none puts its points before the camera.

    Minimises the squared deviations of the detections from the projections of their points over their variances; a
    noisy vertical and a predicted pose add theirs. Where points are not exact, the covariance of their projections is
    taken at the pose of the fit before, `REWEIGHTED` times.

    Parameters
    ----------
    points : PointSets
        Points in space and detections with their σ.
    camera : CameraModel
    assignments : (K, n) int array
        −1 where unmatched; at least three matches in each, two where the vertical is known.
    upright : Upright, optional
        The known vertical, with its noise.
    prior : Pose, optional
        A predicted pose with its covariance.
    start : Pose, optional
        From which all are fitted; else from the prediction, or without one from many.
    """
    centre, unit, packed, target, places, weight = pack_matches(points, assignments)
    rays = camera.seen_bearings(points.target)[target]
    rays[weight == 0.0] = AHEAD  # of no match, where the lens may show nothing
    image = points.target[target] if points.target.shape[1] == 2 else rays
    axes = np.eye(3)
    if upright is not None:
        axes = upright.camera[1:2] if upright.noise == 0.0 else upright.camera[[1, 0, 2]]
    noisy = upright if upright is not None and upright.noise > 0.0 else None
    start = prior if start is None else start
    gaussian = None if prior is None or start is None else Prior.of(prior, centre, unit, start)

    model = ProjectionModel(places, image, weight, camera, axes, upright=noisy, prior=gaussian)
    count = len(places)
    starts: State
    if start is not None:
        R, place = start.R if upright is None else upright.nearest(start.R), (start.t + start.R @ centre) / unit
        starts = np.tile(R, (count, 1, 1, 1)), np.tile(place, (count, 1, 1))
    else:
        starts = starting_poses(places, rays, weight, upright)
        starts = select_best_apart(model.repeated(starts[0].shape[1]), starts)
    times = starts[0].shape[1]
    state, chi2 = descend(model.repeated(times), tuple(_flat(part) for part in starts), ROUGH_STEPS)
    kept = min(KEPT, times)
    state, chi2 = select_lowest(state, chi2, count, kept)
    if upright is None and start is None:
        best, _ = select_lowest(state, chi2, count)
        other, _ = descend(model, reflect_poses(best, places, weight), ROUGH_STEPS)
        state = tuple(
            _flat(np.concatenate([part.reshape(count, kept, *part.shape[1:]), more[:, None]], axis=1))
            for part, more in zip(state, other, strict=True)
        )
        kept += 1
    state, chi2 = select_lowest(*descend(model.repeated(kept), state), count)
    if points.has_covariances:
        known = None if points.source_covariance is None else points.source_covariance[packed] / unit**2
        own = np.where(weight[..., None, None] > 0.0, points.covariances_of(target), 0.0)
        for _ in range(REWEIGHTED):
            model = replace(model, white=whitening(camera, places, known, own, state))
            state, chi2 = descend(model, state)
    covariance = state_covariance(model, state)
    dof = (2 if noisy else 0) + (6 if gaussian else 0) - len(axes) - 3
    poses: list[Pose | None] = []
    for k, assignment in enumerate(assignments):
        if not np.isfinite(chi2[k]):
            poses.append(None)
            continue
        rotation = state[0][k]
        translation, own = to_callers_frame(rotation, state[1][k], covariance[k], axes=axes, centre=centre, unit=unit)
        members = np.flatnonzero(assignment >= 0)
        predicted = camera.project(points.source[members] @ rotation.T + translation)
        detected = points.target[assignment[members]]
        if detected.shape[1] == 3:
            detected = camera.bearings(detected)
        poses.append(
            make_pose_of_fit(
                rotation,
                translation,
                own,
                chi2=float(chi2[k]),
                dof=2 * len(members) + dof,
                points=members,
                predicted=predicted,
                residuals=np.linalg.norm(detected - predicted, axis=1),
                sigma=points.widest_noise[assignment[members]],
            )
        )
    return poses


def _flat(part: Floats) -> Floats:
    """(K, S, …) as (K S, …)."""
    return part.reshape(-1, *part.shape[2:])
