"""A matcher gives frame after frame what `match` gives."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene


def same(one: rm.Match, other: rm.Match) -> None:
    assert one.assignment.tolist() == other.assignment.tolist()
    assert one.score == other.score
    assert one.evaluated == other.evaluated
    assert one.status is other.status
    assert np.array_equal(one.tensor.indices, other.tensor.indices)
    assert np.array_equal(one.tensor.weights, other.tensor.weights)
    assert len(one.alternatives) == len(other.alternatives)


@pytest.mark.parametrize(
    "scene",
    [
        p3p_scene(5, 3, noise=0.5, seed=3),
        up2p_scene(6, 4, noise=0.5, seed=3),
        three_plus_one_scene(5, 1, noise=0.2, seed=1),
        p3p_scene(10, 10, noise=0.5, seed=1),
    ],
    ids=["p3p", "up2p", "3p1", "guided"],
)
def test_a_frame_is_matched_as_by_match(scene: Scene) -> None:
    matcher = rm.Matcher(scene.source, scene.problem, noise=scene.noise)
    expected = rm.match(scene.source, scene.target, scene.problem, noise=scene.noise)
    for _ in range(2):
        same(matcher.match(scene.target), expected)


def test_frames_may_differ_in_points_noise_and_candidates() -> None:
    scene = p3p_scene(6, 2, noise=0.5, seed=5)
    matcher = rm.Matcher(scene.source, scene.problem)
    mask = np.random.default_rng(0).random((6, 8)) < 0.6
    mask[np.arange(6), scene.truth] = True
    for count, noise, candidates in ((8, 0.5, None), (7, 2.0, None), (8, 0.5, mask), (5, 0.5, None), (8, 0.5, None)):
        got = matcher.match(scene.target[:count], noise=noise, candidates=candidates)
        same(got, rm.match(scene.source, scene.target[:count], scene.problem, noise=noise, candidates=candidates))
    same(matcher.match(scene.target), rm.match(scene.source, scene.target, scene.problem))


def test_more_hyperedges_than_there_was_room_for() -> None:
    scene = p3p_scene(8, 0, noise=0.5, seed=2)
    matcher = rm.Matcher(scene.source, scene.problem, noise=20.0)
    got = matcher.match(scene.target[:7])
    assert got.tensor.size > 1024
    same(got, rm.match(scene.source, scene.target[:7], scene.problem, noise=20.0))


def test_options_of_match_are_passed_on() -> None:
    scene = p3p_scene(6, 2, noise=0.0, seed=5)
    paper = rm.Matcher(scene.source, scene.problem, preset="paper", samples=5000, seed=4).match(scene.target)
    same(paper, rm.match(scene.source, scene.target, scene.problem, preset="paper", samples=5000, seed=4))
    both = {"residual": "normalised", "sampler": "guided", "seed": 1}
    same(
        rm.Matcher(scene.source, scene.problem, **both).match(scene.target),
        rm.match(scene.source, scene.target, scene.problem, **both),
    )


def test_the_source_is_checked_at_once_and_kept_apart() -> None:
    scene = p3p_scene(5, 3, noise=0.5, seed=3)
    with pytest.raises(rm.InputError, match="source: shape"):
        rm.Matcher(scene.source[:, :2], scene.problem)
    with pytest.raises(TypeError, match="'candidates'"):  # they belong to a frame
        rm.Matcher(scene.source, scene.problem, candidates=np.ones((5, 8), bool))  # type: ignore[call-arg]
    points = scene.source.copy()
    matcher = rm.Matcher(points, scene.problem, noise=0.5)
    points[:] = 0.0
    assert matcher.match(scene.target).assignment.tolist() == scene.truth.tolist()
    with pytest.raises(rm.InputError, match="target"):
        matcher.match(scene.target[0])
