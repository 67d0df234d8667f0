"""Maximum-likelihood motion between two point sets of one space, both noisy, with its covariance."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.rotation import angle_count, turn_jacobian
from rootmatch.arrays import Integers
from rootmatch.problems.points import PointClouds, PointSets
from rootmatch.problems.pose_fit.descent import State, descend, state_covariance
from rootmatch.problems.pose_fit.fitted_pose import make_pose_of_fit
from rootmatch.problems.pose_fit.motion_model import MotionModel, reweight
from rootmatch.problems.pose_fit.point_set_fit import fit_point_sets
from rootmatch.problems.pose_fit.pose import Pose

FLAT = 1e-6
"""Singular value, relative to the largest, below which points lie in a plane, or two on a line. A round value."""


def point_set_pose(points: PointSets, assignment: Integers, *, scaled: bool, mirror: bool = False) -> Pose:
    """The most likely motion of the source points of an assignment (n,) onto their targets.

    Minimises Σ |scale · R x + t − x'|² / (σ'² + scale² σ²), from the motion of `fit_point_sets`. If axes differ in
    noise, deviations are weighted by the inverse of Σ' + scale² R Σ Rᵀ, taken at the motion of the fit before.

    Parameters
    ----------
    points : PointSets
        Both of k = 2 or 3 dimensions.
    assignment : (n,) int array
        −1 where unmatched; at least k matches.
    scaled : bool
        Whether the scale is estimated; 1 otherwise.
    mirror : bool
        Whether a reflection is possible.
    """
    members = np.flatnonzero(assignment >= 0)
    source, target = points.source[members], points.target[assignment[members]]
    variance, variance2 = points.source_noise[members] ** 2, points.target_noise[assignment[members]] ** 2
    centre = source.mean(axis=0)
    source = source - centre
    # points in a plane fit a rotation as well as its reflection, which is then not meant
    values = np.linalg.svd(source, compute_uv=False)
    solid = bool(values[-1] > FLAT * values[0])
    clouds = PointClouds(source, target, variance, variance2, scaled=scaled, mirror=mirror and solid)
    start = fit_point_sets(clouds, np.arange(len(members))[None], clouds.mirror)
    model = MotionModel(source, target, variance, variance2, scaled)
    state: State = start.rotation, start.shift, np.log(start.scale)
    if scaled:
        state, _ = descend(model, state)
    if points.has_covariances:
        known = points.source_covariance, points.target_covariance
        of_source, of_target = (
            None if own is None else own[some] for own, some in zip(known, (members, assignment[members]), strict=True)
        )
        clouds = clouds._replace(source_covariance=of_source, target_covariance=of_target)
        model, state = reweight(model, state, clouds, np.arange(len(members))[None])
    (rotation,), (translation,), (log,) = state
    scale, size = float(np.exp(log)), source.shape[1]
    turned = scale * rotation @ centre
    local = state_covariance(model, state)[0]
    change, angles = np.eye(len(local)), angle_count(size)
    shifts = slice(angles, angles + size)
    # t = t' − s R c
    change[shifts, :angles] = -turn_jacobian(turned)
    if scaled:
        change[shifts, -1], change[-1, -1] = -turned, scale
    off = model.residuals(state)[0]
    predicted = scale * source @ rotation.T + translation
    return make_pose_of_fit(
        rotation,
        translation - turned,
        change @ local @ change.T,
        chi2=float((off**2).sum()),
        dof=size * len(members) - len(local),
        points=members,
        predicted=predicted,
        residuals=np.linalg.norm(target - predicted, axis=1),
        sigma=np.sqrt(variance2 + scale**2 * variance),
        scale=scale if scaled else 1.0,
    )
