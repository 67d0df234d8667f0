"""A predicted pose: what it decides alone, what contradicts it, and its fit against a slow one."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, f, multivariate_normal, multivariate_t

import rootmatch as rm
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_evidence, step_poses, weigh_poses
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.prediction import propose_about
from rootmatch.problems.pose_fit.pose_prior import update_with_vertical
from rootmatch.problems.pose_fit.prior_residuals import Prior
from rootmatch.problems.pose_fit.reference_point import pose_about_point
from test_compiled_predictions import deviations

CAMERA = rm.Camera(800.0, 780.0, 320.0, 240.0)
SPREAD = np.diag([0.02**2] * 3 + [0.02**2] * 3)
T = np.array([0.1, -0.2, 3.0])


def scene(seed: int, points: int = 8, clutter: int = 3, noise: float = 0.3) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=seed).as_matrix()
    source = rng.uniform(-0.5, 0.5, (points, 3))
    pixels = CAMERA.project(source @ R.T + T) + rng.normal(0.0, noise, (points, 2))
    target = np.concatenate([pixels, rng.uniform((0.0, 0.0), (640.0, 480.0), (clutter, 2))])
    order = rng.permutation(len(target))
    return {"source": source, "target": target[order], "truth": np.argsort(order)[:points], "R": R, "noise": noise}


def predicted(made: dict[str, Any], seed: int, scale: float = 1.0, covariance: Any = SPREAD) -> rm.Pose:
    draw = np.random.default_rng([seed, 1]).normal(size=6)
    error = scale * np.linalg.cholesky(np.asarray(covariance)) @ draw
    return rm.Pose(Rotation.from_rotvec(error[:3]).as_matrix() @ made["R"], T + error[3:], covariance)


def matched(made: dict[str, Any], prior: Any, **options: Any) -> rm.Match:
    return rm.match(made["source"], made["target"], rm.P3P(CAMERA), noise=made["noise"], prior=prior, **options)


@pytest.mark.parametrize("seed", range(4))
def test_a_right_prior_decides(seed: int) -> None:
    made = scene(seed)
    match = matched(made, predicted(made, seed))
    assert match.status is rm.Status.MATCHED
    assert match.prior_holds
    assert np.array_equal(match.assignment, made["truth"])
    assert match.evaluated == 0
    assert match.probability is not None
    assert match.probability > 0.9
    pose = match.fused_pose
    assert pose is not None
    assert pose.covariance is not None
    off = np.concatenate([Rotation.from_matrix(made["R"] @ pose.R.T).as_rotvec(), T - pose.t])
    assert off @ np.linalg.solve(pose.covariance, off) < 30.0
    (whole,) = match.poses  # fitted by other code, to the bottom
    assert whole is not None
    assert whole.covariance is not None
    np.testing.assert_allclose(whole.t, pose.t, atol=1e-3)
    np.testing.assert_allclose(np.diag(whole.covariance), np.diag(pose.covariance), rtol=0.05)


def test_three_detections_are_enough() -> None:
    made = scene(5, points=6, clutter=0)
    seen = np.array([0, 2, 5])
    target = made["target"][made["truth"][seen]]
    match = rm.match(
        made["source"], target, rm.P3P(CAMERA), noise=0.3, prior=predicted(made, 5, covariance=SPREAD / 16)
    )
    assert match.status is rm.Status.MATCHED
    assert np.array_equal(match.assignment, [0, -1, 1, -1, -1, 2])
    nothing = rm.match(made["source"], target, rm.P3P(CAMERA), noise=0.3, prior=predicted(made, 5, scale=40.0))
    assert nothing.status is rm.Status.UNTRUSTED
    assert "the detections do not confirm the predicted pose" in nothing.advice


def test_a_wrong_prior_is_noticed() -> None:
    made = scene(2)
    match = matched(made, predicted(made, 2, scale=20.0))
    assert match.status is rm.Status.MATCHED
    assert match.prior_holds is False
    assert "this pose contradicts the prior, which was ignored" in match.advice
    assert np.array_equal(match.assignment, made["truth"])


def test_a_pose_is_compared_with_the_prior_that_it_was_found_about() -> None:
    """Six σ away, where it is still more probable than that the prior is wrong altogether."""
    made = scene(2)
    match = matched(made, rm.Pose(made["R"], T + np.array([0.12, 0.0, 0.0]), SPREAD))
    assert match.status is rm.Status.MATCHED
    assert match.finding.prior_holds
    assert match.prior_holds is False
    assert match.fused_pose is None
    assert "this pose contradicts the prior; check the prior and its σ" in match.advice


@pytest.mark.parametrize("sigma", [10.0, 1e3])
def test_a_prior_that_says_nothing_is_not_contradicted(sigma: float) -> None:
    made = scene(2)
    match = matched(made, rm.Pose(made["R"], T, np.eye(6) * sigma**2))
    assert match.status is rm.Status.MATCHED
    assert match.prior_holds
    assert "contradicts" not in match.advice


def test_the_fit_is_the_least_of_all_deviations() -> None:
    """Against SciPy on the same cost, and the covariance against its Jacobian."""
    made = scene(3)
    covariance = SPREAD + 1e-4 * np.outer(np.arange(6.0), np.arange(6.0)) * 0.1
    given = predicted(made, 3, covariance=covariance)
    centre = made["source"].mean(axis=0)
    prediction = Gaussian(given.R, *pose_about_point(given.R, given.t, covariance, centre))
    sigma = np.full(len(made["target"]), 0.3)
    model = DetectionModel(CAMERA, made["source"], made["target"], sigma, prior=prediction)
    found = propose_about(model, prediction)
    assert found is not None
    np.testing.assert_array_equal(found.assignments[0], made["truth"])
    best, at = weigh_poses(model, *found.take(np.array([0])))
    for _ in range(3):
        best, at = settle_evidence(model, found.assignments[:1], best, at)
    root = np.linalg.cholesky(np.linalg.inv(prediction.covariance)).T

    def residuals(step: Any) -> Any:
        R = Rotation.from_rotvec(step[:3]).as_matrix() @ prediction.rotation
        seen = (made["source"] - centre) @ R.T + prediction.position + step[3:]
        off = CAMERA.project(seen) - made["target"][made["truth"]]
        return np.concatenate([off.ravel() / 0.3, root @ step])

    slow = least_squares(residuals, np.zeros(6), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert best.squared[0] == pytest.approx(2.0 * slow.cost, rel=1e-4)
    expected = np.linalg.inv(slow.jac.T @ slow.jac)
    deviations = np.sqrt(np.diag(expected))
    assert np.abs((best.covariance[0] - expected) / np.outer(deviations, deviations)).max() < 0.1
    (R,), (position,) = step_poses(best, at)
    np.testing.assert_allclose(R, Rotation.from_rotvec(slow.x[:3]).as_matrix() @ prediction.rotation, atol=1e-4)
    np.testing.assert_allclose(position, prediction.position + slow.x[3:], atol=1e-4)


def test_a_prediction_has_the_tails_of_a_t_distribution_and_the_peak_of_a_normal_one() -> None:
    """Of positions alone, whose steps are no rotations: value and slope against SciPy's densities, and the integral."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    covariance = root @ root.T * 1e-4
    one = Gaussian(np.eye(3), np.array([0.0, 0.0, 1.0]), covariance, freedom=5.0)
    tails, peak = multivariate_t(np.zeros(6), covariance, df=5.0), multivariate_normal(np.zeros(6), covariance)
    off = rng.normal(size=(40, 3)) * 0.03 * np.repeat([[0.1], [1.0]], 20, axis=0)
    terms = one.terms(np.repeat(np.eye(3)[None], 40, axis=0), one.position + off)
    steps = np.concatenate([np.zeros((40, 3)), off], axis=1)
    squared = (steps * np.linalg.solve(covariance, steps.T).T).sum(axis=1)
    edge = math.sqrt(6.0) * np.linalg.cholesky(covariance)[:, 0]  # both are equal there, but for a factor
    shift = peak.logpdf(edge) - tails.logpdf(edge)

    def log_shape(step: Any) -> float:
        near = step @ np.linalg.solve(covariance, step) <= 6.0
        return float(peak.logpdf(step) if near else tails.logpdf(step) + shift)

    # the tails' share of a t-distribution: d²/6 has an F-distribution
    mass = chi2.cdf(6.0, 6) + math.exp(shift) * f.sf(1.0, 6, 5.0)
    assert 10 < np.count_nonzero(squared > 6.0) < 30
    exact = np.array([log_shape(step) for step in steps]) - math.log(mass)
    np.testing.assert_allclose(terms.log_density - 0.5 * terms.squared, exact, atol=1e-3)
    ahead = 1e-6 * np.eye(6)
    slope = [[(log_shape(step + d) - log_shape(step - d)) / 2e-6 for d in ahead] for step in steps]
    np.testing.assert_allclose(terms.slope, slope, rtol=1e-3, atol=1e-3)
    assert one.tail_weight(np.array([0.0, 6.0])) == pytest.approx(1.0)
    assert one.tail_weight(np.array([16.0])) == pytest.approx(11.0 / 21.0)


