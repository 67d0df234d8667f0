"""Frame after frame: predictions, occlusions, and what a tracker says of itself."""

from __future__ import annotations

import copy
import gc
import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import oracles
import rootmatch as rm
from rootmatch.explain.finding import mode_pose
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import squared_deviations
from rootmatch.model.mode_search import find_modes
from rootmatch.model.modes import empty_changes_each
from rootmatch.model.near_symmetries import find_symmetries
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.proposals import Proposals
from rootmatch.tracking.averaged_pose import average_pose
from rootmatch.tracking.belief import Belief
from rootmatch.tracking.followed_places import log_returned
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.motion_filter import MotionFilter, transition
from rootmatch.tracking.tracker import TrackingOptions

CAMERA = rm.Camera(800.0, 780.0, 320.0, 240.0)
BODY = np.random.default_rng(4).uniform(-0.3, 0.3, (7, 3)) + np.array([1.0, 0.0, 0.0])
INTERVAL = 1.0 / 60.0


def pose(seconds: float, start: int = 1) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    turn = Rotation.from_rotvec([0.5 * np.sin(2.0 * seconds), 0.8 * seconds, 0.1])
    R = (turn * Rotation.random(random_state=start)).as_matrix()
    return R, np.array([0.3 * np.sin(3.0 * seconds), 0.2, 3.0]) - R @ BODY.mean(axis=0)


def frame(k: int, hidden: bool = False, noise: float = 0.2) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    rng = np.random.default_rng(k)
    R, t = pose(k * INTERVAL)
    shown = np.array([], int) if hidden else np.arange(len(BODY))
    pixels = CAMERA.project(BODY @ R.T + t)[shown] + rng.normal(0.0, noise, (len(shown), 2))
    target = np.concatenate([pixels, rng.uniform((0.0, 0.0), (640.0, 480.0), (2, 2))])
    order = rng.permutation(len(target))
    truth = np.full(len(BODY), -1)
    truth[shown] = np.argsort(order)[: len(shown)]
    return target[order], truth


ONE_LEVEL = rm.MotionOptions(min_scale=1.0, max_scale=1.0)
"""Of a body whose accelerations are as large at all times."""


def tracker(**options: Any) -> rm.Tracker:
    return rm.Tracker(BODY, rm.P3P(CAMERA), noise=0.2, **options)


def test_a_saved_tracker_continues_as_the_original_does() -> None:
    one = tracker()
    for k in range(4):
        one.update(frame(k)[0], time=k * INTERVAL)
    others = pickle.loads(pickle.dumps(one)), copy.deepcopy(one)
    for k in range(4, 8):
        expected = one.update(frame(k)[0], time=k * INTERVAL)
        assert expected.prior_holds
        for other in others:
            found = other.update(frame(k)[0], time=k * INTERVAL)
            assert (found.assignment == expected.assignment).all()
            assert found.fused_pose is not None
            assert np.array_equal(found.fused_pose.matrix, expected.fused_pose.matrix)


def test_a_flight_with_an_occlusion() -> None:
    one = tracker()
    assert one.state is rm.TrackingState.LOST
    assert one.predicted() == {}
    searched = 0
    for k in range(60):
        hidden = 30 <= k < 40
        target, truth = frame(k, hidden)
        match = one.update(target)
        searched += match.evaluated > 0
        if hidden:
            assert one.state is rm.TrackingState.COASTING
            assert match.status is rm.Status.UNTRUSTED
            continue
        assert one.state is rm.TrackingState.TRACKING
        assert np.array_equal(match.assignment, truth)
        if k > 0:
            assert match.prior_holds
            assert match.fused_pose is not None
            R, _ = pose(k * INTERVAL)
            assert np.degrees(Rotation.from_matrix(match.fused_pose.R @ R.T).magnitude()) < 1.0
    assert searched == 1


