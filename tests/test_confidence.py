"""Confidence in each match: exchangeable pairs, clutter near hidden points, copies, and noise stated too small."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta, f

import rootmatch as rm
from posteriors import told
from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.explain.task import MatchingTask
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene


def test_no_confidence_in_matches_of_unrelated_points() -> None:
    untrusted, highest = 0, []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        scene = up2p_scene(10, 4, 0.5, seed)
        match = rm.match(scene.source, rng.uniform(0.0, [640.0, 480.0], (14, 2)), scene.problem, noise=0.5)
        untrusted += match.status is rm.Status.UNTRUSTED
        highest.append(float(np.nanmax(match.confidence[match.assignment >= 0], initial=0.0)))
    assert untrusted == 12
    assert max(highest) < 0.5
    assert np.mean(highest) < 0.1


def test_one_exchangeable_pair_does_not_make_a_large_match_ambiguous() -> None:
    scene = up2p_scene(24, 6, 0.5, 4)
    source, target = scene.source.copy(), scene.target.copy()
    # two points in one place, seen two σ apart
    source[1] = source[0] + 1e-4
    target[scene.truth[1]] = target[scene.truth[0]] + [1.0, 0.0]
    match = rm.match(source, target, scene.problem, noise=0.5)
    assert match.status is rm.Status.MATCHED
    kept = match.assignment >= 0
    np.testing.assert_array_equal(match.assignment[kept], scene.truth[kept])
    assert not kept[:2].any()
    assert kept.sum() >= 21
    assert match.confidence[kept].min() > 0.9
    assert match.confidence[:2].max() < 0.1  # left out, but seen
    assert match.probability > 0.9
    np.testing.assert_array_equal(np.sort(match.alternatives[0][0][:2]), np.sort(scene.truth[:2]))


def test_two_copies_in_view_are_ambiguous() -> None:
    rng = np.random.default_rng(1)
    source, camera = rng.uniform(-1.0, 1.0, (6, 3)), rm.Camera(1000.0, 1000.0, 320.0, 240.0)
    copies = [camera.project(source + np.array([x, 0.0, 12.0])) for x in (-1.5, 1.7)]
    target = np.vstack(copies) + rng.normal(0.0, 0.5, (12, 2))
    match = rm.match(source, target, rm.UP2P(camera, (0, 1, 0), (0, 1, 0)), noise=0.5)
    assert match.status is not rm.Status.MATCHED


def test_confidences_are_calibrated_beside_hidden_points() -> None:
    """Clutter in the place of a hidden point is believed as often as it is right."""
    confidence, right = [], []
    for seed in range(60):
        scene = up2p_scene(8, 0, 1.0, seed, hidden=3)
        rng = np.random.default_rng(seed)
        near = scene.target[rng.integers(0, len(scene.target), 4)] + rng.uniform(-8.0, 8.0, (4, 2))
        task = MatchingTask.of(scene.problem, scene.source, np.vstack([scene.target, near]), noise=1.0)
        found = told(task, [scene.truth])
        confidence.append(found.confidence)
        right.append(found.modes.assignments[0] == scene.truth)
    confidence, right = np.concatenate(confidence), np.concatenate(right)
    assert 0.8 < confidence.mean() < 0.999
    assert right.mean() == pytest.approx(confidence.mean(), abs=0.03)


def test_confidence_of_every_kind_of_match() -> None:
    scene = up2p_scene(8, 3, 0.5, 0)
    clear = rm.match(scene.source, scene.target, scene.problem, noise=0.5)
    assert clear.confidence.shape == (8,)
    assert clear.confidence.min() > 0.8
    paper = rm.match(scene.source, scene.target, scene.problem, preset="paper", samples=20_000)
    assert np.isnan(paper.confidence).all()
    two = up2p_scene(12, 4, 0.5, 950, motions=2)
    several = rm.match(two.source, two.target, two.problem, noise=0.5, motions=2)
    assert several.confidence.shape == (12,)
    assert np.nanmin(several.confidence[several.assignment >= 0]) > 0.5
    views = three_plus_one_scene(7, 2, 0.3, 1)
    between = rm.match(views.source, views.target, views.problem, noise=0.3)
    assert ((between.confidence >= 0.0) & (between.confidence <= 1.0)).all()


def test_noise_stated_far_too_small_is_named() -> None:
    """The points may be off as well: what fits then is trusted, and both are named."""
    named = 0
    for seed in range(12):
        scene = up2p_scene(10, 4, 1.0, seed)
        match = rm.match(scene.source, scene.target, scene.problem, noise=0.25)
        own = match.assignment >= 0
        assert not match or (match.assignment == scene.truth)[own].all()
        named += "`source_noise=`" in match.advice and "`noise=`" in match.advice
    assert named >= 10
    match = rm.match(scene.source, scene.target, scene.problem, noise=1.0)
    assert match.noise_factor < 2.0
    assert "noise=" not in match.advice


def test_matches_that_fit_badly_are_doubted() -> None:
    """Something else may have nearly the shape: what agrees within twelve times the stated noise is not certain."""
    highest = []
    for factor in (1.0, 12.0):
        each = []
        for seed in range(4):
            scene = p3p_scene(14, 4, 0.5 * factor, seed)
            match = rm.match(scene.source, scene.target, scene.problem, noise=0.5)
            each.append(float(match.confidence[match.assignment >= 0].max()))
            assert match.probability <= each[-1] + 1e-9
        highest.append(each)
    assert min(highest[0]) > 0.99
    assert max(highest[1]) < 0.95
    assert np.mean(highest[1]) < 0.6


def test_residuals_speak_for_something_else_by_their_chance() -> None:
    """Bayes factor of Beta(.2, 1) to uniform at the chance by an F distribution."""
    for chance in (0.5, 0.01, 1e-5):
        fault = Misfit(1.0, float(np.sqrt(f.isf(chance, 12, NOISE_FREEDOM))), 12)
        assert fault.odds_of_something_else() == pytest.approx(beta.pdf(chance, 0.2, 1.0), rel=1e-6)
    assert Misfit(1.0, 1.0, 12).odds_of_something_else() < 1.0
    assert Misfit(1.0, 4.0, 12).odds_of_something_else() > 1000.0
    assert Misfit(1.0, 4.0, 12).odds_of_something_else(of_rig=True) < 100.0
