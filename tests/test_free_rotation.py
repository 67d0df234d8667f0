"""Poses that are free to turn about a line of points: what is told of them, and what a filter keeps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

import oracles
from rootmatch.algebra.rotation import arc_motion, move_along_arc
from rootmatch.cameras.pinhole import Camera
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.mode_search import find_modes
from rootmatch.model.modes import empty_changes_each
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.proposals import Proposals
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.prior_residuals import Prior
from rootmatch.problems.pose_fit.reference_point import add_arc_curvature, pose_about_point
from rootmatch.tracking.averaged_pose import average_pose
from rootmatch.tracking.motion_filter import MotionFilter, MotionOptions


def free_about(axis: tuple[float, ...], arm: tuple[float, ...], sigma: float) -> np.ndarray:
    """Covariance of a pose whose position is an arm away from a line about which it is free to turn."""
    line = sigma * np.concatenate([axis, np.cross(axis, arm)])
    return np.outer(line, line) + 1e-4 * np.eye(6)


def test_a_covariance_has_the_arc_of_what_turns() -> None:
    """The square of how far an arc of 2 m leaves its tangent, as turns that are drawn have it."""
    sigma, arm = 0.2, np.array([2.0, 0.0, 0.0])
    told = add_arc_curvature(free_about((0.0, 0.0, 1.0), tuple(arm), sigma))
    angles = np.random.default_rng(1).normal(0.0, sigma, 100_000)
    moved = Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0]).apply(arm) - arm
    expected = moved.T @ moved / len(angles) + 1e-4 * np.eye(3)
    np.testing.assert_allclose(np.diag(told)[3:], np.diag(expected), rtol=0.1)
    sure = free_about((0.0, 0.0, 1.0), tuple(arm), 0.001) / 100.0
    assert add_arc_curvature(sure) is sure


def test_motions_along_arcs() -> None:
    rng = np.random.default_rng(3)
    turns, along = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    turns[:3] *= 1e-7
    np.testing.assert_allclose(arc_motion(turns, move_along_arc(turns, along)), along, atol=1e-9)


@pytest.mark.parametrize("angle", [-1.2, -0.3, 0.5, 1.5])
def test_a_prediction_is_as_wide_along_an_arc_as_along_its_tangent(angle: float) -> None:
    """A body turned about a line about which it is free to turn, by 1.2 rad as by .3: what was known is the angle."""
    axis, arm, sigma = np.array([0.0, 0.6, 0.8]), np.array([0.5, 0.4, -0.3]), 0.3
    line = np.concatenate([axis, np.cross(axis, arm)])
    covariance = sigma**2 * np.outer(line, line) + 1e-4 * np.eye(6)
    R, place = Rotation.from_rotvec([0.3, -0.8, 0.2]).as_matrix(), np.array([0.1, 0.2, 3.0])
    turn = Rotation.from_rotvec(angle * axis).as_matrix()
    turned, moved = turn @ R, place - arm + turn @ arm
    terms = Gaussian(R, place, covariance).terms(turned[None], moved[None])
    np.testing.assert_allclose(terms.squared, (angle / sigma) ** 2, rtol=0.01)
    told, both = np.linalg.inv(terms.precision[0]), np.kron(np.eye(2), turn)
    assert 0.95 < 1.0 / ((both @ line) @ terms.precision[0] @ both @ line) / sigma**2 < 1.1
    for one in (covariance, both @ covariance @ both.T):  # it is no narrower than with axes of either kind
        assert eigh(told, one, eigvals_only=True)[0] > 2.0 * np.sqrt(2.0) - 2.0 - 1e-3
    fit = Prior.of(Pose(R, place, covariance), np.zeros(3), 1.0, Pose(turned, moved))
    residuals = fit.residuals(turned[None], moved[None])
    np.testing.assert_allclose((residuals**2).sum(), (angle / sigma) ** 2, rtol=1e-3)


def test_an_average_leaves_a_rotation_that_no_detection_tells() -> None:
    """Six points on a line, to which a prediction is turned as far as .4 rad."""
    rng, sigma = np.random.default_rng(4), 0.4
    points = np.outer(np.linspace(-0.1, 0.1, 6), [0.8, 0.6, 0.0])
    points = np.concatenate([points, rng.normal([0.0, 0.0, 0.08], 0.05, (6, 3))])
    centre, position, R = points.mean(axis=0), np.array([0.02, -0.01, 0.6]), np.eye(3)
    camera = Camera(620.0, 620.0, 640.0, 512.0)
    target = camera.project(points[:6] - centre + position) + rng.normal(0.0, 0.3, (6, 2))
    line = sigma * np.concatenate([[0.8, 0.6, 0.0], np.cross([0.8, 0.6, 0.0], centre)])
    covariance = np.outer(line, line) + np.diag([0.02] * 3 + [0.004] * 3) ** 2
    model = DetectionModel(camera, points, target, np.full(6, 0.3), rate=0.9, prior=Gaussian(R, position, covariance))
    assignment = np.where(np.arange(12) < 6, np.arange(12), -1)
    modes = find_modes(model, Proposals(assignment[None], R[None], position[None]))
    pose = average_pose(model, modes._replace(near=empty_changes_each(len(modes.near), 12)), 0)
    axis = modes.rotation[0] @ line[:3] / sigma
    assert pose.covariance is not None
    assert 0.9 < axis @ pose.covariance[:3, :3] @ axis / sigma**2 < 1.3


@pytest.mark.parametrize("seed", range(4))
def test_an_average_leaves_what_first_order_tells_well(seed: int) -> None:
    """Four points of a bar, whose tilt and distance are as uncertain as its turn about itself: as its fit says."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([np.linspace(-0.2, 0.2, 4), rng.normal(0.0, 0.015, (4, 2))])
    R, position = Rotation.from_euler("y", 0.45).as_matrix(), np.array([0.2, -0.1, 3.5])
    camera = Camera(1000.0, 1000.0, 640.0, 512.0)
    target = camera.project((points - points.mean(axis=0)) @ R.T + position) + rng.normal(0.0, 0.3, (4, 2))
    prior = Gaussian(R, position, np.diag([0.06] * 3 + [0.2] * 3) ** 2)
    model = DetectionModel(camera, points, target, np.full(4, 0.3), rate=0.9, prior=prior)
    modes = find_modes(model, Proposals(np.arange(4)[None], R[None], position[None]))
    pose = average_pose(model, modes._replace(near=empty_changes_each(len(modes.near), 4)), 0)
    assert pose.covariance is not None
    _, averaged = pose_about_point(pose.R, pose.t, pose.covariance, model.centre)
    fitted = modes.covariance[0]
    values, vectors = np.linalg.eigh(fitted / np.outer([1.0] * 3 + [3.5] * 3, [1.0] * 3 + [3.5] * 3))
    assert values[-2] > 0.02**2, "two directions are averaged over"
    weak = np.array([1.0] * 3 + [1.0 / 3.5] * 3)[:, None] * vectors[:, -2:]
    ratio = np.diag(weak.T @ averaged @ weak) / values[-2:]
    assert (ratio > 0.9).all()
    assert (ratio < 1.8).all()


def test_a_frame_that_tells_nothing_of_a_rotation_narrows_no_motion() -> None:
    """A fit that tilts a body by what was seen, and leaves its rotation about a line as open as it was."""
    before = free_about((0.0, 0.6, 0.8), (0.3, 0.1, 0.0), 0.5)
    source = np.random.default_rng(2).normal(size=(8, 3)) * 0.1
    source -= source.mean(axis=0)
    options = MotionOptions(min_scale=1.0, max_scale=1.0)
    moving = MotionFilter(source, Pose.unchecked(np.eye(3), np.array([0.0, 0.0, 2.0]), before), 0.0, options)
    expected, P = moving.predicted(0.1), moving._at(0.1)[3]
    tilt = Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix()
    whole = np.kron(np.eye(6), tilt)
    told = oracles.in_either_axes(P, whole @ P @ whole.T)
    moving.update(Pose.unchecked(tilt @ expected.R, expected.t, told[:6, :6]), 0.1)
    np.testing.assert_allclose(moving.P, told, rtol=1e-6, atol=1e-6 * P.max())
