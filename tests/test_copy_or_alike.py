"""Two places where a body fits: an exact copy is a coin toss, and something of nearly its shape is told from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import instances
import rootmatch as rm
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model import copy_or_alike
from rootmatch.model.copy_or_alike import FAR, log_alike_factor, log_odds_some_off
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_poses
from rootmatch.model.mode_search import find_modes
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import Broad
from rootmatch.model.proposals import Proposals

SIGMA = 0.3
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0, size=(1280, 960))


def seen_by_three() -> list[tuple[rm.Camera, Floats, Floats]]:
    """Three cameras that look at a room's middle from 3 m."""
    views = []
    for angle in (0.0, 1.5, 3.0):
        centre = 3.0 * np.array([np.cos(angle), 0.3, np.sin(angle)])
        R = instances.look_at(centre, np.zeros(3), np.array([0.0, 1.0, 0.0]))
        views.append((CAMERA, R, -R @ centre))
    return views


def beside(seed: int, errors: Floats) -> tuple[Floats, Floats, rm.Rig, Integers]:
    """A body of eight points before three cameras, beside what differs from it by errors (8, 3).

    Also the detections (x, y, camera) of both, the rig, and which are the body's own.
    """
    rng, views = np.random.default_rng(seed), seen_by_three()
    points, rows = rng.uniform(-0.15, 0.15, (8, 3)), []
    for one, t in zip((points, points + errors), ((-0.3, 0.0, 0.1), (0.3, 0.1, 0.0)), strict=True):
        places = one @ Rotation.random(rng=rng).as_matrix().T + t
        rows += [[*pixel, k] for k, (_, R, t) in enumerate(views) for pixel in CAMERA.project(places @ R.T + t)]
    order = rng.permutation(48)
    target = np.array(rows)[order] + rng.normal(0.0, SIGMA, (48, 3)) * (1.0, 1.0, 0.0)
    return points, target, rm.Rig(views), np.argsort(order)[:24].reshape(3, 8)


@pytest.mark.parametrize("seed", [1, 7])
def test_what_has_nearly_its_shape_is_no_copy_of_a_body_beside_it(seed: int) -> None:
    """Five of its points fit, which are no accident, and the others stand some millimetres beside their places."""
    errors = np.random.default_rng([seed, 1]).normal(0.0, 8e-3, (8, 3)) * (np.arange(8) >= 5)[:, None]
    points, target, rig, own = beside(seed, errors)
    match = rm.match(points, target, rm.P3P(rig), noise=SIGMA)
    assert match.status is rm.Status.MATCHED
    assert match.sightings is not None
    assert np.array_equal(match.sightings.assignment, own)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_one_point_elsewhere_is_hardly_of_the_body_but_may_be(seed: int) -> None:
    errors = np.zeros((8, 3))
    errors[3] = Rotation.random(rng=np.random.default_rng([seed, 2])).apply((0.02, 0.0, 0.0))
    points, target, rig, own = beside(seed, errors)
    match = rm.match(points, target, rm.P3P(rig), noise=SIGMA)
    assert match.sightings is not None
    assert np.array_equal(match.sightings.assignment, own)
    assert match.probability is not None
    assert 0.8 < match.probability < 0.955


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_exact_copies_before_a_rig_have_about_one_half_each(seed: int) -> None:
    points, target, rig, _ = beside(seed, np.zeros((8, 3)))
    match = rm.match(points, target, rm.P3P(rig), noise=SIGMA)
    assert match.probability == pytest.approx(0.5, abs=0.15)


def place() -> tuple[DetectionModel, Modes]:
    """The mode of a body's matches without those of the fourth point, whose detection is that of a point 12 mm off."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.06, 0.06, (8, 3))
    moved = points + 0.012 * (np.arange(8) == 3)[:, None] * (0.6, 0.8, 0.0)
    target = CAMERA.project(moved + np.array((0.0, 0.0, 0.8)))
    model = DetectionModel(CAMERA, points, target, np.full(8, SIGMA), prior=Broad())
    assignment = np.where(np.arange(8) == 3, -1, np.arange(8))
    _, at = settle_poses(model, assignment[None], np.eye(3)[None], model.centre[None] + (0.0, 0.0, 0.8))
    modes = find_modes(model, Proposals(assignment[None], at.rotation, at.position))
    own = next(k for k, one in enumerate(modes.assignments) if (one == assignment).all())
    return model, modes.take(slice(own, own + 1))


def none_taken(count: int) -> Bools:
    """No detection is taken."""
    return np.zeros(count, np.bool_)


def test_one_point_off_is_the_mean_over_the_points_of_their_evidence() -> None:
    model, mode = place()
    odds = log_odds_some_off(model, mode, 0, none_taken(8))[1][0]
    for error, told in zip(FAR, odds, strict=True):
        each = []
        for point in range(8):
            wide = replace(
                model,
                source_covariance=(np.arange(8) == point)[:, None, None] * (error * model.radius) ** 2 * np.eye(3),
            )
            own = mode.assignments if point != 3 else np.arange(8)[None]
            some = settle_poses(wide, np.concatenate([mode.assignments, own]), *(
                np.repeat(one, 2, axis=0) for one in (mode.rotation, mode.position)
            ))[0]  # fmt: skip
            each.append(some.log_odds.max())
        assert told == pytest.approx(np.logaddexp.reduce(each) - np.log(8) - mode.log_mass[0], abs=0.7)
    assert odds.max() > 4.0


def test_what_the_body_may_be_itself_tells_little_and_what_is_taken_tells_nothing() -> None:
    model, mode = place()
    off = log_alike_factor(model, mode, 0, none_taken(8))
    assert 1.0 < off <= np.log(21.0) + 1e-9
    assert log_alike_factor(model, mode, 0, np.arange(8) == 3) < 0.5


def test_what_one_point_off_explains_is_worked_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    model, mode = place()
    first = log_odds_some_off(model, mode, 0, none_taken(8))
    monkeypatch.setattr(copy_or_alike, "settle_poses", None)
    again = log_odds_some_off(model, mode, 0, none_taken(8))
    assert again[0] == first[0]
    np.testing.assert_array_equal(again[1], first[1])
