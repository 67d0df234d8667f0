"""The model of two views: its density, its sums over assignments, its evidence against a sampler of the test's own."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import gammaln, logsumexp
from scipy.stats import beta, gamma, invgamma, t

import rootmatch as rm
from robot_scenes import INTRINSICS, robot
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.two_view_decision import make_two_view_model
from rootmatch.model.matchings import sum_matchings
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.model.two_view_fit import fit_relative_poses
from rootmatch.model.two_view_model import SCALES, SPREADS, Relative, TwoViewModel
from rootmatch.model.two_view_posterior import sample_two_view_posterior
from rootmatch.simulation import three_plus_one_scene


def model_of_scene(scene) -> TwoViewModel:  # type: ignore[no-untyped-def]
    model = make_two_view_model(MatchingTask.of(scene.problem, scene.source, scene.target, noise=scene.noise))
    assert model is not None
    return model


def planar_model(n: int, clutter: int, seed: int) -> tuple[TwoViewModel, np.ndarray]:
    scene = robot(n, clutter, 0.5, seed)
    axis = tuple(scene.vertical)
    problem = rm.PlanarMotion(rm.Camera(*INTRINSICS), axis=axis, axis2=axis)
    model = make_two_view_model(MatchingTask.of(problem, scene.source, scene.target, noise=0.5))
    assert model is not None
    return model, scene.truth


@pytest.mark.parametrize(("scale", "bound"), [(0.3, 0.03), (0.02, 0.12), (0.002, 0.5)])
def test_the_density_of_a_detection_integrates_to_one(scale: float, bound: float) -> None:
    """Noise of the parallax is of first order: a tenth is off at ten σ, a half at one."""
    sigma = 0.001
    u, baseline = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0]), np.array([0.6, 0.0, 0.8])
    e, phi = np.meshgrid(np.linspace(-0.02, 0.02, 241), np.linspace(-0.02, np.arccos(u @ baseline) - 1e-4, 6001))
    normal = np.cross(baseline, u) / np.linalg.norm(np.cross(baseline, u))
    towards = baseline - (u @ baseline) * u
    towards /= np.linalg.norm(towards)
    in_plane = np.cos(phi)[..., None] * u + np.sin(phi)[..., None] * towards
    p = np.cos(e)[..., None] * in_plane + np.sin(e)[..., None] * normal
    count = p.size // 3
    variance = np.full(count, 0.5 * sigma**2)
    model = TwoViewModel(u[None], p.reshape(-1, 3), variance[:1], variance, np.zeros(count))
    pose = Relative(np.zeros(1), baseline[None], np.zeros((1, 2)), np.log([scale]), np.log([0.4]))
    density = np.exp(model.seen(pose, np.zeros(count, np.int64), np.arange(count)).log_density).reshape(e.shape)
    density *= np.cos(e)
    total = np.trapezoid(np.trapezoid(density, e[0], axis=1), phi[:, 0])
    assert total == pytest.approx(1.0, abs=bound)


def test_sums_over_assignments_are_those_of_three_matches_and_more() -> None:
    rng = np.random.default_rng(0)
    odds = rng.normal(0.0, 2.0, (3, 4, 5))
    odds[:, 1, 2] = odds[:, 3, :2] = -np.inf
    rows, columns = np.divmod(np.arange(20), 5)
    found = sum_matchings(odds.reshape(3, 20), rows, columns, np.array([2, 0, 3, 1]), -50.0)
    total, marginals = np.zeros(3), np.zeros((3, 4, 5))
    for one in itertools.product(range(-1, 5), repeat=4):
        used = [(i, k) for i, k in enumerate(one) if k >= 0]
        if len({k for _, k in used}) == len(used) >= 3:
            value = np.exp(sum((odds[:, i, k] for i, k in used), np.zeros(3)))
            total += value
            for i, k in used:
                marginals[:, i, k] += value
    np.testing.assert_allclose(found.log_total, np.log(total))
    np.testing.assert_allclose(found.marginals, (marginals / total[:, None, None])[:, found.rows, found.columns])


def log_densities(model: TwoViewModel, turn, heading, scale, spread, factor):  # type: ignore[no-untyped-def]
    """Log densities (K, n, n') in angles, of a level baseline; shares no formula with the model's vectors."""
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    q, p = model.first, model.second
    u = np.stack([c * q[:, 0] + s * q[:, 2], c * 0 + q[:, 1], c * q[:, 2] - s * q[:, 0]], axis=-1)[:, :, None]
    baseline = np.stack([np.cos(heading), 0.0 * heading, np.sin(heading)], axis=1)[:, None, None]
    to_u, to_p = (np.arccos((one * baseline).sum(axis=-1)) for one in (u, p))
    # the dihedral angle at the baseline between the planes of u and of p
    first, second = (one - (one * baseline).sum(axis=-1, keepdims=True) * baseline for one in (u, p))
    twist = np.arctan2((np.cross(first, second) * baseline).sum(axis=-1), (first * second).sum(axis=-1))
    e = np.arcsin(np.sin(twist) * np.sin(to_p))
    phi = to_u - np.arctan2(np.sin(to_p) * np.cos(twist), np.cos(to_p))
    v, w = model.first_variance[:, None], model.second_variance
    factor, mean, width = factor[:, None, None], np.exp(scale)[:, None, None], np.exp(spread)[:, None, None]
    across = factor * (w + v * (np.sin(to_p) / np.sin(to_u)) ** 2)
    with np.errstate(all="ignore"):
        r, slope = np.sin(phi) / np.sin(to_u - phi), np.sin(to_u) / np.sin(to_u - phi) ** 2
        phi_mean = np.arctan(mean * np.sin(to_u) / (1.0 + mean * np.cos(to_u)))
        at_mean = np.sin(to_u) / np.sin(to_u - phi_mean) ** 2
        noise = np.sqrt(factor * (v + w)) * slope
        size, level = np.hypot(r, noise), np.hypot(mean, np.sqrt(factor * (v + w)) * at_mean)
        width = np.hypot(width, noise / size)
        log = -0.5 * (e**2 / across + (np.log(size / level) / width) ** 2)
        log += -0.5 * np.log(across) - np.log(width * size / slope) - np.log(2.0 * np.pi)
        log -= 0.5 * np.minimum(phi, 0.0) ** 2 / (factor * (v + w))
    return np.where((phi < to_u) & np.isfinite(log), log, -np.inf)


def sampled_evidence(model: TwoViewModel, truth: np.ndarray, count: int) -> tuple[float, np.ndarray]:
    """Log evidence and marginals by samples about the true assignment alone, every assignment summed by subsets."""
    rng = np.random.default_rng(1)
    n, n_target = model.shape
    fits = fit_relative_poses(model, truth[None])
    k = int(fits.chi2.argmin())
    root = 1.8 * np.linalg.cholesky(fits.covariance[k])
    draws = t(4.0).rvs((count, 4), random_state=rng)
    log_q = t(4.0).logpdf(draws).sum(axis=1) - np.log(np.diag(root)).sum()
    step, poses = draws @ root.T, fits.poses.take(np.array([k]))
    t0 = poses.translation[0]
    # a step along the tangent turns the baseline by its arc tangent
    heading = math.atan2(t0[2], t0[0]) - np.arctan(step[:, 1])
    log_q += np.log1p(step[:, 1] ** 2)
    turn, scale, spread = poses.turn[0] + step[:, 0], poses.scale[0] + step[:, 2], poses.spread[0] + step[:, 3]
    inside = (SCALES[0] < scale) & (scale < SCALES[1]) & (SPREADS[0] < spread) & (spread < SPREADS[1])
    laws = invgamma(12.0, scale=12.0), beta(3.0, 1.5), gamma(n_target - n + 2.0)
    factor, rate, clutter = (law.rvs(count, random_state=rng) for law in laws)
    log_q += sum(law.logpdf(one) for law, one in zip(laws, (factor, rate, clutter), strict=True))
    log_p = np.where(inside, 0.0, -np.inf) - np.log((SCALES[1] - SCALES[0]) * (SPREADS[1] - SPREADS[0]))
    log_p += -2.0 * np.log(2.0 * np.pi) + invgamma(NOISE_FREEDOM / 2, scale=NOISE_FREEDOM / 2).logpdf(factor)
    log_p += (n_target - 0.5) * np.log(clutter) - clutter - gammaln(n_target + 0.5) + n * np.log1p(-rate)
    odds = log_densities(model, turn, heading, scale, np.clip(spread, *SPREADS), factor) - model.log_clutter
    odds = np.exp(odds + (np.log(rate / (1.0 - rate)) - np.log(clutter))[:, None, None])
    pair = np.zeros((n, n_target, count))
    total = np.zeros(count)
    for one in itertools.product(range(-1, n_target), repeat=n):
        used = [(i, k) for i, k in enumerate(one) if k >= 0]
        if len({k for _, k in used}) == len(used) >= 3:
            value = np.prod([odds[:, i, k] for i, k in used], axis=0)
            total += value
            for i, k in used:
                pair[i, k] += value
    weights = np.exp(log_p - log_q)
    return float(logsumexp(log_p - log_q, b=total) - math.log(count)), pair @ weights / (weights @ total)


@pytest.mark.parametrize("seed", [2000, 2004, 2005])
def test_evidence_and_marginals_are_those_of_another_sampler(seed: int) -> None:
    model, truth = planar_model(4, 1, seed)
    log_evidence, marginals = sampled_evidence(model, truth, 30_000)
    found = [sample_two_view_posterior(model, truth[None], seed) for seed in range(4)]
    assert logsumexp([one.log_evidence for one in found]) - math.log(4) == pytest.approx(log_evidence, abs=0.35)
    np.testing.assert_allclose(np.mean([one.marginals for one in found], axis=0), marginals, atol=0.06)


def test_what_is_told_agrees_with_itself() -> None:
    scene = three_plus_one_scene(12, 5, 0.5, 1001, 5.0)
    told = sample_two_view_posterior(model_of_scene(scene), scene.truth[None])
    best = told.proposals[0]
    confidence = told.confidence_in(best)
    assert told.assignment_probability(best) <= confidence.min() <= confidence.max() <= told.present < 1.0
    assert sum(told.shares) <= 1.0 + 1e-9
    assert told.marginals.sum(axis=1).max() <= 1.0 + 1e-9
    assert told.marginals.sum(axis=0).max() <= 1.0 + 1e-9
    matched = np.flatnonzero(best >= 0)
    assert told.together(best, matched) == pytest.approx(told.assignment_probability(best), abs=0.02)
    assert told.together(best, matched[:3]) >= told.together(best, matched)


def test_two_views_are_told_from_chance() -> None:
    """The odds against clutter alone: high for what belongs together, low for what does not."""
    true, false = [], []
    for seed in range(1000, 1006):
        scene = three_plus_one_scene(10, 10, 1.0, seed, baseline=1.0)
        true.append(sample_two_view_posterior(model_of_scene(scene), scene.truth[None]).log_evidence)
        rng = np.random.default_rng(seed)
        unrelated = replace(scene, source=rng.uniform((120, 40), (520, 440), (10, 2)))
        false.append(sample_two_view_posterior(model_of_scene(unrelated), rng.permutation(20)[None, :10]).log_evidence)
    assert min(true) > 10.0 > 0.0 > max(false)


def test_what_is_forbidden_or_unlikely_before_stays_so() -> None:
    scene = three_plus_one_scene(10, 2, 0.3, 1002, 2.0)
    allowed = np.ones((10, 12), np.bool_)
    allowed[4, scene.truth[4]] = False
    match = rm.match(scene.source, scene.target, scene.problem, noise=0.3, candidates=allowed)
    assert match.assignment[4] != scene.truth[4]
    assert all(other[4] != scene.truth[4] for other, _ in match.alternatives)


def test_a_turned_camera_leaves_matches_that_are_sure() -> None:
    """A small baseline: the direction of the motion is not known, the matches are."""
    right = wrong = 0
    for seed in range(1000, 1006):
        scene = three_plus_one_scene(12, 4, 0.5, seed, baseline=0.2)
        match = rm.match(scene.source, scene.target, scene.problem, noise=0.5)
        kept = match.assignment >= 0
        wrong += bool(match) and not np.array_equal(match.assignment[kept], scene.truth[kept])
        right += bool(match)
    assert right >= 4
    assert wrong == 0


def test_the_prior_of_small_baselines_proposes_and_does_not_decide() -> None:
    scene = three_plus_one_scene(9, 2, 0.5, 1001, baseline=0.5)
    problem = replace(scene.problem, small_baseline=1e-7)
    match = rm.match(scene.source, scene.target, problem, noise=0.5)
    assert match.probability is not None
    assert np.isfinite(match.confidence).all()
