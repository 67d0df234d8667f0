"""What is known of the motion between two point sets: its factor against sampling, matches with it, and a tracker."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

import rootmatch as rm
from rootmatch.model import point_set_model
from rootmatch.model.motion_prior import MotionPrior
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.problems.points import PointClouds

TOOL = np.array([[40.0, 25, 0], [-40, 25, 0], [-40, -25, 0], [40, -25, 0], [0, 0, 20]])
"""A half turn about z maps it onto itself."""
SIGMA = 0.25
DEVIATION = np.array([0.05] * 3 + [5.0] * 3)
EVERY = ["pose", "rotation", "rotation and position", "vertical and position"]


def rotation(angle: float) -> np.ndarray:
    """Of a plane."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def moved(seed: int, points: np.ndarray = TOOL) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A rotation, a translation and the targets."""
    rng = np.random.default_rng([seed, 71])
    R, t = Rotation.random(rng=rng).as_matrix(), rng.uniform(-200.0, 200.0, 3)
    return R, t, points @ R.T + t + SIGMA * rng.normal(size=points.shape)


def predicted(R: np.ndarray, t: np.ndarray, seed: int) -> rm.Pose:
    """A prediction as wrong as it says."""
    off = np.random.default_rng([seed, 72]).normal(size=6) * DEVIATION
    return rm.Pose(Rotation.from_rotvec(off[:3]).as_matrix() @ R, t + off[3:], np.diag(DEVIATION**2))


def knowledge(kind: str, pose: rm.Pose) -> rm.Pose | rm.PosePrior:
    """Some of a prediction."""
    down = np.array([0.0, 1.0, 0.0])
    parts = {
        "rotation": {"rotation": (pose.R, 0.05)},
        "position": {"position": (pose.t, 5.0)},
        "vertical": {"vertical": (down, pose.R @ down, 0.05)},
    }
    if kind == "pose":
        return pose
    return rm.PosePrior(**{name: value for part in kind.split(" and ") for name, value in parts[part].items()})


