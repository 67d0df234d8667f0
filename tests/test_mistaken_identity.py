"""A tracker that follows something else than the body leaves it when the body is in view again."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.goodness_of_fit import SHAPE, Misfit
from rootmatch.frozen import copy_with
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.tracking.followed_pose import FollowedPose, share_misfit_odds
from rootmatch.tracking.mistaken_identity import FLOOR, GIVEN_UP, log_other_presence, update_identity
from rootmatch.tracking.motion_filter import MotionFilter

Floats = NDArray[np.float64]

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
BODY = np.random.default_rng(7).uniform(-0.08, 0.08, (10, 3))
HIDDEN, FRAMES = range(15, 45), 75
"""Frames in which only the reflection is in view; 30 a second."""


def flight(seed: int) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Detections of a body and of its reflection in a wall behind it, and the point of each, −1 in the reflection."""
    rng = np.random.default_rng(seed)
    first, turn = Rotation.random(random_state=rng), rng.normal(0.0, 0.5, 3)
    place, speed = rng.uniform((-0.3, -0.1, 0.9), (0.0, 0.1, 1.1)), rng.normal(0.0, 0.05, 3)
    for k in range(FRAMES):
        R = (Rotation.from_rotvec(turn * k / 30.0) * first).as_matrix()
        here = BODY @ R.T + place + speed * k / 30.0
        there = here * (1.0, 1.0, -1.0) + (0.0, 0.0, 3.0)
        own = np.arange(len(BODY)) if k not in HIDDEN else np.empty(0, np.int64)
        target = CAMERA.project(np.concatenate([here[own], there]))
        owner = np.concatenate([own, np.full(len(there), -1)])
        yield target + rng.normal(0.0, 0.3, target.shape), owner


def test_the_body_is_found_again_beside_its_reflection() -> None:
    """After a second with its reflection alone: of three flights (seeds from 1000) at least 80 % of the last 20."""
    right = wrong = 0
    for seed in range(1000, 1003):
        tracker = rm.Tracker(BODY, rm.P3P(CAMERA), noise=0.3)
        for k, (target, owner) in enumerate(flight(seed)):
            match = tracker.update(target, time=k / 30.0)
            if k < FRAMES - 20:
                continue
            points, detections = match.pairs.T
            good = (owner[detections] == points).all()
            right += bool(match and good)
            wrong += bool(match and not good)
    assert right >= 0.8 * 3 * 20
    assert wrong <= 0.05 * 3 * 20


def test_a_reflection_that_was_given_up_is_not_taken_for_the_body_again() -> None:
    """While it is alone in view, of 4 flights (seeds from 1020) of 30 frames each."""
    trusted = 0
    for seed in range(1020, 1024):
        tracker = rm.Tracker(BODY, rm.P3P(CAMERA), noise=0.3)
        for k, (target, _) in zip(range(HIDDEN.stop), flight(seed), strict=False):
            match = tracker.update(target, time=k / 30.0)
            trusted += bool(match) and k in HIDDEN
    assert trusted <= 0.01 * 4 * len(HIDDEN)


def test_what_is_found_in_the_sight_of_something_else_has_its_odds_for_a_while() -> None:
    covariance = np.diag([1e-3] * 3 + [1e-3] * 3) ** 2
    lost = MotionFilter(BODY, rm.Pose(np.eye(3), (0.0, 0.0, 1.0), covariance), 0.0)
    behind = rm.Pose(Rotation.from_rotvec((0.0, 2.0, 0.0)).as_matrix(), (0.0, 0.0, 1.5))
    assert log_other_presence(lost, behind, 0.0) == pytest.approx(GIVEN_UP, abs=0.01)
    assert log_other_presence(lost, behind, 2.0) == pytest.approx(GIVEN_UP - 2.0, abs=0.01)
    assert log_other_presence(lost, behind, 60.0) == pytest.approx(FLOOR)
    assert log_other_presence(lost, rm.Pose(np.eye(3), (0.5, 0.0, 1.0)), 0.0) == FLOOR


def test_before_a_rig_the_line_of_sight_is_that_of_a_camera_that_sees_what_was_found() -> None:
    """It was that of the rig's origin, which may be amid what the cameras see."""
    covariance = np.diag([1e-3] * 6) ** 2
    lost = MotionFilter(BODY, rm.Pose(np.eye(3), (0.0, 0.0, 1.0), covariance), 0.0)
    centres = np.array([[0.0, 0.0, 3.0], [3.0, 0.0, 1.0]])
    beside = rm.Pose(np.eye(3), (-1.0, 0.0, 1.0), covariance)
    assert log_other_presence(lost, beside, 0.0, centres) == pytest.approx(GIVEN_UP, abs=0.01)
    assert log_other_presence(lost, beside, 0.0, centres[:1]) == FLOOR
    assert log_other_presence(lost, beside, 0.0, None) == FLOOR


