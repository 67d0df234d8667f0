"""Several places that a tracker follows, copies or clutter: which one is the body's, frames alone do not tell."""

from __future__ import annotations

import itertools
import math
from collections.abc import Container, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.model.modes import is_same_place
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.priors import COPY, IN_VIEW
from rootmatch.tracking.followed_places import (
    GonePlaces,
    absence_chance,
    assign_places,
    copy_chance,
    log_absence,
    log_return,
    log_returned,
    log_weight,
    return_factor,
)
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.motion_filter import MotionFilter

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
ACROSS = np.array([(-0.15, 0.02, 0.75), (0.15, -0.03, 0.7)])
ALL = range(1000)


class Shown:
    """All frames but those of a gap."""

    def __init__(self, last: int, again: int) -> None:
        self.gap = range(last, again)

    def __contains__(self, frame: int) -> bool:
        return frame not in self.gap


def flight(
    seed: int, frames: int, shown: tuple[Container[int], Container[int]] = (ALL, ALL), speed: float = 0.0
) -> Iterator[tuple[Floats, Integers]]:
    """The points of an object; then detections of two of them, each in some frames, and the owner of each, −1 for none.

    ``speed``: with which they move towards each other, across the image.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.06, 0.06, (9, 3))
    first, rate = Rotation.random(2, rng=rng), rng.normal(0.0, 0.5, (2, 3))
    yield points, np.arange(9)
    for k in range(frames):
        pixels, owner = [rng.uniform((0, 0), (1280, 960), (3, 2))], [np.full(3, -1)]
        for body in range(2):
            R = (Rotation.from_rotvec(rate[body] * k / 60.0) * first[body]).as_matrix()
            seen = np.flatnonzero((rng.random(9) < 0.95) & (k in shown[body]))
            moved = np.array([speed * k / 60.0, 0.0, 0.0]) * (1 - 2 * body)
            pixels.append(CAMERA.project(points[seen] @ R.T + ACROSS[body] + moved))
            owner.append(np.full(len(seen), body))
        order = rng.permutation(sum(map(len, owner)))
        every = np.concatenate(pixels)[order]
        yield every + rng.normal(0.0, 0.3, every.shape), np.concatenate(owner)[order]


def statuses(
    seed: int, frames: int, shown: tuple[Container[int], Container[int]] = (ALL, ALL), speed: float = 0.0
) -> list[rm.Match]:
    """The matches of a flight."""
    each = flight(seed, frames, shown, speed)
    points, _ = next(each)
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3)
    return [tracker.update(target, time=k / 60.0) for k, (target, _) in enumerate(each)]


@pytest.mark.parametrize("seed", [4, 8])
def test_frames_do_not_tell_which_of_two_copies_was_asked_for(seed: int) -> None:
    """Both are followed, each as well as the other: once chance decided, for the wrong one in half of all flights."""
    for match in statuses(seed, 60):
        assert match.status is rm.Status.AMBIGUOUS
        assert match.probability == pytest.approx(0.5, abs=0.1)


def test_the_one_that_stays_is_not_certain_for_that() -> None:
    """It may have been the other one that was asked for."""
    assert not any(statuses(4, 80, (ALL, range(20))))
    assert any(statuses(4, 20, (ALL, range(0))))  # as one that was alone from the first frame on is


def test_the_one_that_is_back_is_not_certain_for_that() -> None:
    """Both are hidden for longer than a body coasts."""
    tracker, found = None, []
    for k, (target, _) in enumerate(flight(4, 90, (Shown(20, 60), range(20))), -1):
        if tracker is None:
            tracker = rm.Tracker(target, rm.P3P(CAMERA), noise=0.3)
            continue
        found.append(tracker.update(target, time=k / 60.0).status)
    assert rm.Status.MATCHED not in found
    assert found[-1] is rm.Status.AMBIGUOUS


@pytest.mark.parametrize("seed", [1, 4])
def test_two_copies_that_cross_stay_ambiguous(seed: int) -> None:
    assert not any(statuses(seed, 90, speed=0.2))


def test_a_prior_in_the_first_frame_names_one_of_two_copies() -> None:
    each = flight(1, 40)
    points, _ = next(each)
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3)
    rng = np.random.default_rng(1)
    rng.uniform(-0.06, 0.06, (9, 3))
    R = Rotation.random(2, rng=rng).as_matrix()
    for k, (target, owner) in enumerate(each):
        prior = rm.Pose(R[1], ACROSS[1], np.diag([0.03] * 3 + [0.02] * 3) ** 2) if k == 0 else None
        match = tracker.update(target, time=k / 60.0, prior=prior)
        assert match
        assert set(owner[match.assignment[match.assignment >= 0]].tolist()) == {1}


def test_clutter_that_stays_is_not_trusted_when_the_body_leaves() -> None:
    """Four lamps that fit four points of the body, as long as one likes: frames only repeat what they show."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.06, 0.06, (8, 3))
    lamps = CAMERA.project(points[:4] @ Rotation.random(rng=rng).as_matrix().T + (0.2, 0.15, 0.9))
    first, rate = Rotation.random(rng=rng), np.array([0.4, -0.3, 0.5])
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3)
    trusted = 0
    for k in range(160):
        R = (Rotation.from_rotvec(rate * k / 60.0) * first).as_matrix()
        own = points[: 0 if k >= 60 else None] @ R.T + (-0.1, 0.0, 0.8)
        target = np.concatenate([lamps, CAMERA.project(own)])
        match = tracker.update(target + rng.normal(0.0, 0.3, target.shape), time=k / 60.0)
        trusted += bool(match)
        assert not match or match.assignment[match.assignment >= 0].min() >= 4
    assert trusted >= 55


