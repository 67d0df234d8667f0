"""Points that no camera shows, of something that has other points in their stead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from hall_scenes import RIG, SIGMA, cluster, images
from rootmatch.arrays import Bools
from rootmatch.model.detection_model import USUAL_RATE
from rootmatch.model.elsewhere import _Place, log_odds_of_another
from rootmatch.model.image_alike import REACH
from rootmatch.model.prediction import HIDDEN
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.motion_filter import MotionFilter


def found(seed: int, *, elsewhere: int, covered: int) -> rm.Match:
    """A cluster of six markers, of which the last ones are elsewhere, and the last ones are covered."""
    rng = np.random.default_rng(seed)
    points = cluster(rng, 6)
    built = points.copy()
    built[6 - elsewhere :] = cluster(rng, elsewhere)
    shown = np.repeat([0.8, 0.0], [6 - covered, covered])
    return rm.match(points, images(rng, built, shown)[0], rm.P3P(RIG), noise=SIGMA)


@pytest.mark.parametrize("seed", [1008, 1010])
def test_two_points_that_are_elsewhere_may_be_of_something_else(seed: int) -> None:
    """Four of six points match, and cameras see two more in the place of the others: the body with two points moved,
    with .05² (`INEXACT`), or something else, with .001 / 4 (`WRONG_MODEL`, `ANOTHER`)."""
    match = found(seed, elsewhere=2, covered=0)
    assert match.sightings is not None
    assert ((match.sightings.assignment >= 0).any(axis=0) == [True] * 4 + [False] * 2).all()
    odds = log_odds_of_another(match.finding.model, match.finding.posterior.modes, match.finding.mode)
    np.testing.assert_allclose(odds, np.log(0.1), atol=0.02)
    assert not match
    assert match.probability is not None
    assert match.probability < 1 / 1.1


@pytest.mark.parametrize("seed", [1008, 1010])
def test_two_points_that_are_covered_are_not_elsewhere(seed: int) -> None:
    match = found(seed, elsewhere=0, covered=2)
    assert match
    assert match.probability is not None
    assert match.probability > 0.99


def test_detections_are_gated_as_one_by_one() -> None:
    """Each by its squared deviation from where a point that may be anywhere is predicted, of its own camera."""
    match = found(1008, elsewhere=2, covered=0)
    model, told = match.finding.model, match.finding.posterior
    assert model is not None
    assert told is not None
    modes, rng = told.modes, np.random.default_rng(0)
    model = replace(model, sigma=rng.uniform(0.2, 0.4, model.shape[1]))
    at, free = model.linearise_about(modes.rotation[:1], modes.position[:1]), rng.random(model.shape[1]) < 0.8
    rows, lit = np.arange(model.shape[0]).reshape(-1, 6), modes.visible[0]
    near = _Place(model, at, modes.covariance[0], rows, lit).gate(free)
    assert not near.reshape(len(lit), -1)[lit <= HIDDEN].any()
    spread, gated = np.zeros((9, 9)), 0
    spread[:6, :6], spread[6:, 6:] = modes.covariance[0], model.radius**2 * np.eye(3)
    for row in np.flatnonzero(lit > HIDDEN).tolist():
        (own,) = (free & (model.image_indices == row // 6)).nonzero()
        jacobian = np.hstack([at.jacobian[0, row], at.jacobian[0, row, :, 3:]])
        across = jacobian @ spread @ jacobian.T + model.sigma[own].max() ** 2 * np.eye(2)
        off = model.target[own] - at.pixels[0, row]
        squared = np.array([one @ np.linalg.solve(across, one) for one in off])
        expected = own[squared < REACH**2].tolist()
        assert near[row // 6, row % 6].nonzero()[0].tolist() == expected
        gated += len(expected)
    assert gated > (lit > HIDDEN).sum()


def grow_one(place: _Place, near: Bools, point: int, start: tuple[int, int]) -> tuple[float, dict[int, int]]:
    """What a point has in each image in turn, of one beginning: by a Kalman filter, a detection at a time."""
    model, step, spread, total, out = place.model, np.zeros(9), place.spread, 0.0, dict[int, int]()
    for image in [start[0], *(k for k in range(len(near)) if k != start[0])]:
        (own,) = near[image, point].nonzero()
        if image == start[0]:
            own = np.array([start[1]])
        if not len(own):
            continue
        H = place.jacobian[image, point]
        across = H @ spread @ H.T + model.sigma[own].max() ** 2 * np.eye(2)
        off = place.off[image, point, own] - H @ step
        chance = USUAL_RATE * place.lit[image, point]
        worth = np.log(chance / (1.0 - chance)) - model.clutter.log_density[own]
        worth -= 0.5 * np.array([one @ np.linalg.solve(across, one) for one in off])
        worth -= 0.5 * np.linalg.slogdet(2.0 * np.pi * across)[1]
        one = int(worth.argmax())
        if worth[one] > 0.0 or not out:
            gain = spread @ H.T @ np.linalg.inv(across)
            step, spread = step + gain @ off[one], spread - gain @ H @ spread
            total, out = total + float(worth[one]), out | {image: int(own[one])}
    return total, out


def test_tracks_grow_together_as_one_by_one() -> None:
    match = found(1008, elsewhere=2, covered=0)
    model, told = match.finding.model, match.finding.posterior
    assert model is not None
    assert told is not None
    modes, free = told.modes, np.ones(model.shape[1], np.bool_)
    rows, lit = np.arange(model.shape[0]).reshape(-1, 6), modes.visible[0]
    place = _Place(model, model.linearise_about(modes.rotation[:1], modes.position[:1]), modes.covariance[0], rows, lit)
    near = place.gate(free)
    for point, track in enumerate(place.grow_tracks(near, range(6))):
        every = [grow_one(place, near, point, (k, j)) for k, j in np.argwhere(near[:, point]).tolist()]
        worth, taken = max((one for one in every if len(one[1]) > 1), key=lambda one: one[0])
        assert track.worth == pytest.approx(worth, rel=1e-9)
        assert {k: j for k, j in enumerate(track.detections.tolist()) if j >= 0} == taken


def test_what_no_frame_told_by_itself_is_told_by_the_first_that_does() -> None:
    """And is the mean of what frames tell from then on."""
    pose = rm.Pose(np.eye(3), np.array([0.0, 0.0, 1.0]), 1e-4 * np.eye(6))
    moving = MotionFilter(cluster(np.random.default_rng(0), 6), pose, 0.0)
    assert FollowedPose(moving, shows=3).alone_with(5.0) == 5.0
    assert FollowedPose(moving, shows=3, alone=1.0).alone_with(5.0) == 2.0


def flight(seed: int, *, moved: bool, beside: bool = False) -> tuple[int, int]:
    """Trusted frames of a cluster of six markers in flight, before and after one is dark; in the end, ten frames each.

    ``moved``: whether it is elsewhere on the body then; ``beside``: whether another marker comes near, but turns.
    """
    rng = np.random.default_rng(seed)
    points, axis, trusted = cluster(rng, 6), rng.normal(size=3), [0, 0]
    tracker = rm.Tracker(points, rm.P3P(RIG), noise=SIGMA)
    for k in range(40):
        R = Rotation.from_rotvec(0.01 * k * axis).as_matrix()
        built, shown = points.copy(), np.full(7, 0.95)
        if moved and k >= 10:
            built[5] += (0.04, -0.03, 0.02)
        passing = R.T @ Rotation.from_rotvec((0.0, 0.0, 0.05 * k)).as_matrix() @ (0.08, 0.0, 0.0)
        shown[5:] = 0.95 * (moved or k < 10), 0.95 * (beside and k >= 10)
        target, _ = images(rng, np.vstack([built, passing]), shown, (R, np.array([0.02 * k, 0.0, 0.0])))
        match = tracker.update(target, time=k / 60.0)
        trusted[0] += bool(match) and k < 10
        trusted[1] += bool(match) and k >= 30
    return trusted[0], trusted[1]


@pytest.mark.parametrize("seed", [1002])
def test_a_point_that_moves_with_the_body_in_the_stead_of_another_is_of_something_else(seed: int) -> None:
    """It may as well be the body, of which a marker was moved."""
    assert flight(seed, moved=True) == (10, 0)


@pytest.mark.parametrize("seed", [1003])
@pytest.mark.parametrize("beside", [False, True])
def test_a_dark_point_is_no_reason_for_doubt_nor_is_what_does_not_move_with_the_body(seed: int, beside: bool) -> None:
    early, late = flight(seed, moved=False, beside=beside)
    assert early == 10
    assert late >= 9
