"""Poses of a rig of cameras: one body seen by several, each point perhaps by more than one.

The sightings of all cameras share one pose, and are fitted as the points of one camera are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rootmatch.arrays import Floats, Integers, cache_by_identity
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.rig_image import RigImage
from rootmatch.frozen import copy_with
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.camera_fit import REWEIGHTED
from rootmatch.problems.pose_fit.descent import State, descend, select_lowest, state_covariance
from rootmatch.problems.pose_fit.fitted_pose import make_pose_of_fit, to_callers_frame
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.prior_residuals import Prior
from rootmatch.problems.pose_fit.projection_model import ProjectionModel, whitening
from rootmatch.problems.pose_fit.starts import select_best_apart, starting_poses

STEPS = 20
"""Maximum number of steps of a descent from the pose of one camera; five are usual. Not tuned."""
MINIMUM = 4
"""Matches within one camera from which a fit can start: with three there are several poses."""


def list_sightings(rig: Rig, points: PointSets) -> tuple[RigImage, PointSets]:
    """The plane in which the images of a rig lie side by side, and the sightings of all points with their detections.

    ``points``: n of them, and detections (n', 3) with the index of their camera.
    """
    rows, n = points.target, len(points.source)
    image = RigImage(rig, n, rig.offsets(rows), rows[:, 2].astype(np.int64))
    source, normals, cosines, covariance = _repeat_for_cameras(
        rig, points.source, points.normals, points.view_cosine, points.source_covariance
    )
    return image, copy_with(
        points,
        source=source,
        target=rows[:, :2] + image.offsets[image.camera_of],
        source_noise=np.concatenate([points.source_noise] * len(rig.views)),
        normals=normals,
        view_cosine=cosines,
        source_covariance=covariance,
    )


@cache_by_identity(32)
def _repeat_for_cameras(rig: Rig, source: Floats, *known: Floats | None) -> tuple[Any, ...]:
    """A body's points (n, 3) and what else is known of each, for each camera, (C n, …): the same arrays for the same.

    ``known``: None for what is not.
    """
    return tuple(None if one is None else np.concatenate([one] * len(rig.views)) for one in (source, *known))


def rig_pose(
    image: RigImage, points: PointSets, assignment: Integers, prior: Pose | None = None, start: Pose | None = None
) -> Pose | None:
    """The most likely pose of the rig for one assignment of sightings (C n,), None if there is none.

    ``image``, ``points``: of `list_sightings`. It is fitted from ``start``, from the prediction, or from the pose of
    the camera that has most matches. Its `points` are sightings: camera · n + point. With a predicted pose, which is
    part of the fit, three matches in all are enough.
    """
    centre = points.source[: image.count].mean(axis=0)
    unit = float(np.sqrt(((points.source[: image.count] - centre) ** 2).mean()))
    places, image = (points.source - centre) / unit, replace(image, unit=unit)
    used, target, sigma = assignment >= 0, points.target, points.target_noise
    weight = np.where(used, 1.0 / sigma[np.maximum(assignment, 0)], 0.0)[None]
    detected = target[np.maximum(assignment, 0)][None]
    start = prior if start is None else start
    gaussian = None if prior is None or start is None else Prior.of(prior, centre, unit, start)
    model = ProjectionModel(places[None], detected, weight, image, np.eye(3), prior=gaussian)
    first: State
    if start is not None:
        first = start.R[None], ((start.t + start.R @ centre) / unit)[None]
    else:
        first = _starts(image, places, points, assignment)
    if not len(first[0]):  # too few matches in each camera
        return None
    state, chi2 = descend(model.repeated(len(first[0])), first, STEPS)
    if not np.isfinite(chi2).any():
        return None
    state, chi2 = select_lowest(state, chi2, 1)
    if points.has_covariances:
        known = None if points.source_covariance is None else points.source_covariance[None] / unit**2
        own = np.where(used[:, None, None], points.covariances_of(np.maximum(assignment, 0)), 0.0)[None]
        for _ in range(REWEIGHTED):
            white = whitening(image, places[None], known, own, state, images=len(image.offsets))
            model = replace(model, white=white)
            state, chi2 = descend(model, state, STEPS)
    covariance = state_covariance(model, state)[0]
    rotation, translation = state[0][0], state[1][0]
    t, own = to_callers_frame(rotation, translation, covariance, axes=np.eye(3), centre=centre, unit=unit)
    members = np.flatnonzero(used)
    detections = assignment[members]
    with np.errstate(all="ignore"):
        predicted = image.project(places @ rotation.T + translation)[members]
    return make_pose_of_fit(
        rotation,
        t,
        own,
        chi2=float(chi2[0]),
        dof=2 * len(members) - (6 if gaussian is None else 0),
        points=members,
        predicted=predicted - image.offsets[image.camera_of[detections]],
        residuals=np.linalg.norm(predicted - target[detections], axis=1),
        sigma=points.widest_noise[detections],
    )


def rig_poses(points: PointSets, rig: Rig, assignments: Integers) -> list[Pose | None]:
    """The most likely pose of a rig for each assignment: (K, C n) of sightings, or (K, n) with one of each point."""
    image, sightings = list_sightings(rig, points)
    if assignments.shape[1] == len(sightings.source):
        return [rig_pose(image, sightings, assignment) for assignment in assignments]
    found = []
    for assignment in assignments:
        whole = np.full((len(rig.views), image.count), -1, np.int64)
        members = np.flatnonzero(assignment >= 0)
        whole[image.camera_of[assignment[members]], members] = assignment[members]
        pose = rig_pose(image, sightings, whole.ravel())
        if pose is not None and pose.points is not None and pose.inliers is not None:
            pose = replace(pose, points=pose.points % image.count, inliers=pose.inliers % image.count)
        found.append(pose)
    return found


def _starts(image: RigImage, places: Floats, points: PointSets, assignment: Integers) -> State:
    """Poses (S, 3, 3) and (S, 3) to start from: of the camera that has most matches, none if those are too few."""
    by_camera = assignment.reshape(-1, image.count)
    k = int((by_camera >= 0).sum(axis=1).argmax())
    (matched,) = np.nonzero(by_camera[k] >= 0)
    if len(matched) < MINIMUM:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    camera, detections = image.rig.cameras[k], by_camera[k, matched]
    own, pixels = places[None, matched], points.target[None, detections] - image.offsets[k]
    weight = 1.0 / points.target_noise[None, detections]
    starts = starting_poses(own, camera.bearings(pixels[0])[None], weight, upright=None)
    alone = ProjectionModel(own, pixels, weight, camera, np.eye(3)).repeated(starts[0].shape[1])
    (rotation,), (translation,) = select_best_apart(alone, starts)
    back = image.rig.rotations[k].T
    return back @ rotation, (translation - image.rig.translations[k] / image.unit) @ back.T
