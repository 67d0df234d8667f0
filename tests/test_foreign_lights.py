"""Lights beside a body that were taken for its points: they are not believed more the longer they stay."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.model.detection_model import USUAL_RATE
from rootmatch.model.evidence import weigh_assignments
from rootmatch.tracking.followed_pose import FollowedPose, pool_place_weights, temper
from rootmatch.tracking.foreign_lights import LIT, TOGETHER, ForeignLights, doubtful_probability
from rootmatch.tracking.motion_filter import MotionFilter

CAMERA = rm.Camera(700.0, 700.0, 640.0, 480.0)
RATE = 60.0


def flight(seed: int, shown: int, lights: int = 6, frames: int = 200) -> tuple[int, int, int]:
    """Trusted and wrong frames, and right ones with all in view, of a body that is covered but for so many points.

    Its carrier has lights of its own, which stay in view and turn with it. It is covered from frame 50 to 130.
    """
    rng = np.random.default_rng(seed)
    body, beside = rng.uniform(-0.12, 0.12, (7, 3)), rng.uniform(-0.2, 0.2, (lights, 3))
    first, turn = Rotation.random(random_state=seed), rng.normal(0.0, 0.6, 3)
    phase, speed = rng.uniform(0.0, 6.0, 3), rng.normal(0.0, 0.15, 3)
    tracker = rm.Tracker(body, rm.P3P(CAMERA), noise=0.3, tracking=rm.TrackingOptions(interval=1.0 / RATE))
    wrong = right = 0
    for k in range(frames):
        turned = (Rotation.from_rotvec(turn * np.sin(2.0 * k / RATE + phase)) * first).as_matrix()
        place = np.array([0.0, 0.0, 1.5]) + speed * np.sin(2.0 * k / RATE + phase)
        seen = np.flatnonzero((rng.random(7) < 0.95) & (np.arange(7) < (shown if 50 <= k < 130 else 7)))
        pixels = CAMERA.project(np.concatenate([body[seen], beside]) @ turned.T + place)
        target = pixels + rng.normal(0.0, 0.3, pixels.shape)
        match = tracker.update(np.concatenate([target, rng.uniform((0.0, 0.0), (1280.0, 960.0), (2, 2))]))
        if match:
            held = all(j < len(seen) and seen[j] == i for i, j in match.pairs)
            wrong += not held
            right += held and not 50 <= k < 130
    return wrong, right, frames - 80


@pytest.mark.parametrize(("shown", "maximum"), [(2, 1), (3, 4)])
def test_lights_that_turn_with_the_body_are_not_believed_for_staying(shown: int, maximum: int) -> None:
    """One of them beside three points is a test, and passes it by accident now and then."""
    wrong, right, full = flight(1, shown)
    assert wrong <= maximum, "hundreds if a match that lasts is believed"
    assert right > 0.85 * full, "the body is found again, although a place nearby is followed"


@pytest.mark.parametrize("own", [[0.9, 0.8, 0.7], [0.5, 0.99, 0.6, 0.9, 0.3], [0.4], [1.0, 1.0, 1.0, 0.0]])
def test_a_pose_holds_if_the_right_matches_determine_it(own: list[float]) -> None:
    lights = ForeignLights(len(own) + 1)
    lights.own[:-1], lights.seen[:-1], lights.time = own, 0.0, 0.0
    minimum, told = min(3, len(own)), 0.0
    for right in itertools.product([True, False], repeat=len(own)):
        if sum(right) >= minimum:
            told += math.prod(p if one else 1.0 - p for p, one in zip(own, right, strict=True))
    assert lights.holds == pytest.approx(told)


def found_of(shown: int) -> Any:
    """The finding about a prediction, without a search, with so many of seven points in view."""
    rng = np.random.default_rng(5)
    body = rng.uniform(-0.12, 0.12, (7, 3))
    matcher = rm.Matcher(body, rm.P3P(CAMERA), noise=0.3)
    pose = rm.Pose(np.eye(3), np.array([0.0, 0.0, 1.5]), np.diag([0.02] * 3 + [0.01] * 3) ** 2)
    pixels = CAMERA.project(body[:shown] + pose.t) + rng.normal(0.0, 0.3, (shown, 2))
    found = matcher.explained(pixels, prior=pose, searching=False)
    assert np.array_equal(found.assignment[:shown], np.arange(shown))
    return found


def test_matches_that_agree_on_a_pose_tell_of_each_other() -> None:
    lit = np.linspace(0.1, 0.6, 7)
    assert (doubtful_probability(found_of(6), np.array([1, 4]), lit) > 0.99).all(), (
        "four others say where their points are"
    )
    assert (doubtful_probability(found_of(6), np.arange(6), lit) > 0.99).all(), (
        "six agree, whatever was thought of each"
    )
    assert doubtful_probability(found_of(3), np.array([2]), lit)[0] == 0.0, "two others say nothing"


def test_the_other_matches_tell_of_one_by_their_evidence_alone() -> None:
    """Against the sum over both cases: it is right, or its point was not detected, lit or not."""
    found, lit = found_of(4), np.full(7, 0.3)
    modes, model = found.posterior.modes, found.model
    at = model.linearise_about(modes.rotation[:1], modes.position[:1])
    without = np.where(np.arange(7) == 3, -1, found.assignment)
    gain = np.subtract(
        *weigh_assignments(model, np.array([found.assignment, without]), at, model.prior.without).log_odds
    )
    rate = USUAL_RATE * modes.visible[0, 3]
    cases = [(1.0 - TOGETHER, 0.3), (TOGETHER, LIT)]
    right = sum(share * chance for share, chance in cases) * math.exp(gain)
    wrong = sum(share * (1.0 - rate * chance) for share, chance in cases) / (1.0 - rate)
    assert doubtful_probability(found, np.array([3]), lit) == pytest.approx(right / (right + wrong))


def test_a_match_is_no_more_probable_than_when_it_was_met() -> None:
    """Three matches of which the third was doubtful at first: later frames find it where they expect it."""
    found, lit = found_of(3), np.full(7, 0.05)
    lights = ForeignLights(7)
    lights.take(found, np.where(np.arange(7) == 2, 0.7, 0.999), lit, 0.0)
    lit[:] = 0.9  # as if it had been seen
    for k in range(1, 5):
        maximum = lights.maximum(found, lit, k / RATE)
        assert maximum[2] == pytest.approx(0.7)
        assert (maximum[:2] == 1.0).all()
        lights.take(found, np.full(7, 0.999), lit, k / RATE)
    nothing = SimpleNamespace(**{**vars(found), "assignment": np.full(7, -1)})
    lights.take(nothing, np.full(7, 0.999), lit, 5.0 / RATE)
    assert lights.maximum(found, lit, 6.0 / RATE)[2] < 0.75, "what was beside the body is still there"
    assert lights.maximum(found, lit, 20.0)[2] == 1.0


def test_a_hypothesis_gains_nothing_by_being_split() -> None:
    """What counts for less than it says counts so for both parts together."""
    whole = temper(np.log([0.5, 0.5]), np.array([0, 1]), 0.5)
    split = temper(np.log([0.5, 0.3, 0.2]), np.array([0, 1, 1]), 0.5)
    assert split[0] == pytest.approx(whole[0])
    assert np.logaddexp(*split[1:]) == pytest.approx(whole[1])
    assert split[1] - split[2] == pytest.approx(0.5 * math.log(1.5))


def test_which_points_are_shown_is_no_reason_for_a_place() -> None:
    pose = MotionFilter(np.eye(3), rm.Pose(np.eye(3), (0.0, 0.0, 1.0), np.eye(6)), 0.0)
    every = [(0, 0.0, -2.0), (1, -1.0, -1.0), (1, 0.5, -3.0)]
    poses = [FollowedPose(pose, weight, shown, place=place) for place, weight, shown in every]
    told = pool_place_weights(poses)
    for place in (0, 1):
        before = np.logaddexp.reduce([one.total for one in poses if one.place == place])
        after = np.logaddexp.reduce([one.log_weight for one in told if one.place == place])
        assert after == pytest.approx(before)
    assert told[2].log_weight - told[1].log_weight == pytest.approx(1.5)
    assert pool_place_weights(poses[1:]) == poses[1:]


def test_what_is_kept_between_two_questions_is_of_the_last_frame() -> None:
    """A frame asks twice how probable its matches can be; the next one finds it out anew."""
    found, lit, lights = found_of(3), np.full(7, 0.05), ForeignLights(7)
    assert lights.holds == 1.0, "nothing was matched: as much as is asked for"
    for k, given in enumerate((0.7, 0.9, 0.4)):
        maximum = lights.maximum(found, lit, k / RATE)
        assert lights.maximum(found, lit, k / RATE) is maximum
        lights.take(found, np.where(found.assignment >= 0, given, 1.0), lit, k / RATE)
        anew = ForeignLights(7)
        anew.own, anew.met, anew.seen, anew.time = lights.own, lights.met, lights.seen, lights.time
        assert lights.holds == anew.holds < 1.0
        np.testing.assert_array_equal(
            lights.maximum(found, lit, (k + 1) / RATE), anew.maximum(found, lit, (k + 1) / RATE)
        )
