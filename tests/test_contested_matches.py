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


def claims_of(assignment: np.ndarray, gains: np.ndarray, own: int) -> Claims:
    """Claims to the matches of an assignment alone."""
    points = np.flatnonzero(assignment >= 0)
    return Claims(points, assignment[points], gains[points], own)


@pytest.mark.parametrize("seed", range(4))
def test_the_claims_with_the_largest_total_are_met(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, n_target = 4, 5
    claims = {}
    for label in range(3):
        assignment = np.where(rng.random(n) < 0.7, rng.permutation(n_target)[:n], -1)
        gains = np.where(assignment >= 0, rng.uniform(0.5, 9.0, n), 0.0)
        claims[label] = claims_of(assignment, gains, own=2)  # alike for all: each claim is worth as much more
    shared = allot_claims(claims, n, n_target)
    more = np.log((4 + 1.0) / (n - 4 + 1.0) * (n - 2 + 1.0) / (2 + 1.0) * (n_target - 2 + 0.5) / (n_target - 4 + 0.5))
    worth = np.zeros((n, n_target))
    for one in claims.values():
        for i, j, gain in zip(one.points, one.detections, one.gains, strict=True):
            worth[i, j] = max(worth[i, j], gain + more)
    matched = np.flatnonzero(shared.assignment >= 0)
    assert worth[matched, shared.assignment[matched]].sum() == pytest.approx(most_worth(worth))
    for i in matched.tolist():
        one = claims[int(shared.labels[i])]
        own = (one.points == i) & (one.detections == shared.assignment[i])
        assert one.gains[own] + more == pytest.approx(worth[i, shared.assignment[i]])
    assert 0.0 < shared.together <= 1.0
    assert 0.0 < shared.certainty.min() <= shared.certainty.max() <= 1.0


def test_how_sure_the_shares_are_is_a_sum_over_all_of_them() -> None:
    rng = np.random.default_rng(7)
    n, n_target = 5, 5
    claims = {
        label: claims_of(rng.permutation(n_target)[:n], rng.uniform(1.0, 6.0, n), own=n)  # nothing is left or added
        for label in range(2)
    }
    shared = allot_claims(claims, n, n_target)
    every = [(i, int(one.detections[i]), float(one.gains[i]), k) for k, one in claims.items() for i in range(n)]
    own = [shared.assignment[i] == j and shared.labels[i] == k for i, j, _, k in every]
    total, apart = 0.0, 0.0
    held, held_apart = np.zeros(n), np.zeros(n)
    for size in range(3, n + 1):  # those of fewer are left out
        for some in itertools.combinations(range(len(every)), size):
            points, detections = ({every[one][side] for one in some} for side in (0, 1))
            if len(points) < size or len(detections) < size:
                continue
            odds = np.exp(sum(every[one][2] for one in some))
            mine = [every[one][0] for one in some if own[one]]
            total += odds
            held[mine] += odds
            if len(mine) == size:
                apart += odds
                held_apart[mine] += odds
    assert shared.together == pytest.approx(apart / total, rel=1e-6)
    np.testing.assert_allclose(shared.certainty, (held / total) / (held_apart / apart), rtol=1e-6)


def test_a_point_that_two_motions_claim_alike_is_of_either() -> None:
    own = np.arange(4)
    first, second = (claims_of(own, np.full(4, 15.0), own=4) for _ in range(2))
    shared = allot_claims({0: first, 1: second}, 4, 4)
    np.testing.assert_array_equal(shared.assignment, own)
    np.testing.assert_allclose(shared.certainty, 0.5, rtol=1e-4)
    assert shared.together == pytest.approx(0.5**4, rel=0.02)


def test_two_motions_that_exchange_a_detection_or_a_point() -> None:
    first = Claims(np.array([0, 1, 2, 2]), np.array([0, 1, 2, 5]), np.array([15.0, 15.0, 15.0, 14.0]), own=3)
    second = Claims(np.array([3, 4, 5, 5]), np.array([3, 4, 5, 2]), np.array([15.0, 15.0, 15.0, 14.0]), own=3)
    shared = allot_claims({0: first, 1: second}, 6, 6)
    np.testing.assert_array_equal(shared.assignment, np.arange(6))
    assert shared.together == pytest.approx(1.0 / (1.0 + np.exp(-2.0)), rel=1e-4)
    np.testing.assert_allclose(shared.certainty[[2, 5]], shared.together, rtol=1e-4)
    np.testing.assert_allclose(shared.certainty[[0, 1, 3, 4]], 1.0, rtol=1e-4)
    np.testing.assert_allclose(shared.unclaimed, 0.0, atol=1e-4)


@pytest.mark.parametrize("apart", ["detections", "points"])
@pytest.mark.parametrize("distance", [0.0, 40.0])
def test_what_two_motions_may_have_exchanged_is_left_out(apart: str, distance: float) -> None:
    """Two detections, or two points, that are in one place but of two motions."""
    rng = np.random.default_rng(3)
    camera = rm.Camera(600.0, 600.0, 320.0, 240.0)
    source, target = [], []
    for k in range(2):
        body = rng.uniform(-1.0, 1.0, (8, 3))
        turn = rng.uniform(0.0, 2.0 * np.pi)
        rotation = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
        place = np.array([0.8 * k, 0.3 * k, 8.0])
        if apart == "points" and k:
            body[0] = source[0][0] + np.array([max(distance, 0.01) / 75.0, 0.0, 0.0])
        if apart == "detections" and k:  # where the other motion's first point is seen
            pixel = target[0][0] + np.array([distance, 0.0])
            there = 8.0 * np.append((pixel - [320.0, 240.0]) / 600.0, 1.0)
            body[0] = (there - place) @ rotation
        source.append(body)
        target.append(camera.project(body @ rotation.T + place) + 0.5 * rng.normal(size=(8, 2)))
    match = rm.match(
        np.concatenate(source), np.concatenate(target), rm.UP2P(camera, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)), noise=0.5,
        motions=2,
    )  # fmt: skip
    assert match.status is rm.Status.MATCHED
    doubtful = np.isin(np.arange(16), (0, 8)) & (distance == 0.0)
    np.testing.assert_array_equal(match.assignment, np.where(doubtful, -1, np.arange(16)))
    np.testing.assert_array_equal(match.motion_labels < 0, doubtful)
    assert match.probability > 0.95
    assert (match.confidence[doubtful] < 0.1).all()


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