def test_a_jump_is_found_and_a_lost_body_said_to_be() -> None:
    one = tracker(tracking=TrackingOptions(coasting=0.1))
    for k in range(5):
        one.update(frame(k)[0])
    states = []
    for k in range(70, 74):  # as if a second were missing
        target, truth = frame(k)
        match = one.update(target)
        states.append(one.state)
        assert np.array_equal(match.assignment, truth)
    assert states == [rm.TrackingState.TRACKING] * 4
    for k in range(74, 84):
        one.update(frame(k, hidden=True)[0])
    assert one.state is rm.TrackingState.LOST
    assert str(one.state).startswith("lost")
    assert one.update(np.empty((0, 2))).finding.reason is not None
    one.update(frame(90)[0])
    assert one.state is rm.TrackingState.TRACKING
    one.reset()
    assert one.state is rm.TrackingState.LOST


def test_a_frame_without_the_body_counts_if_nothing_at_all_was_found_in_it() -> None:
    one = tracker()
    for k in range(3):
        one.update(frame(k)[0], time=0.02 * k)
    belief = one._bodies[None].belief
    assert belief.presence_after_return(0.06) == 0.0
    assert not one.update(np.empty((0, 2)), time=0.06)
    assert belief.presence_after_return(0.08) == log_returned(0.08 - 0.06)


def test_a_camera_that_shakes_does_not_lose_the_body() -> None:
    rng, one, right = np.random.default_rng(2), tracker(), 0
    for k in range(30):
        target, truth = frame(k)
        shaken = target + rng.normal(0.0, 10.0, 2)  # .7° on each axis, anew in each frame
        right += bool(match := one.update(shaken)) and np.array_equal(match.assignment, truth)
    assert right >= 28


def twins(off: float) -> tuple[NDArray[np.float64], list[MotionFilter], NDArray[np.float64], NDArray[np.float64]]:
    """Six points, their copy half a turn away but for ``off``, and three more: body, both poses, the right one."""
    rng = np.random.default_rng(6)
    six = rng.uniform((0.1, -0.3, -0.3), (0.7, 0.3, 0.3), (6, 3))
    copy = six * [-1.0, -1.0, 1.0] + off * rng.standard_normal((6, 3))
    body = np.concatenate([six, copy, rng.uniform(-0.3, 0.3, (3, 3))])
    R, t = Rotation.random(random_state=1).as_matrix(), np.array([0.1, 0.0, 3.0])
    poses = [rm.Pose(turned, t, np.diag([1e-4] * 6)) for turned in (R * [-1.0, -1.0, 1.0], R)]
    return body, [MotionFilter(body, known, 0.0) for known in poses], R, t


def following(body: NDArray[np.float64], filters: list[MotionFilter]) -> tuple[rm.Tracker, Belief]:
    """A tracker that follows some poses, each as probable, and what it believes."""
    one = rm.Tracker(body, rm.P3P(CAMERA), noise=0.2)
    one.update(np.empty((0, 2)), time=0.0)
    belief = one._bodies[None].belief
    belief.poses = [FollowedPose(known) for known in filters]
    return one, belief


def test_twin_poses_are_followed_until_another_view_decides() -> None:
    body, filters, R, t = twins(0.0)
    one, belief = following(body, filters)
    for k in range(1, 4):
        shown = np.arange(6 if k < 3 else 15)
        target = CAMERA.project(body @ R.T + t)[shown] + np.random.default_rng(k).normal(0.0, 0.2, (len(shown), 2))
        match = one.update(target)
        if k < 3:
            assert match.status is rm.Status.AMBIGUOUS
            assert one.state is rm.TrackingState.LOST
            assert len(belief.poses) == 2
            np.testing.assert_allclose(belief.shares, 0.5, atol=0.2)
            every = [match.assignment, *(other for other, _ in match.alternatives)]
            assert any(np.array_equal(found[:6], np.arange(6)) for found in every)
            assert any(np.array_equal(found[6:12], np.arange(6)) for found in every)
    assert match.status is rm.Status.MATCHED
    assert np.array_equal(match.assignment, np.arange(15))
    assert one.state is rm.TrackingState.TRACKING
    assert one.update(np.array([[1.0, 2.0]])).status is rm.Status.UNTRUSTED
    assert one.state is rm.TrackingState.COASTING