def test_weights_are_those_of_copies_and_clutter_enumerated() -> None:
    """Each place is of the body, of a copy, or of clutter; its odds against clutter are given."""
    odds = np.exp([12.0, 3.0, 6.0, -1.0])
    each = np.zeros(len(odds))
    for body in range(len(odds)):
        for copies in itertools.product([False, True], repeat=len(odds)):
            others = [COPY * odds[k] if copy else 1.0 for k, copy in enumerate(copies) if k != body]
            each[body] += odds[body] * np.prod(others) / 2.0  # the body's own place has both
    told = np.exp([log_weight(math.log(one)) for one in odds])
    np.testing.assert_allclose(told / told.sum(), each / each.sum(), rtol=1e-9)
    np.testing.assert_allclose([copy_chance(math.log(one)) for one in odds], COPY * odds / (1.0 + COPY * odds))


def test_what_came_in_since_a_search_may_be_the_body_or_a_copy() -> None:
    """Both come as seldom, so that it is absent tells little of what appears now but not a moment ago."""
    step = 1.0 / 60.0
    assert log_absence(1.0, step, step) == pytest.approx(-math.log(IN_VIEW), abs=0.05)
    assert log_absence(1.0, step, math.inf) == pytest.approx(-math.log(IN_VIEW * step), abs=0.1)
    assert log_absence(1.0 - IN_VIEW, math.inf, math.inf) == pytest.approx(math.log(1.0 - IN_VIEW) - math.log(IN_VIEW))


def test_a_body_that_was_hidden_a_moment_ago_is_hardly_in_view_now() -> None:
    assert log_returned(1e-3) < log_returned(1.0 / 60.0) < log_returned(1.0) < 0.0
    assert log_returned(60.0) == pytest.approx(0.0, abs=1e-6)
    assert log_returned(1.0 / 60.0) == pytest.approx(math.log(IN_VIEW / 60.0) - math.log(4.0), abs=0.05)
    assert return_factor(0.0, -5.0) == 1.0
    # odds of 19 : 1 against clutter alone fall by e⁻⁵
    assert 0.95 * return_factor(0.05, -5.0) == pytest.approx(1.0 / (1.0 + math.exp(5.0) / 19.0))


