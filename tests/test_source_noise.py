"""Noise of source points: what is refused, what it does to fits and covariances, and what it lets be believed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.problems.noise import check_source_noise
from rootmatch.problems.pose_fit.shared_errors import remaining_prediction_error

Floats = NDArray[np.float64]
CAMERA = rm.Camera(1500.0, 1500.0, 640.0, 480.0)
SIGMA, PIXEL = 0.5, 0.3


class Scene:
    """A body of 200 mm whose model is good to half a millimetre, 1.5 m away, and clutter."""

    def __init__(self, seed: int, points: int = 10, clutter: int = 5, covariance: Floats | None = None) -> None:
        rng = np.random.default_rng([seed, 30])
        self.model = rng.uniform(-100.0, 100.0, (points, 3))
        self.covariance = np.eye(3) * SIGMA**2 if covariance is None else covariance
        made = self.model + rng.multivariate_normal(np.zeros(3), self.covariance, points)
        self.R = Rotation.random(random_state=seed).as_matrix()
        self.t = np.array([20.0, -30.0, 1500.0])
        self.placed = made @ self.R.T + self.t
        pixels = CAMERA.project(self.placed) + rng.normal(0.0, PIXEL, (points, 2))
        self.target = np.vstack([pixels, rng.uniform((0, 0), (1280, 960), (clutter, 2))])
        self.truth = np.arange(points)

    def match(self, **options: Any) -> rm.Match:
        return rm.match(self.model, self.target, rm.P3P(CAMERA), **{"noise": PIXEL, "source_noise": SIGMA} | options)

    def squared_error(self, pose: rm.Pose) -> float:
        assert pose.covariance is not None
        error = np.concatenate([Rotation.from_matrix(self.R @ pose.R.T).as_rotvec(), self.t - pose.t])
        return float(error @ np.linalg.solve(pose.covariance, error))


@pytest.mark.parametrize(
    ("noise", "text"),
    [
        ("much", "not an array of numbers"),
        (np.ones(9), r"shape \(9,\) given; give σ as one number, \(10,\) or \(10, 3\), or covariances \(10, 3, 3\)"),
        (np.ones((3, 3)), r"shape \(3, 3\) given"),
        (np.nan, "NaN or infinity"),
        (np.inf, "NaN or infinity"),
        (-0.1, "-0.1 given; a standard deviation is not negative"),
        (np.tile(np.triu(np.ones((3, 3))), (10, 1, 1)), "a covariance is not symmetric"),
        (np.tile(np.diag([1.0, 1.0, -1.0]), (10, 1, 1)), "a covariance has a negative eigenvalue"),
        (1e6, "more than the distance between points"),
    ],
)
def test_what_is_no_noise_of_points_is_refused_once(noise: Any, text: str) -> None:
    scene = Scene(0)
    with pytest.raises(rm.InputError, match=f"^source_noise: .*{text}") as refused:
        scene.match(source_noise=noise)
    assert "\n" not in str(refused.value)
    with pytest.raises(rm.InputError, match=f"^source_noise: .*{text}"):
        rm.Matcher(scene.model, rm.P3P(CAMERA), source_noise=noise)


def test_problems_without_a_pose_of_their_camera_refuse_it() -> None:
    scene = Scene(0)
    with pytest.raises(rm.InputError, match=r"^source_noise: up2pf has exact source points"):
        rm.match(scene.model, scene.target, rm.UP2PF((640.0, 480.0), (0, 1, 0), (0, 1, 0)), source_noise=SIGMA)
    with pytest.raises(rm.InputError, match=r"^source_noise: noise is a pair"):
        rm.match(scene.model, scene.placed, rm.Rigid(), noise=(0.1, 0.1), source_noise=SIGMA)
    apart = rm.match(scene.model, scene.placed, rm.Rigid(), noise=(0.0, 0.1), source_noise=SIGMA)
    together = rm.match(scene.model, scene.placed, rm.Rigid(), noise=(SIGMA, 0.1))
    assert apart.log_odds == together.log_odds


def test_every_way_to_say_it_is_the_same() -> None:
    n = 10
    whole = np.tile(SIGMA**2 * np.eye(3), (n, 1, 1))
    points = Scene(0).model
    for noise in (SIGMA, np.full(n, SIGMA), np.full((n, 3), SIGMA), whole):
        np.testing.assert_allclose(check_source_noise(noise, points), whole, rtol=1e-14)


@pytest.mark.parametrize("context", ["camera", "rig", "rays"])
def test_a_pose_is_fitted_with_the_covariance_of_each_projection(context: str) -> None:
    """Against a slow fit whose unknowns are the pose and the true points."""
    covariance = np.diag([1.0, 0.04, 0.25])
    scene = Scene(3, clutter=0, covariance=covariance)
    noise = np.tile(covariance, (10, 1, 1))
    problem, target, sigma = rm.P3P(CAMERA), scene.target, PIXEL
    if context == "rig":
        problem, target = rm.P3P(rm.Rig([(CAMERA, np.eye(3), np.zeros(3))])), np.c_[target, np.zeros(10)]
    elif context == "rays":
        problem, target, sigma = rm.P3P(rm.Bearings()), CAMERA.bearings(target), PIXEL / 1500.0
    match = rm.match(scene.model, target, problem, noise=sigma, source_noise=noise)
    np.testing.assert_array_equal(match.assignment, scene.truth)
    pose, deviation = match.pose, np.sqrt(np.diag(covariance))
    assert pose is not None
    assert pose.covariance is not None

    def residuals(x: Floats) -> Floats:
        points = scene.model + x[6:].reshape(-1, 3) * deviation
        placed = points @ (Rotation.from_rotvec(x[:3]).as_matrix() @ pose.R).T + pose.t + x[3:6]
        return np.concatenate([((CAMERA.project(placed) - scene.target) / PIXEL).ravel(), x[6:]])

    best = least_squares(residuals, np.zeros(36), x_scale=np.r_[np.full(3, 1e-4), np.full(3, 0.1), np.ones(30)])
    expected = np.linalg.inv(best.jac.T @ best.jac)[:6, :6]
    scale = np.sqrt(np.diag(expected))
    tolerance = 0.05 if context != "rays" else 0.2  # a pixel is taken as a round patch of the sphere
    np.testing.assert_allclose(best.x[:6] / scale, 0.0, atol=tolerance)
    np.testing.assert_allclose(pose.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.05)


def test_a_model_of_half_a_millimetre_is_believed_and_its_poses_cover_the_truth() -> None:
    trusted, squared, blind = 0, [], 0
    for seed in range(30):
        scene = Scene(seed)
        match = scene.match(seed=seed)
        blind += bool(scene.match(source_noise=None, seed=seed))
        if match and match.pose is not None:
            trusted += not ((match.assignment >= 0) & (match.assignment != scene.truth)).any()
            squared.append(scene.squared_error(match.pose))
    assert trusted >= 28
    assert blind <= trusted - 8
    assert np.mean(np.array(squared) < 12.592) >= 0.85  # 0.95 are expected


@pytest.mark.parametrize("called", ["prior", "Tracker"])
def test_a_prediction_counts_it(called: str) -> None:
    covered = []
    for seed in range(12):
        scene = Scene(seed)
        prior = rm.Pose(scene.R, scene.t + np.array([3.0, -2.0, 4.0]), np.diag([1e-4] * 3 + [25.0] * 3))
        if called == "prior":
            match = scene.match(prior=prior)
        else:
            tracker = rm.Tracker(scene.model, rm.P3P(CAMERA), noise=PIXEL, source_noise=SIGMA)
            tracker.update(scene.target)
            match = tracker.update(scene.target)
        np.testing.assert_array_equal(match.assignment, scene.truth)
        assert match.prior_holds
        if called == "prior":
            assert match.fused_pose is not None
            covered.append(scene.squared_error(match.fused_pose) < 16.8)
    assert np.mean(covered or 1.0) >= 0.9


def test_axes_of_two_point_sets_differ() -> None:
    """A tracker that is ten times worse along its axis: the fit has the right weights, and covers the truth."""
    deviation = np.array([0.1, 0.1, 1.0])
    squared: dict[str, list[float]] = {"axes": [], "mean": []}
    for seed in range(24):
        scene = Scene(seed, clutter=0, covariance=np.zeros((3, 3)))
        rng = np.random.default_rng([seed, 31])
        target = scene.placed + rng.normal(0.0, deviation, scene.placed.shape)
        for name, noise in (("axes", np.tile(deviation, (10, 1))), ("mean", np.sqrt(np.mean(deviation**2)))):
            match = rm.match(scene.model, target, rm.Rigid(), noise=(0.0, noise))
            np.testing.assert_array_equal(match.assignment, scene.truth)
            assert match.pose is not None
            error = match.pose.t - scene.t
            squared[name].append(float(error @ error))
            if name == "axes":
                squared.setdefault("normalised", []).append(scene.squared_error(match.pose))
    assert np.mean(squared["axes"]) < 0.97 * np.mean(squared["mean"])
    assert 4.5 < np.mean(squared["normalised"]) < 7.5  # six degrees of freedom


def test_covariances_of_two_point_sets_turn_with_the_source() -> None:
    scene = Scene(1, clutter=0, covariance=np.diag([1.0, 0.01, 0.01]))
    whole = np.tile(scene.covariance, (10, 1, 1))
    by_source = rm.match(scene.model, scene.placed, rm.Rigid(), noise=1e-3, source_noise=whole)
    turned = np.tile(scene.R @ scene.covariance @ scene.R.T, (10, 1, 1))
    by_target = rm.match(scene.model, scene.placed, rm.Rigid(), noise=(1e-3, turned))
    assert by_source.pose is not None
    assert by_target.pose is not None
    np.testing.assert_allclose(by_source.pose.t, by_target.pose.t, atol=1e-3)
    np.testing.assert_allclose(by_source.pose.covariance, by_target.pose.covariance, rtol=0.02, atol=1e-7)


def test_noise_of_detections_is_estimated_beside_that_of_the_model() -> None:
    """Which is stated, and spreads an image by as much as the detections have."""
    factors, right = [], 0
    for seed in range(12):
        scene = Scene(seed)
        match = scene.match(noise="auto")
        factors.append(match.noise / PIXEL)
        right += bool(match) and bool((match.assignment == scene.truth).all())
    assert right >= 11
    assert 0.5 < np.median(factors) < 1.5


def test_noise_is_not_estimated_beside_that_of_one_of_two_point_sets() -> None:
    scene = Scene(0)
    with pytest.raises(
        rm.InputError, match=r"^noise: .*source_noise= cannot be combined for point sets; give a number"
    ):
        rm.match(scene.model, scene.placed, rm.Rigid(), noise="auto", source_noise=SIGMA)


def cameras_of(kind: str) -> list[tuple[rm.Camera, Floats, Floats]]:
    """One camera, a fisheye, or two cameras, in the unit of `Scene`."""
    if kind == "rig":
        aside = Rotation.from_euler("y", 25.0, degrees=True).as_matrix()
        return [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, aside, np.array([-600.0, 0.0, 100.0]))]
    lens = KannalaBrandt((-0.01, 0.002, 0.0, 0.0)) if kind == "fisheye" else None
    return [(rm.Camera(1500.0, 1500.0, 640.0, 480.0, lens), np.eye(3), np.zeros(3))]


@pytest.mark.parametrize("kind", ["fisheye", "rig", "half of the points in turn"])
def test_frames_do_not_average_the_errors_of_a_model_out(kind: str) -> None:
    """They are the same in all frames: after 30 of them, poses are as wrong as their covariance says."""
    views, squared, vague = cameras_of(kind), [], np.diag([0.2**2] * 3 + [50.0**2] * 3)
    for seed in range(10):
        scene, rng = Scene(seed, points=12, clutter=0), np.random.default_rng([seed, 31])
        problem = rm.P3P(rm.Rig(views)) if kind == "rig" else rm.P3P(views[0][0])
        tracker = rm.Tracker(scene.model, problem, noise=PIXEL, source_noise=SIGMA, max_seconds=5.0)
        for k in range(30):
            shown = np.arange(12) % 2 == k // 5 % 2 if kind.startswith("half") else np.full(12, True)
            images = [camera.project(scene.placed[shown] @ R.T + t) for camera, R, t in views]
            target = np.concatenate(images) + rng.normal(0.0, PIXEL, (len(views) * shown.sum(), 2))
            detections: Any = (target, np.repeat(np.arange(len(views)), shown.sum())) if kind == "rig" else target
            prior = {} if k else {"prior": rm.Pose(scene.R, scene.t, vague)}
            match = tracker.update(detections, time=k / 240.0, **prior)
        assert match
        assert match.fused_pose is not None
        squared.append(scene.squared_error(match.pose))
        assert scene.squared_error(match.fused_pose) == pytest.approx(squared[-1], rel=0.3, abs=0.5)
    assert 0.6 < np.mean(squared) / 6.0 < 1.5


def test_a_vaguer_pose_from_a_caller_leaves_little_of_a_prediction() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    predicted = root @ root.T
    fitted = root @ np.diag([0.25, 0.5, 1.0, 1.0, 4.0, 100.0]) @ root.T
    left = np.linalg.solve(root, remaining_prediction_error(fitted, predicted) @ root)
    np.testing.assert_allclose(left, np.diag([0.25, 0.5, 1.0, 1.0, 0.25, 0.01]), atol=1e-6)


def test_a_part_of_the_pose_may_be_known_exactly() -> None:
    scene, rng = Scene(4, clutter=0), np.random.default_rng(4)
    known = rm.PosePrior(rotation=(scene.R, 0.0), position=(scene.t, 0.0))
    tracker = rm.Tracker(scene.model, rm.P3P(CAMERA), noise=PIXEL, source_noise=SIGMA)
    for k in range(4):
        target = CAMERA.project(scene.placed) + rng.normal(0.0, PIXEL, (10, 2))
        prior = known if k else rm.Pose(scene.R, scene.t, np.diag([0.1**2] * 3 + [30.0**2] * 3))
        match = tracker.update(target, prior=prior)
        assert match
        assert match.pose.covariance is not None
        assert np.isfinite(match.pose.covariance).all()


def test_detections_are_taken_through_the_lens_once_for_all_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every body of a frame, and every search for it, asks for the noise that its model adds there."""
    lens, rng = Brown((-0.1, 0.02, 0.001, 0.0)), np.random.default_rng(7)
    camera, asked = rm.Camera(800.0, 800.0, 320.0, 240.0, lens=lens), list[int]()
    before = Brown.rays

    def counted(self: Brown, image: NDArray[np.float64]) -> NDArray[np.float64]:
        asked.append(len(image))
        return before(self, image)

    monkeypatch.setattr(Brown, "rays", counted)
    problem, target = rm.P3P(camera), rng.uniform((0.0, 0.0), (640.0, 480.0), (9, 2))
    for _ in range(3):
        points = problem.validated(rng.uniform(-0.1, 0.1, (6, 3)), target, source_noise=1e-3)
        assert (points.target_noise > points.detection_noise).all()
    assert asked == [9]