def test_the_evidence_of_frames_adds_up() -> None:
    """Half a millimetre at three metres is 0.13 px: no frame tells the twins apart, twenty do."""
    body, filters, R, t = twins(0.0005)
    one, _ = following(body, filters)
    statuses = []
    for k in range(1, 60):
        target = CAMERA.project(body @ R.T + t)[:6] + np.random.default_rng(k).normal(0.0, 0.2, (6, 2))
        match = one.update(target)
        statuses.append(match.status)
    first = statuses.index(rm.Status.MATCHED)
    assert 4 < first < 50
    assert all(status is rm.Status.MATCHED for status in statuses[first + 5 :])
    assert np.array_equal(match.assignment[:6], np.arange(6))


def test_the_twin_is_followed_too_where_a_search_found_one_pose_alone() -> None:
    body, filters, R, _ = twins(0.0)
    turns = [(one.rotation, one.shift) for one in find_symmetries(body, None)]
    assert len(turns) == 1
    np.testing.assert_allclose(turns[0][0], np.diag([-1.0, -1.0, 1.0]), atol=1e-9)
    np.testing.assert_allclose(turns[0][1], 0.0, atol=1e-9)
    assert not find_symmetries(np.random.default_rng(2).uniform(-0.3, 0.3, (15, 3)), None)
    _, belief = following(body, filters[:1])
    belief.add_turned(turns)
    assert len(belief.poses) == 2
    np.testing.assert_allclose(belief.poses[1].filter.R, R, atol=1e-9)
    assert belief.shares[1] == pytest.approx(1e-3, rel=0.01)
    belief.add_turned(turns)  # it is followed already
    assert len(belief.poses) == 2


def test_a_lock_on_the_wrong_twin_is_noticed_within_ten_frames() -> None:
    """All that is visible of the right pose is seen, half of it fits the wrong one."""
    body, filters, R, t = twins(0.0)
    one, _ = following(body, filters[:1])
    for k in range(1, 13):
        target = CAMERA.project(body @ R.T + t) + np.random.default_rng(k).normal(0.0, 0.2, (15, 2))
        match = one.update(target)
    assert match.status is rm.Status.MATCHED
    assert np.array_equal(match.assignment, np.arange(15))


def test_a_scant_body_is_searched_for_now_and_then() -> None:
    """A part of the body is shown where it is followed: the rest may be elsewhere, or hidden."""
    one = tracker(tracking=TrackingOptions(search_every=5))
    searched = []
    for k in range(12):
        target, truth = frame(k)
        if k >= 2:  # the rest is clutter
            kept = truth[:3]
            clutter = np.random.default_rng(k).uniform((0.0, 0.0), (640.0, 480.0), (12, 2))
            target = np.concatenate([target[kept], clutter])
        searched.append(one.update(target).evaluated > 0)
    assert searched[0]
    assert not any(searched[1:3])
    assert 1 <= sum(searched[3:]) <= 3


def test_two_visible_points_keep_a_body_that_is_followed() -> None:
    """Two points give no pose, but narrow a prediction: with them it holds for longer than without."""
    searched, spreads = [], []
    for seen in (2, 0):
        one = tracker(tracking=TrackingOptions(present=10.0))
        for k in range(24):
            target, truth = frame(k)
            if 6 <= k < 22:
                target = np.concatenate([target[truth[:seen]], [[20.0, 30.0], [600.0, 470.0]]])
            match = one.update(target)
            searched.append(match.evaluated > 0)
            if 6 <= k < 22:
                assert match.status is rm.Status.UNTRUSTED
            if k == 21:
                covariance = one.predicted()[None].covariance
                assert covariance is not None
                spreads.append(float(np.sqrt(np.trace(covariance[:3, :3]))))
        assert np.array_equal(match.assignment, truth)
        assert match.prior_holds
    assert spreads[0] < 0.5 * spreads[1]
    assert sum(searched) == 2  # the first frames


