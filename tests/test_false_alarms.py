"""The estimate of what chance can do, against counting and against chance itself."""

import math

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.explain.assessment import TRUE_WEIGHT, log10_false_alarms, supported_points
from rootmatch.explain.decide import TRUST
from rootmatch.simulation import p3p_scene, up2p_scene

CAMERA = rm.Camera(1000, 1000, 320, 240)


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("points", [4, 7, 20, 100])
def test_supported_points_inverts_the_count_of_tuples(order: int, points: int) -> None:
    assert supported_points(0.5 * math.comb(points, order), order, 0.5) == pytest.approx(max(points, order))


def test_no_score_supports_no_more_than_one_hyperedge() -> None:
    assert supported_points(0.0, 4, 0.5) == 4


def test_false_alarms_count_ways_and_agreements() -> None:
    problem = rm.P3P(CAMERA)
    score = 0.5 * math.comb(6, 4)
    expected = math.comb(8, 6) * math.perm(9, 6) * 4 * 1e-3**3
    found = log10_false_alarms(problem, (8, 9), score=score, true_weight=0.5, chance=1e-3)
    assert found == pytest.approx(math.log10(expected), abs=1e-6)


def test_mean_weight_of_a_true_hyperedge_is_that_of_its_law() -> None:
    rng = np.random.default_rng(0)
    for freedom, weight in TRUE_WEIGHT.items():
        drawn = np.exp(-0.5 * rng.chisquare(freedom, 200_000))
        assert weight == pytest.approx(drawn.mean(), abs=5e-3)


@pytest.mark.parametrize(
    ("problem", "n"), [(rm.P3P(CAMERA), 7), (rm.UP2P(CAMERA, (0, 1, 0), (0, 1, 0)), 8)], ids=["p3p", "up2p"]
)
def test_unrelated_points_are_trusted_once_in_a_hundred_at_most(problem: rm.Problem, n: int) -> None:
    """What `TrustOptions.false_alarms` promises of few points: chance is as good in one scene of a hundred."""
    scenes, trusted = 100, []
    for seed in range(scenes):
        rng = np.random.default_rng([seed, n])
        source, target = rng.uniform(-2, 2, (n, 3)), rng.uniform(0, 480, (n, 2))
        if rm.match(source, target, problem, noise=0.5).status is not rm.Status.UNTRUSTED:
            trusted.append(seed)
    assert len(trusted) <= 10**TRUST.false_alarms * scenes, trusted


@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_true_scenes_are_trusted(make) -> None:  # type: ignore[no-untyped-def]
    for seed in range(10):
        scene = make(n=8, outliers=2, noise=0.5, seed=seed)
        match = rm.match(scene.source, scene.target, scene.problem, noise=0.5)
        assert match.status is not rm.Status.UNTRUSTED
