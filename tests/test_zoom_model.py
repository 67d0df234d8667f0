"""The model of an image of unknown focal length: its integral against sampling, its poses, and whom it trusts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import gammaln, logsumexp

import robot_scenes
import rootmatch as rm
from instances import axis_rotation, project
from oracles import log_first
from robot_scenes import DOWN
from rootmatch.algebra.rotation import rotation_about_y
from rootmatch.model.evidence import settle_evidence, weigh_poses
from rootmatch.model.zoom_model import ZoomModel, decode_zoom, encode_zoom
from rootmatch.problems.pose_fit.prior_residuals import Upright

CENTRE, SIGMA = (320.0, 240.0), 0.5
USUAL = 1.2 * 640.0


def problem_of(scene: robot_scenes.Scene) -> rm.UP2PF:
    return rm.UP2PF(CENTRE, tuple(scene.vertical), (0.0, 1.0, 0.0))


def model_of(scene: robot_scenes.Scene) -> ZoomModel:
    sigma = np.full(len(scene.target), SIGMA)
    return ZoomModel.of(np.array(CENTRE), problem_of(scene).upright, scene.source, scene.target, sigma=sigma)


class Sampled:
    """log B by importance sampling over turn, logarithm of the focal length, and position, with formulas of its own."""

    def __init__(self, scene: robot_scenes.Scene, model: ZoomModel, assignment: np.ndarray) -> None:
        self.scene, self.model, self.assignment = scene, model, assignment
        self.used = assignment >= 0
        self.centred = scene.source - scene.source.mean(axis=0)
        self.place = scene.translation + scene.rotation @ scene.source.mean(axis=0)

    def image(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels (K, n, 2), depths (K, n) and positions (K, 3) of steps (K, 5) from the true pose."""
        x, place = self.places(v), self.place + v[:, 2:]
        focal = self.scene.focal * np.exp(v[:, 1])
        return focal[:, None, None] * x[..., :2] / x[..., 2:] + CENTRE, x[..., 2], place

    def places(self, v: np.ndarray) -> np.ndarray:
        """Points (K, n, 3) in the camera frame."""
        turns = np.array([axis_rotation(DOWN, angle) for angle in v[:, 0]])
        place = self.place + v[:, 2:]
        return np.asarray(np.einsum("ij,kjl,nl->kni", self.scene.rotation, turns, self.centred) + place[:, None])

    def squared(self, v: np.ndarray) -> np.ndarray:
        pixels, _, _ = self.image(v)
        off = (pixels[:, self.used] - self.scene.target[self.assignment[self.used]]) / SIGMA
        return np.asarray((off**2).sum(axis=(1, 2)))

    def log_density(self, v: np.ndarray) -> np.ndarray:
        """Logarithm of likelihood ratio and prior."""
        _, depth, place = self.image(v)
        k, n, count = int(self.used.sum()), len(self.used), len(self.scene.target)
        scale = np.exp(np.linspace(-1.5, 1.5, 31))
        weight = 10.0 * math.log(10.0) - gammaln(10.0) - 10.0 * np.log(scale) - 10.0 / scale + math.log(3.0 / 30.0)
        noisy = logsumexp(weight - k * np.log(scale) - 0.5 * self.squared(v)[:, None] / scale, axis=1)
        own = self.assignment[self.used]
        clutter = -self.model.clutter.log_density[own].sum() + gammaln(count - k + 0.5) - gammaln(count + 0.5)
        clutter += log_first(self.model.clutter, np.isin(np.arange(count), own))
        shown = gammaln(k + 1) + gammaln(n - k + 1) - gammaln(n + 2)  # a rate that is uniform
        log_zoom = np.log(self.scene.focal / USUAL) + v[:, 1]
        prior = -math.log(2.0 * math.pi) - 0.5 * log_zoom**2 - 0.5 * math.log(2.0 * math.pi)
        radius2 = ((self.scene.source - self.scene.source.mean(axis=0)) ** 2).sum(axis=1).mean()
        prior = prior - np.log(2.0 * ((place**2).sum(axis=1) + radius2) ** 1.5 * math.log(100.0))
        prior = prior + math.log(0.9)  # nothing hides a part: at most two points are missing
        away = np.linalg.norm(self.places(v), axis=2)  # and all of it is within the limit of distance
        places = (np.arange(200) + 0.5) / 200 * math.log(100.0)
        beyond = (away / away.min(axis=1, keepdims=True))[..., None] ** 16 * np.exp(-16.0 * places)
        left = np.where(self.used[:, None], np.log1p(beyond), 0.0).sum(axis=1)
        prior = prior + np.log((np.exp(-left) * 2.0 * (1.0 - places / math.log(100.0)) / 200).sum(axis=1))
        total = noisy + clutter + shown + prior - k * math.log(2.0 * math.pi * SIGMA**2)
        return np.asarray(np.where((depth > 0.0).all(axis=1), total, -np.inf))

    def log_odds(self, draws: int = 10_000) -> float:
        """The integral, by Student's t with four degrees of freedom about the best fit."""

        def residual(v: np.ndarray) -> np.ndarray:
            pixels = self.image(v[None])[0][0]
            off = (pixels[self.used] - self.scene.target[self.assignment[self.used]]) / SIGMA
            return np.append(off.ravel(), np.log(self.scene.focal / USUAL) + v[1])

        best = least_squares(residual, np.zeros(5), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        root, freedom = np.linalg.cholesky(1.7 * np.linalg.inv(best.jac.T @ best.jac)), 4.0
        rng = np.random.default_rng(0)
        z = rng.standard_normal((draws, 5)) * np.sqrt(freedom / rng.chisquare(freedom, (draws, 1)))
        log_q = gammaln(4.5) - gammaln(2.0) - 2.5 * math.log(freedom * math.pi) - np.log(np.diag(root)).sum()
        log_q = log_q - 4.5 * np.log1p((z**2).sum(axis=1) / freedom)
        value = self.log_density(best.x + z @ root.T) - log_q
        return float(logsumexp(value) - math.log(draws))


def best(model: ZoomModel, scene: robot_scenes.Scene, assignment: np.ndarray):  # type: ignore[no-untyped-def]
    rotation = model.encode_focal(scene.rotation[None], np.log([scene.focal]))
    place = (scene.translation + scene.rotation @ scene.source.mean(axis=0))[None]
    found, at = weigh_poses(model, assignment[None], rotation, place)
    for _ in range(3):
        found, at = settle_evidence(model, assignment[None], found, at)
    return found, at


@pytest.mark.parametrize(("count", "depth"), [(4, 8.0), (5, 8.0), (8, 8.0), (8, 30.0)])
def test_laplace_is_near_the_integral_over_poses_and_focal_lengths(count: int, depth: float) -> None:
    errors = []
    for seed in range(1000, 1004):
        scene = robot_scenes.zoomed(count, 4, SIGMA, seed, depth=depth)
        model = model_of(scene)
        found, _ = best(model, scene, scene.truth)
        errors.append(float(found.log_odds[0]) - Sampled(scene, model, scene.truth).log_odds())
    assert np.abs(errors).max() < 0.25, errors
    assert abs(np.median(errors)) < 0.05, errors


def test_a_rotation_holds_a_focal_length() -> None:
    rng = np.random.default_rng(1000)
    for _ in range(5):
        scene = robot_scenes.zoomed(4, seed=int(rng.integers(1000)))
        upright: Upright = problem_of(scene).upright
        angle, log_zoom = rng.uniform(-3.1, 3.1, 20), rng.uniform(-2.9, 2.9, 20)
        level = upright.camera.T @ rotation_about_y(np.cos(angle), np.sin(angle)) @ upright.world
        told, again = decode_zoom(upright, encode_zoom(upright, level, log_zoom))
        np.testing.assert_allclose(told, log_zoom, atol=1e-12)
        np.testing.assert_allclose(again, level, atol=1e-12)


def test_images_change_with_a_pose_as_their_derivatives_say() -> None:
    scene = robot_scenes.zoomed(6, 0, SIGMA, 1000)
    model = model_of(scene)
    _, at = best(model, scene, scene.truth)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5
        ends = []
        for sign in (1.0, -1.0):
            turn = axis_rotation(np.eye(3)[k], sign * 1e-5) if k < 3 else np.eye(3)
            moved = model.linearise_about((turn @ at.rotation[0])[None], at.position + sign * step[3:])
            ends.append(moved.pixels[0])
        np.testing.assert_allclose(at.jacobian[0] @ step, 0.5 * (ends[0] - ends[1]), atol=1e-6)


def test_the_pose_of_the_model_is_that_of_the_fit() -> None:
    """Which knows nothing of it; a prior of the focal length moves it by a small part of its σ."""
    scene = robot_scenes.zoomed(10, 0, SIGMA, 1001)
    model = model_of(scene)
    found, at = best(model, scene, scene.truth)
    ours = model.pose_of_origin(at.rotation[0], at.position[0], found.covariance[0])
    match = rm.match(scene.source, scene.target, problem_of(scene), noise=SIGMA)
    fit = match.pose
    assert fit is not None
    assert fit.covariance is not None
    assert ours.covariance is not None
    sigma = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(ours.covariance)), sigma, rtol=0.02, atol=1e-9)
    np.testing.assert_allclose(
        ours.covariance / np.outer(sigma, sigma), fit.covariance / np.outer(sigma, sigma), atol=0.04
    )
    np.testing.assert_allclose(ours.t, fit.t, atol=0.1 * sigma[3:6].max())
    assert abs(ours.focal - fit.focal) < 0.1 * sigma[6]
    assert fit.chi2 is not None