def test_a_density_of_wide_predictions_is_exact() -> None:
    """Covariances of rank one that dwarf the noise, against rational arithmetic, and some a rounding error below."""
    rng = np.random.default_rng(8)
    variance = np.array([0.09, 0.25])
    for size in (1.0, 1e3, 1e6, 1e9):
        direction = size * rng.normal(size=(20, 2))
        spread = direction[:, :, None] * direction[:, None, :]
        target, pixels = rng.uniform(-0.5, 0.5, (2, 2)), rng.uniform(-0.5, 0.5, (20, 2))
        model = DetectionModel(CAMERA, np.zeros((20, 3)), target, np.sqrt(variance))

        def density(spread: Any, model: DetectionModel = model, pixels: Any = pixels) -> Any:
            squared, determinant = deviations(model, pixels, spread)
            return np.exp(-0.5 * squared) / (2.0 * math.pi * np.sqrt(determinant))

        if size < 1e9:
            expected = np.empty((20, 2))
            for i, j in np.ndindex(20, 2):
                u, v, x, y, own = map(Fraction, [*direction[i], *(target[j] - pixels[i]), variance[j]])
                determinant = own * (u * u + v * v + own)
                chi2 = ((v * x - u * y) ** 2 + own * (x * x + y * y)) / determinant
                expected[i, j] = math.exp(-0.5 * float(chi2)) / (2.0 * math.pi * math.sqrt(determinant))
            # the products of a covariance are rounded before their difference is the determinant
            found = density(spread)
            np.testing.assert_allclose(found, expected, rtol=max(1e-9, 2e-14 * size**2))
        for shift in (0.0, -1e-15, -1e-3):
            found = density(spread + shift * size**2 * np.eye(2))
            assert np.all(np.isfinite(found))


