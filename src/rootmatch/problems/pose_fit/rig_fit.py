"""Poses of a rig of cameras: one body seen by several, each point perhaps by more than one.

Every camera has a copy of every point, so that the image of a copy has one place. The copies of all cameras share one
pose, and are fitted as the points of one camera are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.rig import Rig
from rootmatch.errors import InputError
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.base import Floats
from rootmatch.problems.pose_fit.descent import State, covariance_of, descended, lowest_of
from rootmatch.problems.pose_fit.fitted_pose import fitted_pose
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.prior import Prior
from rootmatch.problems.pose_fit.projection_model import ProjectionModel, whitening
from rootmatch.problems.pose_fit.starts import best_apart, starting_poses

Integers = NDArray[np.int64]

STEPS = 20
"""Maximum number of steps of a descent from the pose of one camera; five are usual. Not tuned."""
REWEIGHTED = 2
"""As `rootmatch.problems.pose_fit.camera_pose.REWEIGHTED`."""
LEAST = 4
"""Matches within one camera from which a fit can start: with three there are several poses."""


@dataclass(frozen=True, eq=False)
class Copies(CameraModel):
    """A rig as one camera of the copies (C n) of n points: those of the first camera first.

    Attributes
    ----------
    rig : Rig
    points : (n, 3) array
        In their own frame and unit.
    offsets : (C, 2) array
        Where each camera's image lies in the common plane.
    owner : (n',) int array
        Camera of each detection.
    """

    rig: Rig
    points: Floats
    offsets: Floats
    owner: Integers

    @cached_property
    def centre(self) -> Floats:
        """Mean (3,) of the points."""
        return np.asarray(self.points.mean(axis=0))

    @cached_property
    def unit(self) -> float:
        """Root mean square distance of the points from it, per coordinate: the unit of the fits."""
        return float(np.sqrt(((self.points - self.centre) ** 2).mean()))

    @cached_property
    def places(self) -> Floats:
        """The copies (C n, 3), about their centre and in that unit."""
        return np.tile((self.points - self.centre) / self.unit, (len(self.offsets), 1))

    @property
    def count(self) -> int:
        """Number of points, n."""
        return len(self.points)

    @property
    def dimension(self) -> int:
        """Pixels of the common plane."""
        return 2

    @property
    def focal(self) -> float:
        """Mean focal length."""
        return self.rig.focal

    def bearings(self, pixels: ArrayLike) -> Floats:
        """Unknown without the camera.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError("rig: give the camera of each pixel")

    def axes(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """Refused, as `bearings` is."""
        return self.bearings(pixels), self.bearings(pixels)

    def of_camera(self, positions: Floats, k: int) -> Floats:
        """Copies (…, C n, 3) of the rig's frame that belong to camera k, in its frame, (…, n, 3)."""
        own = positions[..., k * self.count : (k + 1) * self.count, :]
        return np.asarray(own @ self.rig.rotations[k].T + self.rig.translations[k] / self.unit)

    def project(self, points: ArrayLike) -> Floats:
        """Pixels (…, C n, 2) of copies (…, C n, 3)."""
        positions = np.asarray(points, dtype=float)
        parts = [
            camera.project(self.of_camera(positions, k)) + self.offsets[k] for k, camera in enumerate(self.rig.cameras)
        ]
        return np.concatenate(parts, axis=-2)

    def sees(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether each copy (…, C n, 3) is seen by its camera."""
        positions = np.asarray(points, dtype=float)
        parts = [camera.sees(self.of_camera(positions, k)) for k, camera in enumerate(self.rig.cameras)]
        return np.concatenate(parts, axis=-1)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives (…, C n, 2, 3) of their pixels by the copies (…, C n, 3)."""
        positions = np.asarray(points, dtype=float)
        parts = [
            camera.jacobian(self.of_camera(positions, k)) @ self.rig.rotations[k]
            for k, camera in enumerate(self.rig.cameras)
        ]
        return np.concatenate(parts, axis=-3)

    def from_centre(self, points: Floats) -> Floats:
        """Copies (…, C n, 3), each as from the centre of its own camera."""
        return points - np.repeat(self.rig.centres / self.unit, self.count, axis=0)

    def in_image(self, pixels: Floats) -> Floats:
        """How far the pixels (…, C n, 2) of copies are expected in the images of their cameras."""
        parts = np.split(pixels, len(self.offsets), axis=-2)
        return np.concatenate([self.rig.expects(k, own - self.offsets[k]) for k, own in enumerate(parts)], axis=-1)

    def image_areas(self, target: Floats) -> Floats | None:
        """See `CameraModel.image_areas`: by the cameras' sizes where those are given."""
        if self.rig.sizes is not None:
            return np.asarray(np.prod(self.rig.sizes, axis=1), np.float64)
        every = [
            camera.image_areas(target[own] - offset)
            for camera, own, offset in zip(self.rig.cameras, self.images(), self.offsets, strict=True)
        ]
        known = [one for one in every if one is not None]
        return np.concatenate(known) if len(known) == len(every) else None

    def images(self) -> list[Integers]:
        """The detections of each camera."""
        return [np.flatnonzero(self.owner == k) for k in range(len(self.offsets))]


@dataclass(frozen=True, eq=False)
class CopiesAsGiven(Copies):
    """Copies in the caller's frame and unit."""

    @cached_property
    def unit(self) -> float:
        """The unit of the caller."""
        return 1.0


def rig_pose(
    copies: Copies, points: PointSets, assignment: Integers, prior: Pose | None = None, start: Pose | None = None
) -> Pose | None:
    """The most likely pose of the rig for one assignment of copies (C n,), None if there is none.

    ``points``: the copies and their detections in the common plane, with their noise.
    It is fitted from ``start``, from the prediction, or from the pose of the camera that has most matches.
    Its `points` are indices of copies: camera · n + point. With a predicted pose, which is part of the fit, three
    matches in all are enough.
    """
    used, target, sigma = assignment >= 0, points.target, points.target_noise
    weight = np.where(used, 1.0 / sigma[np.maximum(assignment, 0)], 0.0)[None]
    image = target[np.maximum(assignment, 0)][None]
    gaussian = None if prior is None else Prior.of(prior, copies.centre, copies.unit)
    model = ProjectionModel(copies.places[None], image, weight, copies, np.eye(3), prior=gaussian)
    first: State
    if start is not None:
        first = start.R[None], ((start.t + start.R @ copies.centre) / copies.unit)[None]
    elif gaussian is not None:
        first = gaussian.rotation[None], gaussian.translation[None]
    else:
        first = _starts(copies, points, assignment)
    if not len(first[0]):  # too few matches in each camera
        return None
    state, chi2 = descended(model.repeated(len(first[0])), first, STEPS)
    if not np.isfinite(chi2).any():
        return None
    state, chi2 = lowest_of(state, chi2, 1)
    if points.source_covariance is not None:
        known = points.source_covariance[None] / copies.unit**2
        alone = np.where(used, 1.0 / points.detection_noise[np.maximum(assignment, 0)], 0.0)[None]
        for _ in range(REWEIGHTED):
            white = whitening(copies, copies.places[None], known, alone, state, images=len(copies.offsets))
            model = replace(model, white=white)
            state, chi2 = descended(model, state, STEPS)
    covariance = covariance_of(model, state)[0]
    rotation, translation = state[0][0], state[1][0]
    turned = rotation @ copies.centre
    change = np.zeros((6, 6))
    change[:3, :3], change[3:, 3:] = np.eye(3), copies.unit * np.eye(3)
    change[3:, :3] = cross_matrix(turned)  # t = u t' − R c, so τ = u τ' − ω × R c
    members = np.flatnonzero(used)
    detections = assignment[members]
    with np.errstate(all="ignore"):
        predicted = copies.project(copies.places @ rotation.T + translation)[members]
    return fitted_pose(
        rotation,
        copies.unit * translation - turned,
        change @ covariance @ change.T,
        chi2=float(chi2[0]),
        dof=2 * len(members) - (6 if gaussian is None else 0),
        points=members,
        predicted=predicted - copies.offsets[copies.owner[detections]],
        residuals=np.linalg.norm(predicted - target[detections], axis=1),
        sigma=sigma[detections],
    )


def rig_poses(points: PointSets, rig: Rig, assignments: Integers) -> list[Pose | None]:
    """The most likely pose of a rig for each assignment (K, n), of one sighting of each point."""
    rows, cameras = points.target, len(rig.views)
    owner = rows[:, 2].astype(np.int64)
    copies = Copies(rig, points.source, rig.offsets(rows), owner)
    covariance = points.source_covariance
    plane = replace(
        points,
        target=rig.chart(rows, points.target_noise)[1],
        source_covariance=None if covariance is None else np.tile(covariance, (cameras, 1, 1)),
    )
    found = []
    for assignment in assignments:
        whole = np.full((cameras, copies.count), -1, np.int64)
        members = np.flatnonzero(assignment >= 0)
        whole[owner[assignment[members]], members] = assignment[members]
        pose = rig_pose(copies, plane, whole.ravel())
        if pose is not None and pose.points is not None and pose.inliers is not None:
            pose = replace(pose, points=pose.points % copies.count, inliers=pose.inliers % copies.count)
        found.append(pose)
    return found


def _starts(copies: Copies, points: PointSets, assignment: Integers) -> State:
    """Poses (S, 3, 3) and (S, 3) to start from: of the camera that has most matches, none if those are too few."""
    by_camera = assignment.reshape(-1, copies.count)
    k = int((by_camera >= 0).sum(axis=1).argmax())
    (matched,) = np.nonzero(by_camera[k] >= 0)
    if len(matched) < LEAST:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    camera, detections = copies.rig.cameras[k], by_camera[k, matched]
    places, image = copies.places[None, matched], points.target[None, detections] - copies.offsets[k]
    weight = 1.0 / points.target_noise[None, detections]
    starts = starting_poses(places, camera.bearings(image[0])[None], weight, upright=None)
    alone = ProjectionModel(places, image, weight, camera, np.eye(3)).repeated(starts[0].shape[1])
    (rotation,), (translation,) = best_apart(alone, starts)
    back = copies.rig.rotations[k].T
    return back @ rotation, (translation - copies.rig.translations[k] / copies.unit) @ back.T