def test_a_filter_that_takes_a_pose_with_a_probability() -> None:
    """Mean and covariance of a hundred thousand samples, each of the prediction or of the update."""
    R, t = pose(0.0)
    before = MotionFilter(BODY, rm.Pose(R, t, 1e-6 * np.eye(6)), 0.0)
    ahead = before.predicted(0.1)
    new = rm.Pose(
        Rotation.from_rotvec([0.02, -0.01, 0.015]).as_matrix() @ ahead.R,
        ahead.t + np.array([0.01, 0.02, -0.01]),
        1e-5 * np.eye(6),
    )
    whole, some = before.copy(), before.copy()
    whole.update(new, 0.1)
    some.update(new, 0.1, 0.7)
    R0, t0, _, P0 = before._at(0.1)

    def from_prediction(one: MotionFilter) -> NDArray[np.float64]:
        return np.concatenate([Rotation.from_matrix(one.R @ R0.T).as_rotvec(), one.t - t0, one.motion])

    rng = np.random.default_rng(3)
    taken = rng.random(100_000) < 0.7
    first = rng.multivariate_normal(np.zeros(18), P0, len(taken), method="cholesky")
    second = rng.multivariate_normal(from_prediction(whole), whole.P, len(taken), method="cholesky")
    samples = np.where(taken[:, None], second, first)
    spread = np.sqrt(np.diag(some.P))
    assert np.abs((samples.mean(axis=0) - from_prediction(some)) / spread).max() < 0.02
    assert np.abs((np.cov(samples.T) - some.P) / np.outer(spread, spread)).max() < 0.03


def test_times_go_forward() -> None:
    one = tracker()
    one.update(frame(0)[0], time=2.0)
    one.update(frame(3)[0], time=2.0 + 3 * INTERVAL)
    with pytest.raises(rm.InputError, match="give frames in order"):
        one.update(frame(4)[0], time=2.0)
    with pytest.raises(rm.InputError, match="time: nan given"):
        one.update(frame(4)[0], time=float("nan"))
    with pytest.raises(rm.InputError, match="noise: 'auto'"):
        rm.Tracker(BODY, rm.P3P(CAMERA), noise="auto")
    with pytest.raises(rm.InputError, match=r"^problem: UP2PF.* given; a tracker follows rotations and"):
        rm.Tracker(BODY, rm.UP2PF((320.0, 240.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)))
    with pytest.raises(rm.InputError, match=r"^problem: PlanarMotion.* given; a tracker follows rotations and"):
        rm.Tracker(BODY, rm.PlanarMotion(CAMERA, axis=(0.0, 1.0, 0.0)))


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (1000.0 * INTERVAL * np.arange(12), ["time: the frames are 16.7 s apart; if times are in milliseconds"]),
        (INTERVAL * np.arange(12), []),
        (np.array([0.0, 60.0, 120.0, 120.1, 120.2, 120.3, 180.0, 240.0, 300.0]), []),  # seconds, with pauses
        (2.0 * np.arange(5), []),  # of four steps nothing is said
    ],
    ids=["milliseconds", "seconds", "pauses", "few"],
)
def test_times_that_are_milliseconds_are_noticed_once(times: NDArray[np.float64], said: list[str]) -> None:
    one, nothing = tracker(), np.empty((0, 2))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for time in times.tolist():
            one.update(nothing, time=time)
    assert [str(each.message)[: len(text)] for each, text in zip(caught, said, strict=True)] == said
    assert all(each.filename == __file__ for each in caught)


