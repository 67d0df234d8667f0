"""Calibrations that are known to standard deviations: what their errors do to a pose, by dense linear algebra."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import rootmatch as rm
from instances import random_rotation
from rootmatch.cameras.calibration_errors import calibration_jacobian
from rootmatch.cameras.rig_image import RigImage
from rootmatch.explain import imaged_calibration
from rootmatch.explain.image_decision import assess_image
from rootmatch.explain.imaged_calibration import ImagedCalibration
from rootmatch.explain.sampling import sample
from rootmatch.io.calibrations.native import camera_entry, camera_from_entry

Floats = NDArray[np.float64]
SIGMA, STEP, PARAMETERS = 0.25, 1e-5, 9
BODY = np.random.default_rng(12).uniform(-0.2, 0.2, (10, 3))
PINHOLE = rm.Camera(900.0, 900.0, 640.0, 480.0, focal_noise=1.8, centre_noise=0.5)
LENS = replace(rm.Camera.from_opencv(PINHOLE.matrix, [-0.1, 0.02, 0.0, 0.0]), focal_noise=1.8, centre_noise=0.5)
TURNS = [Rotation.from_euler("yx", [90.0 * k, -25.0], degrees=True).as_matrix() for k in range(4)]
HAND_HELD = rm.Camera(2400.0, 2400.0, 2000.0, 1500.0, size=(4000, 3000), focal_noise=48.0)
NOISE: dict[str, Any] = {"rotation_noise": [0.0, 1e-3, 1e-3, 2e-3], "position_noise": 1e-3}
RIG = rm.Rig([(LENS, turn, (0.0, 0.0, 4.0)) for turn in TURNS], sizes=[(1280, 960)] * 4, **NOISE)
EXACT = rm.Rig([(replace(LENS, focal_noise=0.0, centre_noise=0.0), R, t) for _, R, t in RIG.views], RIG.sizes)


def off_camera(camera: rm.Camera, error: Floats) -> rm.Camera:
    """A camera with errors (3,) of its focal length and principal point, in units of their deviations."""
    zoom = 1.0 + error[0] * camera.focal_noise / camera.focal
    cx, cy = np.array([camera.cx, camera.cy]) + error[1:] * camera.centre_noise
    return replace(camera, fx=zoom * camera.fx, fy=zoom * camera.fy, cx=float(cx), cy=float(cy))


def off_rig(rig: rm.Rig, errors: Floats) -> rm.Rig:
    """A rig with errors (C, 9): of each camera, of its rotation, and of its place."""
    views = []
    for k, (error, (camera, R, t)) in enumerate(zip(errors.reshape(-1, PARAMETERS), rig.views, strict=True)):
        assert isinstance(camera, rm.Camera)
        turn = Rotation.from_rotvec(rig.rotation_noise[k] * error[3:6]).as_matrix()
        moved = turn @ np.array(t) + rig.position_noise[k] * error[6:]
        views.append((off_camera(camera, error[:3]), turn @ np.array(R), moved))
    return rig.with_views(views)


def images(rig: rm.Rig, pose: tuple[Floats, Floats]) -> Floats:
    """Pixels (C n, 2) of the body."""
    R, t = pose
    return np.concatenate(
        [camera.project((BODY @ R.T + t) @ np.array(Q).T + np.array(s)) for camera, Q, s in rig.views]
    )


def central_differences(function: Any, size: int) -> Floats:
    """Derivatives (m, size) of a function of (size,) numbers about 0."""
    return np.stack([(function(h) - function(-h)).ravel() / (2.0 * STEP) for h in STEP * np.eye(size)], axis=1)


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
def test_what_errors_do_to_pixels_of_a_camera(camera: rm.Camera) -> None:
    points = BODY + np.array([0.1, 0.2, 1.0])
    dense = central_differences(lambda error: off_camera(camera, error).project(points), 3)
    np.testing.assert_allclose(calibration_jacobian(camera, points).reshape(-1, 3), dense, atol=1e-6)


def test_what_errors_do_to_pixels_of_a_rig() -> None:
    rng = np.random.default_rng(0)
    pose = random_rotation(rng), rng.uniform(-0.3, 0.3, 3)
    image = RigImage(RIG, len(BODY), np.zeros((4, 2)), np.zeros(0, np.int64))
    found = calibration_jacobian(image, np.tile(BODY @ pose[0].T + pose[1], (4, 1)))
    dense = central_differences(lambda errors: images(off_rig(RIG, errors), pose), 4 * PARAMETERS)
    moving = np.abs(dense).sum(axis=0) > 0.0  # the first camera does not turn
    np.testing.assert_allclose(found.reshape(-1, found.shape[2]), dense[:, moving], atol=1e-5)


def test_the_covariance_of_a_pose_is_that_of_dense_linear_algebra() -> None:
    rng = np.random.default_rng(1)
    pose = random_rotation(rng), rng.uniform(-0.3, 0.3, 3)
    pixels = images(off_rig(RIG, rng.normal(size=4 * PARAMETERS)), pose) + rng.normal(0.0, SIGMA, (40, 2))
    seen = np.sort(rng.permutation(40)[:30])
    match = rm.match(BODY, (pixels[seen], seen // 10), rm.P3P(RIG), noise=SIGMA)
    assert match
    assert match.sightings is not None
    rows = match.sightings.assignment.ravel()
    used = np.flatnonzero(rows >= 0)
    np.testing.assert_array_equal(seen[rows[used]], used)
    told, taken = match.pose, match.task.calibration_noise
    assert told is not None
    assert taken is not None

    def of_pose(step: Floats) -> Floats:
        return images(RIG, (Rotation.from_rotvec(step[:3]).as_matrix() @ told.R, told.t + step[3:]))[used]

    by_pose = central_differences(of_pose, 6)
    by_errors = central_differences(lambda errors: images(off_rig(RIG, errors), (told.R, told.t))[used], 36)
    weight = 1.0 / (SIGMA**2 + np.repeat(taken[rows[used]], 2) ** 2)
    gain = np.linalg.solve((by_pose.T * weight) @ by_pose, by_pose.T * weight)
    whole = SIGMA**2 * np.eye(2 * len(used)) + by_errors @ by_errors.T
    np.testing.assert_allclose(told.covariance, gain @ whole @ gain.T, rtol=1e-4, atol=1e-12)
    best = np.linalg.inv(by_pose.T @ np.linalg.solve(whole, by_pose))  # of a fit that knows what is shared
    assert 0.4 * np.trace(told.covariance[3:, 3:]) < np.trace(best[3:, 3:]) < np.trace(told.covariance[3:, 3:])


def test_detections_are_as_noisy_as_a_pose_leaves_them() -> None:
    rng = np.random.default_rng(2)
    pixels = images(RIG, (np.eye(3), np.zeros(3)))

    def of_pose(step: Floats) -> Floats:
        return images(RIG, (Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]))

    by_pose = central_differences(of_pose, 6)
    drawn = [images(off_rig(RIG, rng.normal(size=36)), (np.eye(3), np.zeros(3))) - pixels for _ in range(400)]
    offsets = np.reshape(drawn, (400, -1)).T
    left = offsets - by_pose @ np.linalg.lstsq(by_pose, offsets)[0]
    expected = np.sqrt((left.reshape(4, -1) ** 2).mean(axis=1))
    match = rm.match(BODY, (pixels, np.repeat(range(4), 10)), rm.P3P(RIG), noise=SIGMA)
    np.testing.assert_allclose(match.task.calibration_noise, np.repeat(expected, 10), rtol=0.1)
    np.testing.assert_allclose(match.task.points.target_noise, np.hypot(SIGMA, match.task.calibration_noise))


def test_a_pose_takes_up_the_errors_of_one_camera_but_for_what_a_vertical_forbids() -> None:
    pixels = PINHOLE.project(BODY + np.array([0.0, 0.0, 0.5]))
    free = rm.match(BODY, pixels, rm.P3P(PINHOLE), noise=SIGMA).task.calibration_noise
    upright = rm.match(BODY, pixels, rm.UP2P(PINHOLE, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)), noise=SIGMA)
    taken = upright.task.calibration_noise
    assert free is not None
    assert taken is not None
    assert free.max() < taken.min() < 0.5


@pytest.mark.parametrize("upright", [False, True])
def test_poses_of_one_camera_are_within_what_is_told(upright: bool) -> None:
    within, count, freedom = 0, 60, 4 if upright else 6
    for seed in range(count):
        rng = np.random.default_rng([seed, 4])
        R, t = random_rotation(rng), rng.uniform((-0.4, -0.3, 0.8), (0.4, 0.3, 2.0))
        pixels = off_camera(PINHOLE, rng.normal(size=3)).project(BODY @ R.T + t) + rng.normal(0.0, SIGMA, (10, 2))
        problem = rm.UP2P(PINHOLE, R[:, 1], (0.0, 1.0, 0.0)) if upright else rm.P3P(PINHOLE)
        pose = rm.match(BODY, pixels, problem, noise=SIGMA).pose
        assert pose is not None
        assert pose.covariance is not None
        assert pose.residuals is not None
        error = np.concatenate([Rotation.from_matrix(R @ pose.R.T).as_rotvec(), t - pose.t])
        size = np.sqrt(np.diagonal(pose.covariance))
        values, axes = np.linalg.eigh(pose.covariance / np.outer(size, size))
        squared = ((axes.T @ (error / size))[-freedom:] ** 2 / values[-freedom:]).sum()
        within += bool(squared <= chi2.ppf(0.95, freedom))
    assert within >= 0.87 * count  # a few in two hundred would be fewer by chance


def test_frames_do_not_average_a_calibration_out() -> None:
    rng = np.random.default_rng(3)
    pose = random_rotation(rng), rng.uniform(-0.3, 0.3, 3)
    truth = images(off_rig(RIG, rng.normal(size=36)), pose)
    told = {}
    for name, rig in (("exact", EXACT), ("stated", RIG)):
        tracker, sizes = rm.Tracker(BODY, rm.P3P(rig), noise=1.0), []
        for k in range(30):
            pixels = truth + rng.normal(0.0, SIGMA, truth.shape)
            match = tracker.update((pixels, np.repeat(range(4), 10)), time=k / 2000.0)
            assert match.fused_pose is not None or k == 0
            sizes.append((match.fused_pose or match.pose).tre(BODY).rms.mean())  # type: ignore[union-attr]
        told[name] = sizes[-1] / sizes[0]
    assert told["exact"] < 0.8
    assert 0.9 < told["stated"] < 1.05


def test_no_statement_changes_nothing() -> None:
    pixels = images(RIG, (np.eye(3), np.zeros(3))), np.repeat(range(4), 10)
    match = rm.match(BODY, pixels, rm.P3P(EXACT), noise=SIGMA)
    assert match.task.calibration_noise is None
    assert match.task.points.noise_alone is None


def test_what_is_no_standard_deviation_is_refused() -> None:
    with pytest.raises(rm.InputError, match="camera: focal_noise is -1; give a standard deviation in pixels"):
        rm.Camera(900.0, 900.0, 640.0, 480.0, focal_noise=-1)
    with pytest.raises(rm.InputError, match="rig: rotation_noise is 'a'; give a standard deviation in radians"):
        rm.Rig(RIG.views, rotation_noise="a")
    with pytest.raises(rm.InputError, match="rig: 3 of position_noise given; give one number, or one for each of 4"):
        rm.Rig(RIG.views, position_noise=[0.1, 0.1, 0.1])
    with pytest.warns(rm.InputWarning, match="degrees for radians"):
        rm.Rig(RIG.views, rotation_noise=0.5)
    with pytest.raises(rm.InputError, match="its calibration is not exact, which planar does not allow for"):
        rm.match(99.0 * BODY[:, :2], 99.0 * BODY[:, :2], rm.PlanarMotion(PINHOLE, axis=(0, 1, 0)))


def test_a_camera_file_keeps_what_is_stated() -> None:
    from pathlib import Path

    for camera in (PINHOLE, RIG):
        assert camera_from_entry(Path("camera.json"), camera_entry(camera), ()) == camera


def room(seed: int, off: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Points of a room 8 m wide, their pixels in shuffled order by a focal length that is off, and whose each is."""
    rng = np.random.default_rng([seed, 31])
    points = rng.uniform((-4.0, -2.0, -2.0), (4.0, 2.0, 2.0), (20, 3))
    turn = Rotation.from_euler("yx", rng.uniform(-15.0, 15.0, 2), degrees=True).as_matrix()
    pixels = off_camera(HAND_HELD, np.array([off, 0.0, 0.0])).project(points @ turn.T + (0.0, 0.0, 7.5))
    order = rng.permutation(20)
    strays = rng.uniform((0.0, 0.0), (4000.0, 3000.0), (5, 2))
    return points, np.vstack([(pixels + rng.normal(0.0, 0.3, pixels.shape))[order], strays]), np.argsort(order)


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_focal_length_that_is_off_by_what_was_stated_is_no_larger_noise(seed: int) -> None:
    points, target, truth = room(seed, off=[-1.0, 1.5, -0.5, 1.0][seed - 1])
    match = rm.match(points, target, rm.P3P(HAND_HELD), noise=0.3)
    assert match
    np.testing.assert_array_equal(match.assignment, truth)
    assert match.noise_factor is not None
    assert 0.6 < match.noise_factor < 1.4
    assert match.task.problem.camera == HAND_HELD  # of which the pose is told, with all of its errors
    unstated = rm.match(points, target, rm.P3P(replace(HAND_HELD, focal_noise=0.0)), noise=0.3)
    assert unstated.noise_factor is not None
    assert unstated.noise_factor > 1.3 * match.noise_factor


