"""Matches that the pose of a clear search decides: hyper-edges are weighed only when somebody asks."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.explain import explain, pose_decision, sampling
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.result import report
from rootmatch.simulation import p3p_scene, up2p_scene


def test_a_deferred_tensor_is_made_once() -> None:
    made = []

    def make() -> AffinityTensor:
        made.append(0)
        return AffinityTensor(np.array([[0, 4]]), np.array([0.5]), (2, 3))

    tensor = DeferredTensor.of(make, (2, 3))
    assert (tensor.shape, made) == ((2, 3), [])
    assert tensor.score([0, 1]) == 0.5
    assert tensor.size == 1
    assert pickle.loads(pickle.dumps(tensor)).score([0, 1]) == 0.5
    assert made == [0]
    with pytest.raises(AttributeError, match="colour"):
        tensor.colour  # noqa: B018


@pytest.mark.parametrize(("make", "noise"), [(up2p_scene, 1.0), (p3p_scene, 1.0)])
def test_what_the_pose_decides_weighing_hyper_edges_confirms(
    make: object, noise: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(2):
        scene = make(12, 10, noise=noise, seed=seed)  # type: ignore[operator]
        task = MatchingTask.of(scene.problem, scene.source, scene.target, noise=noise)
        quick = report(explain.explain(task), seconds=0.0)
        assert "indices" not in vars(quick.tensor)
        with monkeypatch.context() as patch:
            patch.setattr(explain, "decided_by_pose", lambda task, sampled: None)
            slow = report(explain.explain(replace(task)), seconds=0.0)
        np.testing.assert_array_equal(quick.assignment, slow.assignment)
        np.testing.assert_array_equal(quick.tensor.indices, slow.tensor.indices)
        assert quick.status is slow.status
        assert quick.score == slow.score == pytest.approx(slow.tensor.score(slow.assignment))
        assert quick.probability == pytest.approx(slow.probability, abs=1e-6)
        assert quick.margin == pytest.approx(slow.margin, abs=1e-12)
        np.testing.assert_array_equal(quick.motion_labels, slow.motion_labels)
        np.testing.assert_allclose(quick.confidence, slow.confidence, atol=1e-6)
        again = pickle.loads(pickle.dumps(quick))
        np.testing.assert_array_equal(again.soft_assignment, quick.soft_assignment)
        assert again.score == quick.score


def test_hyper_edges_are_weighed_where_none_of_a_few_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = up2p_scene(12, 10, noise=1.0, seed=0)
    task = MatchingTask.of(scene.problem, scene.source, scene.target, noise=1.0)
    sampled = sampling.sample(task)
    assert pose_decision.decided_by_pose(task, sampled) is not None
    assert sampled.assignments is not None
    assert pose_decision.hyperedges_agree(task, sampled.assignments[0])
    assert not pose_decision.hyperedges_agree(task, np.roll(sampled.assignments[0], 1))
    assert not pose_decision.hyperedges_agree(task, np.where(np.arange(12) < 2, sampled.assignments[0], -1))
    monkeypatch.setattr(pose_decision, "hyperedges_agree", lambda task, assignment: False)
    assert pose_decision.decided_by_pose(task, sampled) is None
    assert isinstance(rm.match(scene.source, scene.target, scene.problem, noise=1.0).tensor, DeferredTensor)