def test_frames_repeat_what_is_met_where_it_is_expected() -> None:
    place = FollowedPose(MotionFilter(BODY, rm.Pose(np.eye(3), (0.0, 0.0, 1.0), np.eye(6)), 0.0))
    for frames in range(1000):
        place = copy_with(place, told=place.log_odds_with(lambda: 2.0), frames=frames + 1)
    assert place.told == pytest.approx(2.0, abs=0.01)  # the same in each: no more than one tells
    assert place.log_odds_with(lambda: -20.0) == pytest.approx(place.told, abs=1e-6)
    assert place.log_odds_with(lambda: 20.0) == pytest.approx(np.logaddexp(2.0, 20.0 - np.log(1001 * 1002)), abs=0.01)


def test_frames_are_not_asked_what_they_tell_of_a_place_that_is_certain() -> None:
    place = FollowedPose(MotionFilter(BODY, rm.Pose(np.eye(3), (0.0, 0.0, 1.0), np.eye(6)), 0.0), told=30.0)
    assert place.log_odds_with(lambda: pytest.fail("asked")) == 30.0


def test_frames_that_do_not_fit_are_held_against_a_pose_and_others_for_it() -> None:
    bad, good = Misfit.of(90.0, 14), Misfit.of(10.0, 14)
    odds, count = FLOOR, 0
    while odds < GIVEN_UP:
        odds, count = update_identity(odds, bad, 0.5), count + 1
    assert 3 <= count <= 10
    once = update_identity(FLOOR, bad, 0.5)
    assert once > FLOOR
    for _ in range(20):
        once = update_identity(once, good, 0.5)
    assert once == FLOOR
    assert update_identity(FLOOR, good, 0.5) == FLOOR
    assert update_identity(-1.0, Misfit.of(0.0, 0), 0.5) == -1.0  # three points fit anything


@pytest.mark.parametrize("dof", [2, 14, 60])
def test_residuals_as_they_are_expected_speak_for_the_body(dof: int) -> None:
    """Of frames whose σ is off by as much as is expected, fewer than one in a thousand gives up the body."""
    rng = np.random.default_rng(3)
    given_up, ends = 0, []
    for _ in range(40):
        odds = FLOOR
        for _ in range(100):
            sigma = rng.chisquare(NOISE_FREEDOM) / NOISE_FREEDOM
            odds = update_identity(odds, Misfit.of(rng.chisquare(dof) / sigma, dof), 0.5)
            given_up += odds > GIVEN_UP
        ends.append(odds)
    assert given_up <= 4
    assert np.mean(np.array(ends) < FLOOR + 1.0) > 0.8


@pytest.mark.parametrize(("chi2", "dof"), [(8.0, 14), (25.0, 14), (60.0, 14), (3.0, 2)])
def test_the_odds_are_those_of_two_distributions_of_the_chance(chi2: float, dof: int) -> None:
    """The chance by Student's scale mixture, integrated, and both densities written out."""

    def tail(factor: float) -> float:
        return float(
            stats.gamma.pdf(factor, NOISE_FREEDOM / 2, scale=2 / NOISE_FREEDOM) * stats.chi2.sf(chi2 * factor, dof)
        )

    chance = quad(tail, 0.0, 10.0)[0]
    other = stats.beta.pdf(chance, SHAPE, 1.0)
    expected = math.log(other / (0.999 + 0.001 * other))
    assert update_identity(0.0, Misfit.of(chi2, dof), 1.0) == pytest.approx(max(expected, FLOOR), abs=1e-6)


