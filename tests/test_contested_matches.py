"""Points and detections that several motions claim, and motions found in turn beside those of a packing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.explain import explain
from rootmatch.explain.contested_matches import Claims, allot_claims
from rootmatch.simulation import p3p_scene, up2p_scene


def most_worth(worth: np.ndarray) -> float:
    """The largest total of a one-to-one assignment, by trying all."""
    n, n_target = worth.shape
    columns = [*range(n_target), *[-1] * n]
    every = {order[:n] for order in itertools.permutations(columns, n)}
    return max(sum(worth[i, j] for i, j in enumerate(order) if j >= 0) for order in every)


@pytest.mark.parametrize("seed", range(4))
def test_the_claims_with_the_largest_total_are_met(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, n_target = 4, 5
    claims = {}
    for label in range(3):
        assignment = np.where(rng.random(n) < 0.7, rng.permutation(n_target)[:n], -1)
        gains = np.where(assignment >= 0, rng.uniform(0.5, 9.0, n), 0.0)
        claims[label] = Claims(assignment, gains, own=2)  # alike for all: each claim is worth as much more
    shared = allot_claims(claims, n_target)
    more = np.log((4 + 1.0) / (n - 4 + 1.0) * (n - 2 + 1.0) / (2 + 1.0) * (n_target - 2 + 0.5) / (n_target - 4 + 0.5))
    worth = np.zeros((n, n_target))
    for one in claims.values():
        for i, j in enumerate(one.assignment):
            if j >= 0:
                worth[i, j] = max(worth[i, j], one.gains[i] + more)
    matched = np.flatnonzero(shared.assignment >= 0)
    assert worth[matched, shared.assignment[matched]].sum() == pytest.approx(most_worth(worth))
    for i in matched.tolist():
        one = claims[int(shared.labels[i])]
        assert one.assignment[i] == shared.assignment[i]
        assert one.gains[i] + more == pytest.approx(worth[i, shared.assignment[i]])
    assert 0.0 < shared.together <= 1.0
    assert 0.0 < shared.certainty.min() <= shared.certainty.max() <= 1.0


def test_how_sure_the_shares_are_is_a_sum_over_all_of_them() -> None:
    rng = np.random.default_rng(7)
    n, n_target = 5, 5
    claims = {
        label: Claims(rng.permutation(n_target)[:n], rng.uniform(1.0, 6.0, n), own=n)  # nothing is left, nothing added
        for label in range(2)
    }
    shared = allot_claims(claims, n_target)
    every = [(i, int(one.assignment[i]), float(one.gains[i]), k) for k, one in claims.items() for i in range(n)]
    more = np.log((n + 1.0) / 1.0 * 1.0 / (n + 1.0))
    total, best = 0.0, 0.0
    for size in range(n + 1):
        for some in itertools.combinations(every, size):
            if len({i for i, _, _, _ in some}) < size or len({j for _, j, _, _ in some}) < size or size < 3:
                continue
            odds = np.exp(sum(gain + more for _, _, gain, _ in some))
            total += odds
            if all(shared.assignment[i] == j and shared.labels[i] == k for i, j, _, k in some):
                best += odds
    assert shared.together == pytest.approx(best / total, rel=0.05)  # those of fewer than three are left out of one


def test_a_point_that_two_motions_claim_alike_is_of_either() -> None:
    own = np.array([0, 1, 2, 3]), np.array([0, 1, 2, 3])
    first, second = (Claims(one, np.full(4, 5.0), own=4) for one in own)
    shared = allot_claims({0: first, 1: second}, 4)
    np.testing.assert_array_equal(shared.assignment, [0, 1, 2, 3])
    np.testing.assert_allclose(shared.certainty, 0.5, rtol=1e-6)
    assert shared.together == pytest.approx(0.5**4, rel=0.02)


def test_motions_in_turn_are_those_of_a_packing(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [p3p_scene(16, 0, 0.5, seed, 2) for seed in (1005,)]
    for scene in scenes:
        in_turn = rm.match(scene.source, scene.target, scene.problem, noise=0.5, motions=2)
        with monkeypatch.context() as patch:
            patch.setattr(explain, "find_motions_in_turn", lambda task, solve: None)
            packed = rm.match(scene.source, scene.target, scene.problem, noise=0.5, motions=2)
        assert in_turn.status is packed.status is rm.Status.MATCHED
        np.testing.assert_array_equal(in_turn.assignment, packed.assignment)
        np.testing.assert_array_equal(
            in_turn.motion_labels[:, None] == in_turn.motion_labels, scene.motions[:, None] == scene.motions
        )
        assert in_turn.evaluated < packed.evaluated
        assert in_turn.score == pytest.approx(packed.score, rel=0.2)  # of the hyper-edges that were evaluated


def test_no_motion_keeps_what_is_of_another() -> None:
    for seed in (3103, 3104):
        scene = up2p_scene(60, 0, 1.0, seed, 2)
        match = rm.match(scene.source, scene.target, scene.problem, noise=1.0, motions="auto")
        matched = match.assignment >= 0
        assert match.status is rm.Status.MATCHED
        np.testing.assert_array_equal(match.assignment[matched], scene.truth[matched])