def test_a_vertical_narrows_a_prediction() -> None:
    made = scene(4)
    down = np.array([0.0, 2.0, 0.0])
    prior = predicted(made, 4, covariance=SPREAD * 25.0)
    together = update_with_vertical(prior, down, made["R"] @ down, 0.001)
    assert together.covariance is not None
    assert prior.covariance is not None
    assert np.linalg.norm(np.cross(together.R @ down, made["R"] @ down)) < 0.02
    assert np.linalg.slogdet(together.covariance)[1] < np.linalg.slogdet(prior.covariance)[1] - 5.0
    problem = rm.UP2P(CAMERA, made["R"] @ down, down)
    match = rm.match(made["source"], made["target"], problem, noise=0.3, prior=predicted(made, 4))
    assert match.prior_holds
    assert np.array_equal(match.assignment, made["truth"])


@pytest.mark.parametrize(
    ("prior", "text"),
    [
        (np.eye(4), "prior: ndarray given"),
        (rm.Pose(np.eye(3), T), "with a covariance"),
        (rm.Pose(np.eye(2), T[:2], np.eye(3)), "in space"),
        ({"a": rm.Pose(np.eye(3), T, SPREAD)}, "prior: a dict for 'a' given without bodies="),
    ],
)
def test_priors_that_cannot_be_used(prior: Any, text: str) -> None:
    with pytest.raises(rm.InputError, match=text):
        matched(scene(0), prior)


def test_points_of_a_plane_refuse_a_prior_in_space() -> None:
    points = np.random.default_rng(0).normal(size=(6, 2))
    with pytest.raises(
        rm.InputError, match=r"prior: a pose in a plane with a covariance \(3, 3\) or \(4, 4\) is needed"
    ):
        rm.match(points, points, rm.Similarity(2), prior=rm.Pose(np.eye(3), T, SPREAD))


def test_priors_of_bodies() -> None:
    made, other = scene(1), np.random.default_rng(9).uniform(-0.5, 0.5, (5, 3))
    source, labels = np.concatenate([made["source"], other]), ["hmd"] * 8 + ["left"] * 5
    prior = {"hmd": predicted(made, 1)}
    match = rm.match(source, made["target"], rm.P3P(CAMERA), noise=0.3, bodies=labels, prior=prior)
    assert match.bodies is not None
    assert match.bodies["hmd"].prior_holds
    assert np.array_equal(match.bodies["hmd"].assignment, made["truth"])
    with pytest.raises(rm.InputError, match="no body is labelled 'right'"):
        rm.match(source, made["target"], rm.P3P(CAMERA), bodies=labels, prior={"right": prior["hmd"]})
    with pytest.raises(rm.InputError, match="give a dict"):
        rm.match(source, made["target"], rm.P3P(CAMERA), bodies=labels, prior=prior["hmd"])


@pytest.mark.parametrize("angle", [1e-3, 0.1, 0.8])
def test_a_fit_with_a_prediction_has_the_derivatives_of_its_residuals(angle: float) -> None:
    """With others a fit hardly ever settles: a pose of a tracker took 300 steps."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    pose = rm.Pose(Rotation.random(random_state=3).as_matrix(), rng.normal(size=3), root @ root.T)
    prior = Prior.of(pose, rng.normal(size=3), 2.0, pose)
    axis, step = rng.normal(size=3), 1e-6
    R = (Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix() @ pose.R)[None]
    t = prior.translation + rng.normal(0.0, 0.3, (1, 3))
    for column, one in zip(prior.jacobian(R, np.eye(3))[0].T, step * np.eye(6), strict=True):
        turns = [Rotation.from_rotvec(k * one[:3]).as_matrix() @ R for k in (1.0, -1.0)]
        ahead, back = prior.residuals(turns[0], t + one[3:])[0], prior.residuals(turns[1], t - one[3:])[0]
        np.testing.assert_allclose(column, (ahead - back) / (2.0 * step), rtol=1e-6, atol=1e-6)
