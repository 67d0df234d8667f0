"""Matches divided into rigid motions."""

import numpy as np
import pytest

from rootmatch.explain.motion_groups import label_motions
from rootmatch.hypergraph.tensor import AffinityTensor


def blocks(sizes: list[int], weight: float = 0.5, unmatched: int = 0) -> tuple[np.ndarray, AffinityTensor]:
    """An identity assignment whose hyper-edges of order 3 lie within blocks of consecutive points, in mixed order."""
    n = sum(sizes)
    label = np.random.default_rng(0).permutation(np.repeat(np.arange(len(sizes)), sizes))
    triples = [(a, b, c) for a in range(n) for b in range(a) for c in range(b) if label[a] == label[b] == label[c]]
    total = n + unmatched
    indices = np.array(triples, dtype=np.int32) * (total + 1)
    tensor = AffinityTensor(indices, np.full(len(indices), weight), (total, total))
    return label, tensor


def same_partition(first: np.ndarray, second: np.ndarray) -> bool:
    return bool(((first[:, None] == first) == (second[:, None] == second)).all())


@pytest.mark.parametrize("sizes", [[10], [5, 5], [7, 4], [5, 5, 5, 5], [8, 3, 6]])
@pytest.mark.parametrize("asked", ["auto", "exact"])
def test_blocks_are_told_apart(sizes: list[int], asked: str) -> None:
    truth, tensor = blocks(sizes)
    assignment = np.arange(len(truth))
    labels = label_motions(assignment, tensor, "auto" if asked == "auto" else len(sizes))
    assert same_partition(labels, truth)
    counts = np.bincount(labels)
    assert list(counts) == sorted(counts, reverse=True)


def test_one_motion_is_one_label_and_unmatched_points_have_none() -> None:
    truth, tensor = blocks([5, 5], unmatched=2)
    assignment = np.append(np.arange(len(truth)), [-1, -1])
    np.testing.assert_array_equal(label_motions(assignment, tensor, 1), [0] * 10 + [-1, -1])
    assert set(label_motions(assignment, tensor, 2)[-2:]) == {-1}
