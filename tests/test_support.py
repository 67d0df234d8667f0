"""Support: the points that the others do not support, many assignments at once, against losses of score one by one."""

from __future__ import annotations

import numpy as np
import pytest

from rootmatch.hypergraph.support import drop_unsupported, score_assignments
from rootmatch.hypergraph.tensor import AffinityTensor
from solver_oracles import planted


def kept_of(assignment: object, tensor: AffinityTensor, fraction: float) -> list[int]:
    """One assignment without unsupported points."""
    kept, _ = drop_unsupported(tensor, np.array([assignment], dtype=np.int64), fraction)
    return kept[0].tolist()


def dropped_one_by_one(assignment: np.ndarray, tensor: AffinityTensor, fraction: float) -> np.ndarray:
    """The same by the definition: a point's gain is what the score loses without it."""
    kept = assignment.copy()
    while (matched := np.flatnonzero(kept >= 0)).size:
        gains = []
        for point in matched:
            without = kept.copy()
            without[point] = -1
            gains.append(tensor.score(kept) - tensor.score(without))
        weak = (np.array(gains) < fraction * np.median(gains)) | (np.array(gains) < 1e-12)
        if not weak.any():
            break
        kept[matched[weak]] = -1
    return kept


def test_unsupported_points_are_dropped_and_no_others() -> None:
    indices, weights, truth = planted(2, 9, 10, 3, 300, hidden=2)
    tensor = AffinityTensor(indices, weights, (9, 10))
    full = truth.copy()
    free = np.setdiff1d(np.arange(10), truth)
    full[truth < 0] = free[:2]
    assert kept_of(full, tensor, 0.2) == truth.tolist()
    assert kept_of(truth, tensor, 0.2) == truth.tolist()


def test_dropping_goes_on_until_nothing_changes() -> None:
    # 0-1-2 hold together; 3 leans on 4 and 4 on 3 alone, more weakly.
    pairs = [[0, 6], [0, 12], [6, 12], [18, 24], [12, 18]]
    tensor = AffinityTensor(pairs, [10.0, 10.0, 10.0, 1.0, 2.5], (5, 5))
    everyone = np.arange(5)
    assert kept_of(everyone, tensor, 0.1) == [0, 1, 2, 3, -1]
    # With a larger fraction 4 goes first, then 3, which had its help.
    assert kept_of(everyone, tensor, 0.15) == [0, 1, 2, -1, -1]
    assert kept_of([0, 1, -1, 3, -1], tensor, 0.0) == [0, 1, -1, -1, -1]
    assert kept_of([-1] * 5, tensor, 0.2) == [-1] * 5


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
def test_many_assignments_at_once_are_as_one_by_one(order: int, unary: bool) -> None:
    rng = np.random.default_rng(order)
    tensor = random_tensor(rng, order, unary)
    assignments = np.array([rng.permutation(9)[:7] for _ in range(60)])
    assignments[rng.random(assignments.shape) < 0.2] = -1
    assignments[0] = -1
    whole = [tensor.score(assignment) for assignment in assignments]
    assert score_assignments(tensor, assignments) == pytest.approx(whole, rel=1e-12)
    dropped = 0
    for fraction in (0.0, 0.2, 0.8):
        kept, scores = drop_unsupported(tensor, assignments, fraction)
        assert score_assignments(tensor, kept).tolist() == scores.tolist()
        for assignment, got, score in zip(assignments, kept, scores, strict=True):
            expected = dropped_one_by_one(assignment, tensor, fraction)
            assert got.tolist() == expected.tolist()
            assert score == pytest.approx(tensor.score(expected), rel=1e-12)
            dropped += int((got != assignment).sum())
    assert dropped >= 60