def inexact_flight(seed: int, off: float, frames: int) -> Iterator[tuple[rm.Tracker, Floats, Floats]]:
    """A tracker of a headset, the detections of each frame, and where the points of its model are to be found.

    ``off``: how far the points of the model are off those of the headset, metres.
    """
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(24, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = normals * (0.1, 0.06, 0.09) + rng.normal(0.0, 0.003, (24, 3))
    body = points + rng.normal(0.0, off, points.shape)
    camera, first, turn = rm.Camera(700.0, 700.0, 640.0, 480.0), Rotation.random(random_state=rng), rng.normal(size=3)
    tracker = rm.Tracker(points, rm.P3P(camera), noise=0.3, normals=normals)
    for k in range(frames):
        R = (Rotation.from_rotvec(turn * np.sin(k / 60.0)) * first).as_matrix()
        there = body @ R.T + (0.0, 0.0, 0.8)
        pixels, distance = camera.project(there), np.linalg.norm(there, axis=1)
        seen = ((normals @ R.T) * -there).sum(axis=1) > np.cos(np.radians(72.0)) * distance
        seen &= rng.random(24) < 0.95
        own = pixels[seen] + rng.normal(0.0, 0.3, (seen.sum(), 2))
        clutter = rng.uniform((0.0, 0.0), (1280.0, 960.0), (rng.poisson(4), 2))
        yield tracker, np.concatenate([own, clutter]), pixels


def test_a_chance_pose_is_not_what_is_left_of_a_body_that_does_not_fit() -> None:
    """A model .6 mm off: the right pose of frame after frame is given up, and what fits four of its points is not.

    Before, a pose that is 150 degrees off was trusted in 14 frames.
    """
    for k, (tracker, target, pixels) in enumerate(inexact_flight(1015, 0.6e-3, 90)):
        match = tracker.update(target, time=k / 60.0)
        points, detections = match.pairs.T
        assert not match or (np.linalg.norm(target[detections] - pixels[points], axis=1) < 5.0).all()


def test_poses_of_a_place_share_the_odds_that_it_is_of_something_else() -> None:
    filter_ = MotionFilter(BODY, rm.Pose(np.eye(3), (0.0, 0.0, 1.0), 1e-6 * np.eye(6)), 0.0)
    lost = FollowedPose(filter_, log_weight=-1.0, log_other=GIVEN_UP + 1.0, place=0)
    beside, elsewhere = (FollowedPose(filter_, log_weight=-4.0, place=place) for place in (0, 1))
    kept = share_misfit_odds([lost, beside, elsewhere], None)
    assert kept[0] is lost
    assert kept[1].log_other == pytest.approx(np.logaddexp(FLOOR, 3.0))
    assert kept[2] is elsewhere
    assert share_misfit_odds([elsewhere], (1, -2.0))[0].log_other == pytest.approx(np.logaddexp(FLOOR, 2.0))
    assert share_misfit_odds([elsewhere], (0, -2.0))[0] is elsewhere
    assert share_misfit_odds([beside, elsewhere], None) == [beside, elsewhere]


def test_points_that_are_off_by_a_per_cent_are_learned() -> None:
    """A model 1 mm off, which is not stated: of the last 40 frames few were trusted before."""
    right = wrong = 0
    for k, (tracker, target, pixels) in enumerate(inexact_flight(1007, 1e-3, 60)):
        match = tracker.update(target, time=k / 60.0)
        points, detections = match.pairs.T
        good = (np.linalg.norm(target[detections] - pixels[points], axis=1) < 5.0).all()
        right += bool(match and good and k >= 20)
        wrong += bool(match and not good)
    assert right >= 36
    assert not wrong
    assert tracker.noise_factor < 1.5  # the noise is as stated


@pytest.mark.parametrize(("off", "trusted"), [(0.0, True), (8e-4, True), (8e-3, False)])
def test_one_image_allows_for_points_that_are_off_by_a_per_cent(off: float, trusted: bool) -> None:
    rng = np.random.default_rng(5)
    body = BODY + rng.normal(0.0, off, BODY.shape)
    pixels = CAMERA.project(body @ Rotation.random(random_state=2).as_matrix().T + (0.0, 0.0, 0.8))
    match = rm.match(BODY, pixels + rng.normal(0.0, 0.3, pixels.shape), rm.P3P(CAMERA), noise=0.3)
    assert bool(match) == trusted
    assert not match or (match.assignment == np.arange(len(BODY))).all()


def test_what_is_reported_of_points_that_are_off_is_by_the_noise_that_was_stated() -> None:
    """Residuals of several σ looked like those of one."""
    rng = np.random.default_rng(5)
    body = BODY + rng.normal(0.0, 8e-4, BODY.shape)
    pixels = CAMERA.project(body @ Rotation.random(random_state=2).as_matrix().T + (0.0, 0.0, 0.8))
    match = rm.match(BODY, pixels + rng.normal(0.0, 0.3, pixels.shape), rm.P3P(CAMERA), noise=0.3)
    pose = match.pose
    assert 2e-4 < match.point_error < 2e-3
    assert f"{match.point_error:.2g} on each axis" in match.advice
    assert pose.chi2 == pytest.approx(((pose.residuals / 0.3) ** 2).sum())
    assert pose.rms_sigma == pytest.approx(math.sqrt(pose.chi2 / pose.dof))
    assert match.noise_factor == pytest.approx(pose.rms_sigma, rel=0.05)
    assert match.noise_factor > 1.5
    stated = rm.match(BODY, match.target, rm.P3P(CAMERA), noise=0.3, source_noise=match.point_error)
    assert np.allclose(stated.pose.covariance, pose.covariance, rtol=0.05)
    assert stated.point_error == 0.0
    assert stated.pose.rms_sigma < 1.5


def test_points_elsewhere_count_for_no_more_than_all_frames_tell_of_them() -> None:
    """Frames repeat what something else has in the place of the points: a body may have them there as well."""
    good, odds = Misfit.of(10.0, 10), FLOOR
    for _ in range(10):
        odds = update_identity(odds, good._replace(another=-2.3), 0.5)
    assert odds == -2.3
    assert update_identity(odds, good, 0.5) < odds
    for _ in range(10):
        odds = update_identity(odds, good._replace(another=5.0), 0.5)
    assert odds >= GIVEN_UP