@pytest.mark.parametrize("seed", [6, 9])
def test_lights_that_stay_are_not_taken_for_a_hidden_body(seed: int) -> None:
    """Six lights that move with what carries seven LEDs, and a second of every two without these."""
    rng = np.random.default_rng(seed)
    body, lights = rng.uniform(-0.12, 0.12, (7, 3)), rng.uniform(-0.4, 0.4, (6, 3))
    camera = rm.Camera(700.0, 700.0, 640.0, 480.0)
    tracker, turn = rm.Tracker(body, rm.P3P(camera), noise=0.3), rng.normal(0.0, 0.5, 3)
    trusted = 0
    for k in range(180):
        R, hidden = Rotation.from_rotvec(turn * k / 60.0).as_matrix(), k % 120 >= 60
        points = np.concatenate([lights, body[: 0 if hidden else 7]]) @ R.T + (0.0, 0.0, 1.5)
        pixels = camera.project(points)
        match = tracker.update(pixels + rng.normal(0.0, 0.3, pixels.shape), time=k / 60.0)
        trusted += bool(match) and hidden
    assert trusted <= 1


def test_a_caller_may_say_where_a_hidden_body_is() -> None:
    rng = np.random.default_rng(2)
    body, camera = rng.uniform(-0.1, 0.1, (8, 3)), rm.Camera(700.0, 700.0, 640.0, 480.0)
    tracker = rm.Tracker(body, rm.P3P(camera), noise=0.3)
    pixels = camera.project(body + np.array([0.0, 0.0, 1.0])) + rng.normal(0.0, 0.3, (8, 2))
    assert tracker.update(pixels)
    assert not tracker.update(np.empty((0, 2)))
    there = rm.Pose(np.eye(3), (0.0, 0.0, 1.0), np.diag([0.01] * 6) ** 2)
    assert tracker.update(pixels, prior=there)


def test_places_are_told_by_most_of_their_detections() -> None:
    uses = np.zeros((4, 12), np.bool_)
    for row, taken in zip(uses, [range(6), range(5, 11), range(1, 6), range(6, 10)], strict=True):
        row[list(taken)] = True
    assert is_same_place(uses).tolist() == [[k % 2 == j % 2 for j in range(4)] for k in range(4)]
    origin = np.array([1, -1, 0, 2])
    assert assign_places(uses, origin, [7, 7, 3]).tolist() == [7, 3, 7, 3]
    assert assign_places(uses, origin[[0, 1, 2, 1]], [7, 7, 3]).tolist() == [7, 8, 7, 8]


def test_what_is_found_next_may_be_of_any_place_that_is_gone() -> None:
    gone = GonePlaces()
    gone.add({0: 0.5, 1: 0.3, 2: 0.2}, {0: 1.0}, {0: 1.0, 1: 1.0, 2: 1.0})
    assert gone.share == pytest.approx(0.5)
    gone.add({0: 1.0}, {}, {0: 1.0})
    assert gone.share == pytest.approx(0.5)
    other = GonePlaces()
    other.add({0: 0.97, 1: 0.03}, {1: 1.0}, {0: 1.0, 1: 0.0})
    assert other.share == pytest.approx(0.97)
    other.add({1: 1.0}, {}, {1: 0.0})  # the body is back, most probably
    assert other.share == pytest.approx(0.03)


def test_of_things_that_are_gone_at_once_each_comes_back_as_probably() -> None:
    copies, clutter = GonePlaces(), GonePlaces()
    copies.add({0: 0.99, 1: 0.01}, {}, {0: 1.0, 1: 1.0})
    assert copies.share == pytest.approx(0.5)  # it is known which was the body, not which of them is found
    clutter.add({0: 0.99, 1: 0.01}, {}, {0: 1.0, 1: 0.0})
    assert clutter.share == pytest.approx(0.01)


def test_a_place_that_is_gone_fades_while_the_body_does_not_come_back_there() -> None:
    gone = GonePlaces()
    gone.add({0: 0.3, 1: 0.7}, {1: 1.0}, {0: 1.0, 1: 1.0})
    for _ in range(30):
        gone.fade(0.1)
    assert gone.share / (1.0 - gone.share) == pytest.approx(0.3 / 0.7 * math.exp(-3.0 * IN_VIEW))


