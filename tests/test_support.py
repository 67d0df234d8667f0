"""Points that the others do not support, many answers at once, against the one-by-one way."""

from __future__ import annotations

import numpy as np
import pytest

from rootmatch.hypergraph.assignment import drop_unsupported
from rootmatch.hypergraph.support import supported_answers
from rootmatch.hypergraph.tensor import AffinityTensor


def random_tensor(rng: np.random.Generator, order: int, unary: bool) -> AffinityTensor:
    n, n_target = 7, 9
    edges = []
    while len(edges) < 400:
        source, target = rng.permutation(n)[:order], rng.permutation(n_target)[:order]
        edges.append(source * n_target + target)
    return AffinityTensor(
        np.array(edges), rng.random(400), (n, n_target), rng.random((n, n_target)) * 0.3 if unary else None
    )


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("unary", [False, True])
def test_many_answers_at_once_are_as_one_by_one(order: int, unary: bool) -> None:
    rng = np.random.default_rng(order)
    tensor = random_tensor(rng, order, unary)
    answers = np.array([rng.permutation(9)[:7] for _ in range(60)])
    answers[rng.random(answers.shape) < 0.2] = -1
    answers[0] = -1
    dropped = 0
    for fraction in (0.0, 0.2, 0.8):
        kept, scores = supported_answers(tensor.indices, tensor.weights, tensor.unary, 9, answers, fraction)
        for answer, got, score in zip(answers, kept, scores, strict=True):
            expected = drop_unsupported(answer, tensor, fraction)
            assert got.tolist() == expected.tolist()
            assert score == pytest.approx(tensor.score(expected), rel=1e-12)
            dropped += int((got != answer).sum())
    assert dropped >= 60