def drawn(kind: str, pose: rm.Pose, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Motions from the prior itself; of those that leave the position open, rotations alone."""
    rng = np.random.default_rng(73)
    turns = Rotation.from_rotvec(0.05 * rng.normal(size=(count, 3)))
    if "vertical" in kind:
        axis = pose.R @ (0.0, 1.0, 0.0)
        across = np.linalg.svd(axis[None])[2][1:]
        tilts = Rotation.from_rotvec(0.05 * rng.normal(size=(count, 2)) @ across)
        turns = tilts * Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, (count, 1)) * axis)
    return (turns * Rotation.from_matrix(pose.R)).as_matrix(), pose.t + 5.0 * rng.normal(size=(count, 3))


@pytest.mark.parametrize("kind", EVERY)
def test_the_factor_is_the_integral_over_the_prior(kind: str) -> None:
    """By sampling motions from the prior; the noise is so large that its peak is met often."""
    sigma, points = 3.0, TOOL + np.array([10.0, -20.0, 5.0])
    R, t, target = moved(3, points)
    pose = predicted(R, t, 3)
    u = np.full(len(points), 0.5 * sigma**2)
    model = PointSetModel(PointClouds(points, target, u, u, scaled=False, mirror=False))
    fit = model.fit(np.arange(len(points))[None])
    turns, places = drawn(kind, pose, 400_000)
    there = points @ turns.swapaxes(1, 2)
    if "position" in kind or kind == "pose":
        square = ((there + places[:, None] - target) ** 2).sum(axis=(1, 2)) / sigma**2
        each = -0.5 * square - 1.5 * len(points) * math.log(2.0 * math.pi * sigma**2)
    else:  # the position integrated by hand
        off = target - there
        square = ((off - off.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2)) / sigma**2
        each = -0.5 * square - 1.5 * (len(points) - 1) * math.log(2.0 * math.pi * sigma**2)
        each -= 1.5 * math.log(len(points)) + model.log_volume
    expected = logsumexp(each) - math.log(len(each))
    factor = MotionPrior(((knowledge(kind, pose), 1.0),), 1e-12).log_factors(fit, model.box)[0, 0]
    assert factor + fit.evidence[0] - model.log_volume == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("kind", ["pose", "rotation", "rotation and position", "position"])
def test_the_factor_is_the_integral_over_the_prior_in_a_plane(kind: str) -> None:
    """Where all is known, by sampling as in space; the factors of a pose and of its parts are the same."""
    sigma, points, rng = 3.0, TOOL[:4, :2] + (10.0, -20.0), np.random.default_rng(5)
    R, t = rotation(1.0), np.array([30.0, -50.0])
    target = points @ R.T + t + sigma * rng.normal(size=points.shape)
    u = np.full(len(points), 0.5 * sigma**2)
    model = PointSetModel(PointClouds(points, target, u, u, scaled=False, mirror=False))
    fit = model.fit(np.arange(len(points))[None])
    pose = rm.Pose(rotation(1.05), t + np.array([4.0, -3.0]), np.diag([0.05, 5.0, 5.0]) ** 2)
    parts = {"rotation": (pose.R, 0.05), "position": (pose.t, 5.0)}
    known = rm.PosePrior(**{name: parts[name] for name in kind.split(" and ")}) if kind != "pose" else pose
    angles = rng.uniform(-np.pi, np.pi, 400_000) if kind == "position" else 1.05 + 0.05 * rng.normal(size=400_000)
    turned = np.array([np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)]).T.reshape(-1, 2, 2)
    off = target - points @ turned.swapaxes(1, 2)
    count = len(points)
    if kind == "rotation":  # the position integrated by hand
        square = ((off - off.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2)) / sigma**2
        each = -0.5 * square - (count - 1) * math.log(2.0 * math.pi * sigma**2) - math.log(count) - model.log_volume
    else:
        places = pose.t + 5.0 * rng.normal(size=(len(angles), 2))
        square = ((off - places[:, None]) ** 2).sum(axis=(1, 2)) / sigma**2
        each = -0.5 * square - count * math.log(2.0 * math.pi * sigma**2)
    expected = logsumexp(each) - math.log(len(each))
    factor = MotionPrior(((known, 1.0),), 1e-12).log_factors(fit, model.box)[0, 0]
    assert factor + fit.evidence[0] - model.log_volume == pytest.approx(expected, abs=0.15)


def test_what_is_vague_along_one_axis_takes_nothing_from_the_others() -> None:
    """Of a set that is flat, which has hardly a volume."""
    R, t, target = moved(4, TOOL * (1.0, 1.0, 0.0))
    u = np.full(len(TOOL), SIGMA**2)
    model = PointSetModel(PointClouds(TOOL * (1.0, 1.0, 0.0), target, u, u, scaled=False, mirror=False))
    fit = model.fit(np.arange(len(TOOL))[None])
    told = []
    for across in (1e2, 1e4):
        sigma = R @ np.diag([1.0, 1.0, across]) ** 2 @ R.T
        known = rm.PosePrior(position=(t, sigma))
        told.append(MotionPrior(((known, 1.0),), 1e-12).log_factors(fit, model.box)[0, 0])
    assert told[0] == pytest.approx(told[1], abs=0.01)
    assert told[0] > 4.0


def halls(seed: int, *, flat: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A map of two halls that are built alike, what is seen in one of them, which points that is, and the motion."""
    rng, size, noise = np.random.default_rng([seed, 74]), np.array([1.0, 1.0, 0.0 if flat else 1.0]), (0.012, 0.02)
    one = rng.uniform((0.0, 0.0, 0.0), (50.0, 30.0, 8.0), (25, 3)) * size
    true = np.concatenate([one, one + (60.0, 0.0, 0.0) + rng.normal(0.0, 0.02, one.shape) * size])
    turn, which = rng.uniform(-np.pi, np.pi), int(rng.integers(2))
    R = np.eye(3)
    R[:2, :2] = rotation(turn)
    t = -R @ (*rng.uniform((5.0, 5.0), (45.0, 25.0)), 0.0) - R @ (60.0 * which, 0.0, 0.0)
    seen = 25 * which + rng.choice(25, 10, replace=False)
    target = true[seen] @ R.T + t + rng.normal(0.0, noise[1], (10, 3)) * size
    target = np.concatenate([target, rng.uniform(-15.0, 15.0, (4, 3)) * size])
    return true + rng.normal(0.0, noise[0], true.shape) * size, target, seen, R, t


def joint_log_evidence(source: np.ndarray, target: np.ndarray, place: tuple[np.ndarray, float] | None) -> float:
    """Of matched points and what is known of the position, by Laplace's method about the best motion of both."""
    start = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))[0]

    def residuals(x: np.ndarray) -> np.ndarray:
        off = target - (Rotation.from_rotvec(x[:3]) * start).apply(source) - x[3:]
        known = () if place is None else ((x[3:] - place[0]) / place[1],)
        return np.concatenate([off.ravel() / math.hypot(0.012, 0.02), *known])

    first = np.concatenate([np.zeros(3), target.mean(axis=0) - start.apply(source.mean(axis=0))])
    best = least_squares(residuals, first, x_scale=[1e-3] * 3 + [0.1] * 3, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return -float(best.cost) - 0.5 * float(np.linalg.slogdet(best.jac.T @ best.jac)[1])


@pytest.mark.parametrize("flat", [False, True])
def test_a_position_says_in_which_of_two_halls(flat: bool) -> None:
    """It says as much as it does by hand, and nothing of which points are in view."""
    for seed in range(3):
        source, target, seen, _, t = halls(seed, flat=flat)
        labels = np.full((2, 50), -1)
        labels[0, seen] = labels[1, (seen + 25) % 50] = np.arange(10)
        variances = np.full(50, 0.012**2), np.full(14, 0.02**2)
        model = PointSetModel(PointClouds(source, target, *variances, scaled=False, mirror=False))
        for sigma in (3.0, 100.0):
            known = rm.PosePrior(position=(t, sigma))
            told = replace(model, prior=MotionPrior(((known, 1.0),), 1e-300)).judge(labels).known
            matched = [(source[one >= 0], target[one[one >= 0]]) for one in labels]
            without, joint = ([joint_log_evidence(*each, place) for each in matched] for place in (None, (t, sigma)))
            expected = joint[0] - without[0] - (joint[1] - without[1])
            # a vague one leaves a little to where an object may be
            assert told[0] - told[1] == pytest.approx(expected, abs=0.5 if sigma > 50.0 else 0.1)
        match = rm.match(source, target, rm.Rigid(), noise=(0.012, 0.02), prior=rm.PosePrior(position=(t, 3.0)))
        assert match.status is rm.Status.MATCHED
        assert match.prior_holds
        np.testing.assert_array_equal(match.assignment, labels[0])
        # a vertical tells nothing of which hall it is, so it changes the odds of neither
        down = np.array([0.0, 0.0, 1.0])
        upright = MotionPrior(((rm.PosePrior(vertical=(down, down, 1e-3)), 1.0),), 0.01)
        known = replace(model, prior=upright).judge(labels).known
        assert known[0] == pytest.approx(known[1], abs=0.5)


@pytest.mark.parametrize("size", [2, 3])
def test_a_predicted_map_is_settled_without_a_search(size: int) -> None:
    """Most of its points are not seen; beside as many strays as make another motion possible it is searched."""
    source, target, seen, R, t = (one[..., :size] for one in halls(1, flat=size == 2))
    seen, R = halls(1, flat=size == 2)[2], R[:size]
    covariance = np.diag([0.01] * (1 if size == 2 else 3) + [0.1] * size) ** 2
    given = {"noise": (0.012, 0.02), "prior": rm.Pose(R, t, covariance)}
    match = rm.match(source, target, rm.Rigid(), **given)
    assert match.status is rm.Status.MATCHED
    assert match.prior_holds
    assert match.evaluated == 0
    np.testing.assert_array_equal(match.pairs, np.column_stack([np.sort(seen), np.argsort(seen)]))
    strays = np.random.default_rng(2).uniform(-15.0, 15.0, (30, size))
    searched = rm.match(source, np.concatenate([target, strays]), rm.Rigid(), **given)
    assert searched.evaluated > 0
    np.testing.assert_array_equal(searched.pairs, match.pairs)


@pytest.mark.parametrize("kind", [*EVERY[:-1], "vertical"])
def test_a_prior_tells_symmetric_motions_apart(kind: str) -> None:
    for seed in range(4):
        R, t, target = moved(seed)
        order = np.random.default_rng(seed).permutation(len(target))
        given = TOOL, target[order], rm.Rigid()
        assert rm.match(*given, noise=(0.0, SIGMA)).status is rm.Status.AMBIGUOUS
        prior = knowledge(kind, predicted(R, t, seed))
        match = rm.match(*given, noise=(0.0, SIGMA), prior=prior)
        assert match.status is rm.Status.MATCHED
        np.testing.assert_array_equal(match.assignment, np.argsort(order))
        assert match.prior_holds
        assert match.fused_pose is not None
        assert match.pose is not None
        np.testing.assert_allclose(match.pose.transform(TOOL), target, atol=5 * SIGMA)


@pytest.mark.parametrize("kind", ["rotation", "position"])
def test_vague_knowledge_is_never_called_wrong(kind: str) -> None:
    points = TOOL + np.random.default_rng(0).normal(0.0, 8.0, TOOL.shape)
    R, t, target = moved(2, points)
    for sigma in (0.0, 0.1, 1.0) if kind == "rotation" else (0.0, 1.0, 1e2, 1e4, 1e8):
        known = rm.PosePrior(rotation=(R, sigma)) if kind == "rotation" else rm.PosePrior(position=(t, sigma))
        match = rm.match(points, target, rm.Rigid(), noise=(0.0, SIGMA), prior=known)
        assert match
        assert match.prior_holds, sigma


def test_a_wrong_prior_is_told() -> None:
    """Also by exactly a half turn, of exact targets."""
    points = TOOL + np.random.default_rng(0).normal(0.0, 8.0, TOOL.shape)
    R, t, target = moved(1, points)
    wrong = rm.Pose(R @ np.diag([-1.0, -1.0, 1.0]), t, np.diag(DEVIATION**2))
    match = rm.match(points, points @ R.T + t, rm.Rigid(), noise=(0.0, SIGMA), prior=wrong)
    assert match
    assert match.prior_holds is False
    assert match.fused_pose is None
    assert "this pose contradicts the prior" in match.advice
    assert rm.match(points, 2.0 * target, rm.Similarity(), noise=0.1, prior=predicted(R, 2.0 * t, 1)).prior_holds


def test_priors_that_do_not_go_with_the_rest_are_refused() -> None:
    R, t, target = moved(1)
    prior = predicted(R, t, 1)
    with pytest.raises(rm.InputError, match=r"^prior: a pose in a plane with a covariance \(3, 3\) is needed"):
        rm.match(TOOL[:, :2], target[:, :2], rm.Rigid(), prior=prior)
    with pytest.raises(rm.InputError, match=r"^prior: points of space given; give R \(3, 3\) and t \(3,\)"):
        rm.match(TOOL, target, rm.Rigid(), prior=rm.PosePrior(position=((0.0, 0.0), 1.0)))
    with pytest.raises(rm.InputError, match=r"^prior: some of it is in a plane"):
        rm.PosePrior(position=((0.0, 0.0), 1.0), rotation=(R, 0.1))
    for problem in (rm.Similarity(mirror=True), rm.Rigid(mirror=True)):
        with pytest.raises(rm.InputError, match=r"^problem: .* given; a tracker follows"):
            rm.Tracker(TOOL, problem)
    with pytest.raises(rm.InputError, match=r"^prior: it needs the model of a single motion"):
        rm.match(TOOL, target, rm.Rigid(), prior=prior, motions=2)


def test_a_tracker_follows_tools_that_hide() -> None:
    """Two tools of the same shape but for a few millimetres; one is gone for some frames."""
    rng = np.random.default_rng(8)
    shapes = [rng.uniform(-50.0, 50.0, (4, 3)) for _ in range(2)]
    starts = [Rotation.random(rng=rng) for _ in shapes]
    tracker = rm.Tracker(np.vstack(shapes), rm.Rigid(), noise=(0.0, SIGMA), bodies=np.repeat(["a", "b"], 4))
    held = []
    for k in range(12):
        turn = Rotation.from_rotvec([0.0, 0.01 * k, 0.0])
        seen = [
            (turn * start).apply(shape) + np.array([300.0 * b + 2.0 * k, 0.0, 0.0])
            for b, (start, shape) in enumerate(zip(starts, shapes, strict=True))
        ]
        hidden = 4 <= k < 7
        target = np.vstack([*seen[: 1 if hidden else 2], rng.uniform(-400.0, 400.0, (5, 3))])
        match = tracker.update(target + SIGMA * rng.normal(size=target.shape))
        assert match.bodies is not None
        np.testing.assert_array_equal(match.bodies["a"].assignment, np.arange(4))
        assert match.bodies["a"].status is rm.Status.MATCHED
        assert bool(match.bodies["b"].status) is not hidden
        assert tracker.states["b"] is (rm.TrackingState.COASTING if hidden else rm.TrackingState.TRACKING)
        held.append(match.bodies["a"].prior_holds)
    assert held == [None] + [True] * 11
    tracker.update(np.empty((0, 3)))
    assert tracker.state is rm.TrackingState.COASTING


def test_what_is_where_it_was_predicted_is_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = []
    fit = point_set_model.fit_point_sets
    monkeypatch.setattr(point_set_model, "fit_point_sets", lambda *given: fitted.append(given) or fit(*given))
    bodies, pose = np.repeat(["a", "b"], 5), rm.Pose(np.eye(3), np.zeros(3), np.diag(DEVIATION**2))
    source = np.vstack([TOOL, 1.5 * TOOL + (300.0, 0.0, 0.0)])
    match = rm.match(source, source, rm.Rigid(), noise=(0.0, SIGMA), bodies=bodies, prior={"a": pose, "b": pose})
    assert match.status is rm.Status.MATCHED
    assert len(fitted) == 1  # of both bodies at once


@pytest.mark.parametrize("gap", [1.0, 100.0])
def test_predicted_targets_are_those_that_fit_best_together(gap: float) -> None:
    """Points closer than the prediction is certain: two targets may be either, and each is taken once."""
    source = TOOL * (1.0, gap / 100.0, 1.0)
    clouds = PointClouds(source, source[::-1] + 0.2, *(np.full(5, SIGMA**2),) * 2, scaled=False, mirror=False)
    pose = rm.Pose(np.eye(3), np.zeros(3), np.diag([1e-6] * 3 + [1.0] * 3))
    (assignment,) = MotionPrior(((pose, 1.0),), 0.1).labellings(clouds)
    np.testing.assert_array_equal(assignment, [4, 3, 2, 1, 0])


def test_a_prediction_less_certain_than_points_are_close_is_narrowed_by_its_matches() -> None:
    """Each point's nearest target is another one's, and all of them are off by the same."""
    source = 2.0 * np.stack(np.meshgrid(*[np.arange(4.0)] * 3), axis=-1).reshape(-1, 3)
    source += np.random.default_rng(3).uniform(-0.6, 0.6, source.shape)
    prior = rm.Pose(np.eye(3), np.zeros(3), np.diag([1e-6] * 3 + [0.36] * 3))
    seen = np.arange(0, 64, 5)
    target = source[seen] + (1.0, 0.7, -0.8) + 0.01 * np.random.default_rng(4).normal(size=(13, 3))
    match = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.01), prior=prior)
    assert match.status is rm.Status.MATCHED
    assert match.evaluated == 0
    np.testing.assert_array_equal(match.pairs, np.column_stack([seen, np.arange(13)]))
    excluded = np.ones((64, 13), np.bool_)
    excluded[0, 0] = False
    other = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.01), prior=prior, candidates=excluded)
    np.testing.assert_array_equal(other.pairs, match.pairs[1:])