@pytest.mark.parametrize("seed", [3, 12, 15])
def test_a_body_that_is_elsewhere_after_a_pause_is_trusted_again(seed: int) -> None:
    """Nothing is seen where it was predicted: that it is hidden there, and a copy came, is no matter of tempering."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    axes = rng.uniform(0.06, 0.15, 3)
    points, normals = directions * axes, directions / axes
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    first, turn, time = Rotation.random(rng=rng), rng.normal(0.0, 1.0, 3), 0.0
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3, normals=normals, view_angle=math.radians(70.0))
    found = []
    for k in range(60):
        time += 2.0 if k == 30 else 1.0 / 60.0
        R = (Rotation.from_rotvec(turn * time) * first).as_matrix()
        seen = points @ R.T + (0.2 * math.sin(time), 0.1 * math.cos(1.3 * time), 1.0 + 0.1 * math.sin(0.7 * time))
        facing = -((normals @ R.T) * seen).sum(axis=1) / np.linalg.norm(seen, axis=1)
        shown = (facing > math.cos(math.radians(70.0))) & (rng.random(20) > 0.07)
        target = CAMERA.project(seen[shown])
        found.append(tracker.update(target + rng.normal(0.0, 0.3, target.shape), time=time))
    assert sum(map(bool, found[:30])) >= 25
    assert sum(map(bool, found[40:])) >= 17


def test_a_turned_filter_expects_the_same() -> None:
    """Its prediction has the density at a pose after the motion that the other one's has at the pose."""
    rng = np.random.default_rng(2)
    points, steps = rng.uniform(-2.0, 2.0, (9, 3)), Rotation.random(3, rng=rng).as_matrix()
    pose = rm.Pose(steps[0], np.array([0.2, -0.1, 6.0]), np.diag([0.01] * 3 + [0.05] * 3) ** 2)
    own = MotionFilter(points, pose, 0.0)
    near = rm.Pose(Rotation.from_rotvec([0.01, 0.02, -0.01]).as_matrix() @ pose.R, pose.t + 0.03, pose.covariance)
    own.update(near, 0.1)
    R, t = steps[1], np.array([1.2, -0.4, 0.3])
    other = own.turned(R, t)
    for time in (0.2, 0.4):
        found = own.predicted(time)
        away = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix() @ found.R, found.t + np.array([0.1, -0.05, 0.02])
        densities = []
        for one, (turn, shift) in ((own, away), (other, (away[0] @ R, away[0] @ t + away[1]))):
            told = one.predicted(time)
            assert told.covariance is not None
            terms = Gaussian(told.R, told.t, told.covariance).terms(turn[None], shift[None])
            densities.append(float(terms.log_density[0] - 0.5 * terms.squared[0]))
        assert densities[0] == pytest.approx(densities[1], abs=0.05)


@pytest.mark.parametrize("seed", [4, 8])
def test_the_body_that_is_back_is_weighed_against_what_was_found_in_its_absence(seed: int) -> None:
    """The body is hidden, a copy of it comes into view, then the body is back: the copy was taken for it meanwhile."""
    each = flight(seed, 110, (Shown(20, 75), range(60, 1000)))
    points, _ = next(each)
    tracker, wrong = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3), []
    for k, (target, owner) in enumerate(each):
        match = tracker.update(target, time=k / 60.0)
        if match and (owner[match.assignment[match.assignment >= 0]] == 1).any():
            wrong.append(k)
    assert wrong, "nothing tells the copy from the body while it is alone"
    assert max(wrong) < 75 + tracker.tracking.search_every


def test_how_long_a_body_may_be_hidden_decides_where_it_is() -> None:
    """A body that was hidden a moment ago comes back; one that is followed for seconds was there all the time."""
    assert absence_chance(1.0, 0.0) == pytest.approx(1.0)
    assert absence_chance(1.0, 60.0) == pytest.approx(1.0 - IN_VIEW)
    filter_ = MotionFilter(np.eye(3), rm.Pose(np.eye(3), (0, 0, 1), np.eye(6)), 0.0)
    followed = FollowedPose(filter_, since=2.0, log_absent=1.0)
    later = [log_return(followed, time) for time in (2.0, 3.0, 7.0)]
    assert later[0] == 1.0
    np.testing.assert_allclose(np.diff(later), [-IN_VIEW, -4.0 * IN_VIEW])
