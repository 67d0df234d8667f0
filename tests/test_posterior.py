"""Posterior probability of assignments, and of what lies near them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import rootmatch as rm
from posteriors import told
from rootmatch.explain.task import MatchingTask
from rootmatch.model.posterior import WRONG, joint_probabilities, surest_matches
from rootmatch.simulation import p3p_scene, up2p_scene


def task_of(scene, **more):  # type: ignore[no-untyped-def]
    return MatchingTask.of(scene.problem, scene.source, scene.target, noise=scene.noise, **more)


@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_neighbours_of_a_damaged_answer_lead_back_to_the_truth(make) -> None:  # type: ignore[no-untyped-def]
    mended = 0
    for seed in range(20):
        scene = make(10, 5, 0.5, seed, hidden=2)
        damaged = scene.truth.copy()
        seen, hidden = np.flatnonzero(damaged >= 0), np.flatnonzero(damaged < 0)
        damaged[seen[4]] = -1
        if seed % 2:
            damaged[hidden[0]] = np.setdiff1d(np.arange(len(scene.target)), scene.truth)[0]
        mended += np.array_equal(told(task_of(scene), [damaged]).modes.assignments[0], scene.truth)
        np.testing.assert_array_equal(told(task_of(scene), [scene.truth]).modes.assignments[0], scene.truth)
    assert mended >= 18


def test_probabilities_are_those_of_the_scenes() -> None:
    """Of assignments with a probability about p, about p are right: detections doubled at a distance of a few σ."""
    probability, right = [], []
    for seed in range(120):
        scene = up2p_scene(7, 0, 1.0, seed)
        rng = np.random.default_rng(seed)
        target = np.concatenate([scene.target, scene.target[:2] + rng.uniform(-6.0, 6.0, (2, 2))])
        order = rng.permutation(len(target))
        truth = np.argsort(order)[scene.truth]
        evidence = MatchingTask.of(scene.problem, scene.source, target[order], noise=1.0)
        found = told(evidence, [truth])
        probability.append(found.assignment_probability(found.modes.assignments[0]))
        right.append(np.array_equal(found.modes.assignments[0], truth))
    assert 0.5 < np.mean(probability) < 0.99
    assert np.mean(right) == pytest.approx(np.mean(probability), abs=0.09)


def test_what_is_forbidden_stays_so() -> None:
    scene = p3p_scene(10, 5, 0.5, 3)
    allowed = np.ones((10, 15), np.bool_)
    allowed[4, scene.truth[4]] = False
    start = scene.truth.copy()
    start[4] = -1
    found = told(task_of(scene, candidates=allowed), [start])
    assert all(answer[4] != scene.truth[4] for answer, _ in found.ranked(16))
    np.testing.assert_array_equal(found.modes.assignments[0], start)
    # a prior weight of a millionth is not quite as bad
    prior = np.where(allowed, 1.0, 1e-2)
    assert told(task_of(scene, candidates=prior), [start]).modes.assignments[0][4] == scene.truth[4]


def test_points_turned_away_are_not_put_in() -> None:
    scene = p3p_scene(10, 0, 0.2, 3)
    rotation, shift = scene.poses[0]
    facing = -(scene.source @ rotation.T + shift) @ rotation
    start = scene.truth.copy()
    start[4] = -1
    np.testing.assert_array_equal(told(task_of(scene, normals=facing), [start]).modes.assignments[0], scene.truth)
    facing[4] *= -1.0
    np.testing.assert_array_equal(told(task_of(scene, normals=facing), [start]).modes.assignments[0], start)


def test_a_match_says_that_one_of_two_detections_is_meant() -> None:
    scene = up2p_scene(10, 0, 0.5, 0)
    target = np.concatenate([scene.target, scene.target[3] + [[0.3, 0.2]]])
    match = rm.match(scene.source, target, scene.problem, noise=0.5)
    # the pose is sure, and one of its matches is not: that one is left out, and the alternatives have both
    assert match.status is rm.Status.MATCHED
    point = int(np.flatnonzero(scene.truth == 3)[0])
    assert match.assignment[point] == -1
    np.testing.assert_array_equal(np.delete(match.assignment, point), np.delete(scene.truth, point))
    assert match.confidence[point] < 0.5 < np.delete(match.confidence, point).min()
    assert {int(other[point]) for other, _ in match.alternatives[:2]} == {3, 10}
    apart = np.concatenate([scene.target, scene.target[3] + [[30.0, 20.0]]])
    assert rm.match(scene.source, apart, scene.problem, noise=0.5).status is rm.Status.MATCHED


def test_noise_said_to_be_too_small_does_not_empty_the_answer() -> None:
    right = 0.0
    for seed in range(10):
        scene = up2p_scene(10, 5, 1.0, seed)
        right += scene.accuracy(rm.match(scene.source, scene.target, scene.problem, noise=0.5).assignment)
    assert right >= 9.5


def test_the_surest_matches_leave_so_many_wrong_ones_and_no_more() -> None:
    confidence = np.array([0.9, 1.0, 0.995, 0.99])
    assert surest_matches(confidence, 0.0).tolist() == [1]
    assert surest_matches(confidence, 0.0151).tolist() == [1, 2, 3]
    assert surest_matches(confidence, 0.2).tolist() == [1, 2, 3, 0]
    assert len(surest_matches(np.full(200, 0.9995), 0.0)) == 200  # a thousandth of a large assignment
    assert len(surest_matches(np.full(200, 0.9979), 0.0)) == 95


@pytest.mark.parametrize("count", [5, 49, 60, 200])
def test_what_is_right_together_is_no_more_than_independent_matches_are(count: int) -> None:
    confidence = np.sort(1.0 - np.random.default_rng(count).uniform(0.0, 0.004, count))[::-1]
    told = joint_probabilities(confidence, 0.95)
    for k in (1, 4, count // 2, count):
        wrong = np.ones(1)  # probabilities of 0, 1, 2 … wrong ones
        for one in confidence[:k]:
            wrong = np.convolve(wrong, (one, 1.0 - one))
        allowed = math.ceil(WRONG * k) if k > 50 else 0
        exact = float(wrong[: allowed + 1].sum())
        assert exact - 0.02 <= told[k - 1] <= exact + 1e-12