def tower(seed: int) -> tuple[np.ndarray, robot_scenes.Scene]:
    """Three square floors, and their image: each quarter of a turn maps the tower onto itself."""
    floors = ((-1.5, 0.8), (0.0, 1.0), (1.5, 1.2))
    source = np.array([(x, y, z) for y, half in floors for x in (-half, half) for z in (-half, half)])
    scene = robot_scenes.zoomed(4, 0, 0.0, seed)
    rng = np.random.default_rng(seed)
    image = project(source @ scene.rotation.T + scene.translation, (scene.focal, scene.focal, *CENTRE))
    order = rng.permutation(len(source))
    target = (image + SIGMA * rng.normal(size=image.shape))[order]
    return source, scene._replace(source=source, target=target, truth=np.argsort(order))


def test_a_tower_of_four_equal_sides_is_ambiguous_and_all_four_are_listed() -> None:
    for seed in (1000, 1001, 1002):
        source, scene = tower(seed)
        match = rm.match(source, scene.target, problem_of(scene), noise=SIGMA)
        assert match.status is rm.Status.AMBIGUOUS
        assert match.probability is not None
        assert match.probability < 0.5
        turned = [
            scene.truth[[int(np.linalg.norm(source - p, axis=1).argmin()) for p in source @ axis_rotation(DOWN, a).T]]
            for a in np.arange(4) * math.pi / 2.0
        ]
        listed = [match.assignment, *(other for other, _ in match.alternatives)]
        assert all(any((one == other).all() for one in listed) for other in turned)