def test_steps_that_a_tracker_takes_by_itself_are_its_own_rate() -> None:
    one = tracker(tracking=TrackingOptions(interval=4.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(8):
            one.update(np.empty((0, 2)))


def test_frames_a_second_are_no_interval() -> None:
    with pytest.raises(rm.InputError, match="interval is 60; give the seconds between frames, such as 1/60"):
        TrackingOptions(interval=60)


def test_a_prediction_is_the_callers_own() -> None:
    """What is done to it, or to the arrays that a tracker was made with, changes no frame."""
    given = {"noise": np.full(len(frame(0)[0]), 0.2), "bodies": np.zeros(len(BODY), int)}
    one, other = rm.Tracker(BODY, rm.P3P(CAMERA), **given), rm.Tracker(BODY, rm.P3P(CAMERA), **copy.deepcopy(given))
    for array in given.values():
        array[:] = 7
    for k in range(4):
        found, expected = (each.update(frame(k)[0]) for each in (one, other))
        assert np.array_equal(found.assignment, expected.assignment)
        for time in (None, one.time):  # the second one is where the filter itself is
            for label, prediction in one.predicted(time).items():
                for name in ("R", "t", "covariance"):
                    assert np.array_equal(getattr(prediction, name), getattr(other.predicted(time)[label], name))
                    getattr(prediction, name)[:] = 9.0


def test_a_callers_prior_counts_instead() -> None:
    one = tracker()
    R, t = pose(0.0)
    known = rm.Pose(R, t, np.diag([1e-3] * 6))
    match = one.update(frame(0)[0], prior=known)
    assert match.prior_holds
    assert match.evaluated == 0
    assert one.state is rm.TrackingState.TRACKING


def test_several_bodies() -> None:
    other = np.random.default_rng(8).uniform(-0.3, 0.3, (6, 3))
    both, labels = np.concatenate([BODY, other]), ["hmd"] * 7 + ["left"] * 6
    one = rm.Tracker(both, rm.P3P(CAMERA), noise=0.2, bodies=labels)
    R2, t2 = Rotation.random(random_state=3).as_matrix(), np.array([-0.6, -0.2, 3.0])
    second = CAMERA.project(other @ R2.T + t2)
    for k in range(4):
        target, truth = frame(k)
        there = k != 2
        match = one.update(np.concatenate([target, second]) if there else target)
        assert match.bodies is not None
        assert np.array_equal(match.bodies["hmd"].assignment, truth)
        if there:
            assert np.array_equal(match.bodies["left"].assignment, len(target) + np.arange(6))
        state = rm.TrackingState.TRACKING if there else rm.TrackingState.COASTING
        assert one.states == {"hmd": rm.TrackingState.TRACKING, "left": state}
        assert one.state is rm.TrackingState.TRACKING


def test_a_frame_that_the_lens_shows_in_part_is_matched_and_the_flight_goes_on() -> None:
    lens = rm.Camera.from_opencv([[800.0, 0.0, 320.0], [0.0, 780.0, 240.0], [0.0, 0.0, 1.0]], [-0.4, 0.0, 0.0, 0.0])
    one, beyond = rm.Tracker(BODY, rm.P3P(lens), noise=0.2), [[1500.0, 240.0]]
    for k in range(4):
        R, t = pose(k * INTERVAL)
        target = lens.project(BODY @ R.T + t)
        match = one.update(np.concatenate([target, beyond]) if k in (0, 2) else target)
        assert np.array_equal(match.assignment, np.arange(len(BODY)))
        assert one.state is rm.TrackingState.TRACKING


def test_the_filter_is_that_of_kalman() -> None:
    """A pose fused by hand is the textbook's update of position, velocity and acceleration.

    A predicted covariance has axes that may turn with the body, or stay.
    """
    R, t = pose(0.0)
    one = MotionFilter(BODY, rm.Pose(R, t, 1e-4 * np.eye(6)), 0.0, ONE_LEVEL)
    before_R, before_t, _, before_P = one._at(0.1)
    noise = 4e-4 * np.eye(6)
    H = np.eye(6, 18)
    measured = np.array([0.01, -0.02, 0.005, 0.003, 0.002, -0.004])
    step = np.zeros(18)
    for _ in range(20):  # how far it turns depends on the gain, and that on how far
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        P = oracles.in_either_axes(before_P, np.kron(np.eye(6), turn) @ before_P @ np.kron(np.eye(6), turn.T))
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
        step, expected = gain @ measured, P - gain @ H @ P
    moved = oracles.moved_along_arc(np.concatenate([-step[:3], step[3:6]]))
    fused = one._to_own_frame(turn @ before_R, before_t + moved, expected[:6, :6])
    one.update(fused, 0.1)
    np.testing.assert_allclose(one.motion, step[6:], atol=1e-9)
    np.testing.assert_allclose(one.P, expected, atol=1e-9 * np.abs(expected).max())
    assert one.predicted(0.1).covariance == pytest.approx(fused.covariance, abs=1e-9)


def test_accelerations_last_for_a_while() -> None:
    """Singer's transition and noise, against the matrix exponential of the continuous system (Van Loan 1978)."""
    for time, persistence in ((1.0 / 60.0, 0.1), (0.5, 0.1), (0.01, 0.3)):
        A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / persistence]])
        noise = np.diag([0.0, 0.0, 2.0 / persistence])
        both = expm(time * np.block([[-A, noise], [np.zeros((3, 3)), A.T]]))
        F, added = transition(time, persistence)
        np.testing.assert_allclose(F, both[3:, 3:].T, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(added, both[3:, 3:].T @ both[:3, 3:], rtol=1e-5, atol=1e-15)


def test_nothing_is_kept_from_frame_to_frame() -> None:
    one = tracker()
    one.update(frame(0)[0])

    def objects(frames: range) -> int:
        for k in frames:
            one.update(frame(k)[0])
        gc.collect()
        return len(gc.get_objects())

    first = objects(range(1, 15))
    assert objects(range(15, 55)) <= first + 20


@pytest.mark.parametrize("seed", [11, 12, 14])
def test_a_pose_that_few_points_determine_is_averaged_over_what_they_leave_open(seed: int) -> None:
    """Mean and covariance of three points and a prediction, against importance sampling."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.06, 0.06, (8, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    R, position, spread = np.eye(3), np.array([0.05, 0.0, 0.9]), np.array([0.3] * 3 + [0.02] * 3)
    seen = points @ R.T + position
    facing = -(normals * seen).sum(axis=1) / np.linalg.norm(seen, axis=1)
    shown = np.argsort(-facing)[:3]
    target = CAMERA.project(points - points.mean(axis=0) + position)[shown] + rng.normal(0.0, 2.0, (3, 2))
    model = DetectionModel(
        CAMERA, points, target, np.full(3, 2.0), normals=normals, view_cosine=np.full(8, np.cos(np.radians(70.0))),
        rate=0.9, prior=Gaussian(R, position, np.diag(spread**2)),
    )  # fmt: skip
    assignment = np.full(8, -1)
    assignment[shown] = np.arange(3)
    modes = find_modes(model, Proposals(assignment[None], R[None], position[None]))
    pose = average_pose(
        model, modes._replace(near=empty_changes_each(len(modes.near), 8)), 0
    )  # of this assignment alone
    fitted = mode_pose(model, modes, 0)
    # samples of the fit, twice as wide, weighed by the posterior
    wide = 4.0 * modes.covariance[0]
    steps = rng.standard_normal((100_000, 6)) @ np.linalg.cholesky(wide).T
    turns = Rotation.from_rotvec(steps[:, :3]).as_matrix() @ modes.rotation[0]
    at = model.linearise_about(turns, modes.position[0] + steps[:, 3:])
    every = np.repeat(assignment[None], len(steps), axis=0)
    visible = model.visibility(at, np.zeros(len(steps)))
    terms = model.prior.terms(turns, modes.position[0] + steps[:, 3:])
    value = -0.5 * squared_deviations(model, every, at) + terms.log_density - 0.5 * terms.squared
    value += np.log(visible[:, shown]).sum(axis=1) + 0.5 * (steps @ np.linalg.inv(wide) * steps).sum(axis=1)
    weight = np.exp(value - value.max())
    weight /= weight.sum()
    assert 1.0 / (weight**2).sum() > 300.0
    mean = weight @ steps[:, :3]
    deviation = np.sqrt(weight @ (steps[:, :3] - mean) ** 2)
    errors = [
        np.linalg.norm((Rotation.from_matrix(one.R @ modes.rotation[0].T).as_rotvec() - mean) / deviation)
        for one in (pose, fitted)
    ]
    assert errors[0] < 0.5 * errors[1]
    assert errors[1] > 3.0
    assert pose.covariance is not None
    ratio = np.trace(pose.covariance[:3, :3]) / (deviation**2).sum()
    assert 0.8 < ratio < 1.25