def test_an_image_tells_the_errors_of_its_camera_as_dense_least_squares_do() -> None:
    points, target, truth = room(0, off=1.0)
    found = rm.match(points, target, rm.P3P(HAND_HELD), noise=0.3).finding
    first = assess_image(found.task, sample(found.task))
    told = ImagedCalibration.of(first)
    assert told is not None
    used = np.flatnonzero(first.assignment >= 0)
    np.testing.assert_array_equal(first.assignment[used], truth[used])
    assert first.pose is not None

    def deviations(values: Floats) -> Floats:
        moved = points[used] @ (Rotation.from_rotvec(values[:3]).as_matrix() @ first.pose.R).T + values[3:6]
        off = off_camera(HAND_HELD, np.array([values[6], 0.0, 0.0])).project(moved) - target[truth[used]]
        return np.append(off.ravel() / 0.3, values[6])

    best = least_squares(deviations, np.array([0.0, 0.0, 0.0, *first.pose.t, 0.0]), x_scale="jac")
    assert told.task.problem.camera.focal == pytest.approx(2400.0 + 48.0 * best.x[6], abs=0.05)  # type: ignore[attr-defined]
    variance = np.linalg.inv(best.jac.T @ best.jac)[6, 6]
    assert told.log_cost == pytest.approx(0.5 * (best.x[6] ** 2 - np.log(variance)), rel=0.01)


def test_a_calibration_that_contradicts_what_was_stated_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    points, target, _ = room(0, off=1.0)
    found = rm.match(points, target, rm.P3P(HAND_HELD), noise=0.3).finding
    first = assess_image(found.task, sample(found.task))
    assert ImagedCalibration.of(first) is not None
    monkeypatch.setattr(imaged_calibration, "STATED", 0.5)
    assert ImagedCalibration.of(first) is None