def test_unrelated_points_are_not_trusted_and_have_a_low_probability() -> None:
    for seed in range(1000, 1012):
        scene = robot_scenes.zoomed(4 + seed % 6, 0, SIGMA, seed)
        target = np.random.default_rng(seed).uniform((0.0, 0.0), (640.0, 480.0), (4 + seed % 9, 2))
        match = rm.match(scene.source, target, problem_of(scene), noise=SIGMA)
        assert match.status is rm.Status.UNTRUSTED
        assert match.probability is not None
        assert match.probability < 0.5


@pytest.mark.parametrize("options", [{}, {"sampler": "exhaustive"}, {"solver": "bcagm"}, {"residual": "normalised"}])
def test_every_way_to_propose_is_judged_by_the_model(options: dict[str, str]) -> None:
    scene = robot_scenes.zoomed(8, 2, SIGMA, 1000)
    match = rm.match(scene.source, scene.target, problem_of(scene), noise=SIGMA, **options)
    assert match
    assert np.array_equal(match.assignment, scene.truth)
    assert match.probability == pytest.approx(0.999, abs=1e-3)
    assert (match.confidence > 0.95).all()
    assert match.log_odds is not None
    assert match.log_odds > 20.0


def test_the_preset_of_the_paper_has_no_probability() -> None:
    scene = robot_scenes.zoomed(6, 0, SIGMA, 1000)
    match = rm.match(scene.source, scene.target, problem_of(scene), noise=SIGMA, preset="paper", samples=2_000)
    assert match.probability is None


def test_a_scene_beyond_any_sweep_is_searched() -> None:
    scene = robot_scenes.zoomed(20, 25, SIGMA, 1000)
    match = rm.match(scene.source, scene.target, problem_of(scene), noise=SIGMA)
    assert match
    assert np.array_equal(match.assignment, scene.truth)
    assert match.pose is not None
    assert match.pose.focal == pytest.approx(scene.focal, rel=0.1)


def test_several_bodies_and_unknown_noise_as_before() -> None:
    scene = robot_scenes.zoomed(8, 2, SIGMA, 1000)
    problem, both = problem_of(scene), np.concatenate([scene.source, scene.source + 50.0])
    match = rm.match(both, scene.target, problem, noise=SIGMA, bodies=[0] * 8 + [1] * 8)
    assert match.bodies is not None
    assert match.bodies[0]
    assert match.bodies[0].probability is not None
    estimated = rm.match(scene.source, scene.target, problem, noise="auto")
    assert estimated
    assert 0.5 * SIGMA < estimated.noise < 2.0 * SIGMA


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_a_part_of_a_flat_ceiling_is_matched_if_its_zoom_is_told_or_not(tilt: float) -> None:
    rng = np.random.default_rng(1000)
    ceiling = np.column_stack([rng.uniform(-6.0, 6.0, (200, 2)), np.full(200, 6.0)])
    rotation = axis_rotation(np.array([1.0, 0.0, 0.0]), tilt) @ axis_rotation(np.array([0.0, 0.0, 1.0]), 2.0)
    places = ceiling @ rotation.T
    image = 700.0 * places[:, :2] / places[:, 2:] + CENTRE
    seen = np.flatnonzero((np.abs(image - CENTRE) < CENTRE).all(axis=1))
    strays = rng.uniform((0.0, 0.0), (640.0, 480.0), (4, 2))
    target = np.concatenate([image[seen] + rng.normal(0.0, 0.25, (len(seen), 2)), strays])
    problem = rm.UP2PF(CENTRE, tuple(rotation @ (0.0, 0.0, -1.0)), (0.0, 0.0, -1.0))
    match = rm.match(ceiling, target, problem, noise=0.25)
    truth = np.full(200, -1)
    truth[seen] = np.arange(len(seen))
    assert match
    assert np.array_equal(match.assignment, truth)
    assert match.pose is not None
    assert match.pose.focal is not None
    told = np.sqrt(match.pose.covariance[6, 6]) / match.pose.focal
    assert told < 0.1 if tilt else told > 1.0
    assert tilt == 0.0 or match.pose.focal == pytest.approx(700.0, rel=4.0 * told)
