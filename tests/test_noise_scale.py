"""The factor on σ that a tracker learns from its frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rig_scenes import LABELS, NOISE, RATE, VIEW, controllers, frame, headset
from rootmatch.explain.decide import Facts
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.task import MatchingTask
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.tracking.noise_scale import MAX_FREEDOM, MAXIMUM, NoiseScale

POINTS, NORMALS, OWNER = controllers()


def told(ratio: float | None, dof: int = 20, present: float = 0.99, sure: bool = True) -> Finding:
    """A finding whose residuals suggest so many times its σ."""
    camera = rm.Camera(800.0, 800.0, 320.0, 240.0)
    points, pixels = (
        np.random.default_rng(1).uniform(-1.0, 1.0, (4, 3)),
        np.random.default_rng(2).uniform(0, 99, (4, 2)),
    )
    nothing = make_empty_finding(MatchingTask.of(rm.P3P(camera), points, pixels), "made up")
    facts = Facts(present=present, sure_of_the_rest=sure)
    return replace(nothing, facts=facts, noise_factor=ratio, noise_dof=dof)


def test_it_is_the_mean_of_the_inverse_gamma_distribution() -> None:
    scale, chi2, freedom = NoiseScale(), 0.0, 0.0
    for ratio, dof in ((2.0, 14), (1.2, 30), (0.9, 7)):
        chi2 += dof * (ratio * scale.factor) ** 2
        freedom += dof
        scale.take(told(ratio, dof), scale.factor)
        assert scale.factor == pytest.approx(max(1.0, np.sqrt((NOISE_FREEDOM + chi2) / (NOISE_FREEDOM + freedom))))
    assert scale.factor > 1.2


def test_small_residuals_do_not_make_the_stated_noise_smaller() -> None:
    scale = NoiseScale()
    scale.take(told(0.3, 200), 1.0)
    assert scale.factor == 1.0


@pytest.mark.parametrize(
    "found", [told(2.0, sure=False), told(2.0, present=0.5), told(None), told(float("nan"), 0), told(1.01 * MAXIMUM)]
)
def test_a_doubtful_pose_says_nothing_of_the_noise(found: Finding) -> None:
    scale = NoiseScale()
    scale.take(found, 1.0)
    assert scale.factor == 1.0


@pytest.mark.parametrize("of_rig", [False, True])
def test_more_than_twice_the_noise_is_believed_of_a_rig_alone(of_rig: bool) -> None:
    """One image that asks for it is not trusted, so neither is a sequence; between cameras it may be calibration."""
    found, scale = told(3.0, 50), NoiseScale()
    if of_rig:
        points, rows = np.random.default_rng(1).uniform(-1.0, 1.0, (4, 3)), frame(11, 0, headset(), hands=2).rows
        found = replace(found, task=MatchingTask.of(rm.P3P(headset()), points, rows))
    scale.take(found, 1.0)
    assert (scale.factor > 1.0) == of_rig


def test_what_was_long_ago_is_forgotten() -> None:
    scale = NoiseScale()
    for _ in range(100):
        scale.take(told(1.0 / scale.factor * 1.9, 50), scale.factor)
    assert scale.factor == pytest.approx(1.9, rel=0.02)
    assert scale.residuals.freedom == pytest.approx(MAX_FREEDOM + NOISE_FREEDOM)
    for _ in range(200):
        scale.take(told(1.0 / scale.factor, 50), scale.factor)
    assert scale.factor == pytest.approx(1.0, abs=0.01)


def off_by(rig: rm.Rig, pixels: float, seed: int) -> rm.Rig:
    """A rig each of whose cameras is turned by an angle that moves its image by so many pixels."""
    rng, views = np.random.default_rng(seed), []
    for camera, R, t in rig.views:
        turn = Rotation.from_rotvec(pixels / camera.focal * rng.normal(size=3)).as_matrix()
        views.append((camera, turn @ np.array(R), turn @ np.array(t)))
    return rm.Rig(views, sizes=rig.sizes)


def flown(rig: rm.Rig) -> tuple[list[bool], bool, rm.Tracker]:
    """Whether each body is matched, frame by frame, whether any trusted match is wrong, and the tracker."""
    tracker = rm.Tracker(POINTS, rm.P3P(rig), noise=NOISE, normals=NORMALS, view_angle=np.radians(VIEW), bodies=OWNER)
    matched, wrong = [], False
    for k in range(24):
        scene = frame(11, k, headset(), hands=2)
        match = tracker.update(scene.rows, time=k / RATE)
        for label in LABELS:
            own = label == OWNER
            body, truth = match.bodies[label], scene.truth[:, own]
            matched.append(bool(body))
            seen: NDArray[np.int64] = body.sightings.assignment
            wrong |= bool(body) and bool(((seen >= 0) & (seen != truth)).any())
    return matched, wrong, tracker


def test_a_rig_that_is_off_by_a_pixel_is_followed() -> None:
    """Each frame for itself fits with two to three times the stated σ, and would not be trusted."""
    matched, wrong, tracker = flown(off_by(headset(), 0.8, 3))
    assert not wrong
    assert np.mean(matched[24:]) > 0.9
    assert 1.5 < tracker.noise_factor < 4.0
    tracker.reset()
    assert tracker.noise_factor == 1.0


def test_poses_in_one_place_are_no_body_and_its_copy() -> None:
    """Cameras that are off see a body in two poses, 5 mm apart: of sixteen sightings and of eight others."""
    scene, own = frame(11, 0, headset(), hands=2), LABELS[0] == OWNER
    known: dict[str, Any] = {"noise": NOISE, "normals": NORMALS[own], "view_angle": np.radians(VIEW)}
    told = list[float]()
    for seed in range(3, 13):
        match = rm.match(POINTS[own], scene.rows, rm.P3P(off_by(headset(), 0.8, seed)), **known)
        told.append(match.probability or 0.0)
    assert np.count_nonzero(np.array(told) > 0.94) >= 9  # by one of the rigs the other hand may be another


def test_a_right_rig_has_the_stated_noise() -> None:
    matched, wrong, tracker = flown(headset())
    assert not wrong
    assert np.mean(matched) > 0.9
    assert tracker.noise_factor < 1.1


CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)


def seen_with(factors: list[float], *, shape: float = 0.0, seed: int = 1) -> tuple[list[bool], int, rm.Tracker]:
    """Frames of a body with so many times the stated noise: which are trusted, wrong matches, and the tracker.

    ``shape``: how far the points of the object that is shown are off those of the model, metres.
    """
    rng, turn = np.random.default_rng(seed), Rotation.random(random_state=seed)
    points = rng.normal(size=(14, 3))
    points *= rng.uniform(0.06, 0.15, 3) / np.linalg.norm(points, axis=1)[:, None]
    shown = points + rng.normal(0.0, 1.0, points.shape) * shape
    tracker, trusted, wrong = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3), [], 0
    for k, factor in enumerate(factors):
        R = (Rotation.from_rotvec([0.0, k / RATE, 0.0]) * turn).as_matrix()
        seen = np.flatnonzero(rng.random(14) < 0.8)
        pixels = CAMERA.project(shown[seen] @ R.T + (0.2 * np.sin(k / RATE), 0.0, 1.0))
        pixels += rng.normal(0.0, 0.3 * factor, pixels.shape)
        order = rng.permutation(len(seen) + 3)
        target = np.vstack([pixels, rng.uniform((0, 0), (1280, 960), (3, 2))])[order]
        truth = np.full(14, -1)
        truth[seen] = np.argsort(order)[: len(seen)]
        match = tracker.update(target)
        trusted.append(bool(match))
        matched = match.assignment >= 0
        wrong += bool(match) and int((match.assignment[matched] != truth[matched]).sum())
    return trusted, wrong, tracker


@pytest.mark.parametrize(("before", "factor", "flights", "least"), [(10, 4.0, 10, 5), (10, 2.0, 1, 1), (0, 4.0, 1, 1)])
def test_noise_that_exceeds_what_was_stated_is_learned(before: int, factor: float, flights: int, least: int) -> None:
    """No frame is trusted with a σ that is four times too small, so it is learned from others; and unlearned after.

    Where noise rises to four times that at once, the body is lost before in many flights: of 380 flights 269 learn it.
    """
    count = 0
    for seed in range(1, flights + 1):
        trusted, wrong, tracker = seen_with([1.0] * before + [factor] * 40, seed=seed)
        assert wrong <= 1
        count += np.mean(trusted[before + 20 :]) > 0.9 and 0.7 * factor < tracker.noise_factor < 1.2 * factor
    assert count >= least


def test_noise_that_ends_is_unlearned() -> None:
    trusted, wrong, tracker = seen_with([1.0] * 10 + [4.0] * 30 + [1.0] * 15)
    assert all(trusted[-10:])
    assert wrong <= 1
    assert tracker.noise_factor < 1.2


@pytest.mark.parametrize("shape", [0.004, 0.008])
def test_another_object_is_no_noise(shape: float) -> None:
    """Its residuals are as large, and stay the same from frame to frame."""
    trusted, _, tracker = seen_with([1.0] * 30, shape=shape)
    assert not any(trusted)
    assert tracker.noise_factor < 1.5
