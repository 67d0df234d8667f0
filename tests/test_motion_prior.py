"""What is known of the motion between two point sets: its factor against sampling, matches with it, and a tracker."""

from __future__ import annotations

import math

import numpy as np
import pytest
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
    extents, _, _, axes = model._clutter_space
    box = axes * extents
    factor = MotionPrior(((knowledge(kind, pose), 1.0),), 1e-12).log_factors(fit, box)[0, 0]
    assert factor + fit.evidence[0] - model.log_volume == pytest.approx(expected, abs=0.15)


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
    with pytest.raises(rm.InputError, match=r"^prior: points of a plane given"):
        rm.match(TOOL[:, :2], target[:, :2], rm.Rigid(), prior=prior)
    with pytest.raises(rm.InputError, match=r"^problem: .*dimension=2.* given; a tracker follows .* in space"):
        rm.Tracker(TOOL[:, :2], rm.Rigid())
    for problem in (rm.Similarity(mirror=True), rm.Rigid(mirror=True)):
        with pytest.raises(rm.InputError, match=r"^problem: .* given; a tracker follows"):
            rm.Tracker(TOOL, problem)
    with pytest.raises(rm.InputError, match=r"^prior: it is weighed by the model of one motion"):
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
