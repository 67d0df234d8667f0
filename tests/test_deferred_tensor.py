"""Tensors that are made when they are first read: a model of the image decides without them."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.simulation import Scene, p3p_scene, up2p_scene


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


@pytest.mark.parametrize("make", [up2p_scene, p3p_scene])
def test_hyper_edges_of_an_image_are_weighed_when_somebody_asks(make: Callable[..., Scene]) -> None:
    for seed in range(2):
        scene = make(12, 10, noise=1.0, seed=seed)
        match = rm.match(scene.source, scene.target, scene.problem, noise=1.0)
        assert isinstance(match.tensor, DeferredTensor)
        assert "indices" not in vars(match.tensor)
        again = pickle.loads(pickle.dumps(match))
        assert match.score == pytest.approx(match.tensor.score(match.assignment))
        assert "indices" in vars(match.tensor)
        np.testing.assert_array_equal(again.soft_assignment, match.soft_assignment)
        assert again.score == match.score
