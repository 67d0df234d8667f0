"""The choice of hyper-edges: complete, uniform, nested, and within what a mask allows."""

from itertools import combinations, permutations

import numpy as np
import pytest

from rootmatch.errors import InputError
from rootmatch.hypergraph.enumeration import (
    estimated_count,
    exhaustive_count,
    farthest_point_order,
    random_hyperedges,
    source_bases,
    subsets,
    sweep_cost,
    target_arrangements,
)
from rootmatch.hypergraph.random_tuples import distinct_sets, distinct_tuples, permuted_tuples


@pytest.mark.parametrize(("n", "n_target", "order"), [(5, 5, 3), (5, 6, 4), (7, 4, 4), (4, 4, 4), (3, 5, 3)])
def test_count_is_the_number_of_tuples(n: int, n_target: int, order: int) -> None:
    listed = sum(1 for _ in combinations(range(n), order)) * sum(1 for _ in permutations(range(n_target), order))
    assert exhaustive_count(n, n_target, order) == listed


@pytest.mark.parametrize(("n_target", "length"), [(4, 2), (5, 3), (3, 3)])
def test_arrangements_are_all_ordered_choices(n_target: int, length: int) -> None:
    rows = [tuple(map(int, row)) for row in target_arrangements(n_target, length)]
    assert rows == list(permutations(range(n_target), length))


@pytest.mark.parametrize(("n", "size"), [(5, 2), (6, 3), (3, 3), (2, 3)])
def test_subsets_are_all_combinations_and_the_callers_own(n: int, size: int) -> None:
    for _ in range(2):
        rows = subsets(n, size)
        assert [tuple(row) for row in rows.tolist()] == list(combinations(range(n), size))
        rows[:] = 0


def test_bases_leave_a_later_point() -> None:
    bases = source_bases(6, 4)
    assert [tuple(map(int, row)) for row in bases] == list(combinations(range(5), 3))


def test_a_mask_leaves_out_points_without_a_candidate_and_its_sweep_costs_what_is_looked_at() -> None:
    usable = np.array([True, False, True, True, False, True])
    assert source_bases(6, 3, usable).tolist() == [[0, 2], [0, 3], [2, 3]]
    assert target_arrangements(6, 2, usable).tolist() == [list(one) for one in permutations([0, 2, 3, 5], 2)]
    pairs = np.eye(300, dtype=np.bool_)
    assert estimated_count(300, 300, 4, pairs) < 1e9 < 1e13 < sweep_cost(300, 300, 4, pairs)
    assert sweep_cost(9, 8, 4, None) == exhaustive_count(9, 8, 4)


def test_a_list_beyond_memory_is_refused() -> None:
    with pytest.raises(InputError, match="more than is listed"):
        subsets(3000, 3)
    with pytest.raises(InputError, match="more than is listed"):
        target_arrangements(3000, 3)


def _drawn(count: int, block: int, **more: object) -> tuple[np.ndarray, np.ndarray]:
    parts = list(random_hyperedges(9, 12, 4, count, seed=3, block=block, **more))
    assert all(len(source) <= block for source, _ in parts)
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def test_stream_is_nested_whatever_the_block() -> None:
    source, target = _drawn(40_000, 65_536)
    for count, block in ((1, 1000), (999, 100), (8192, 8192), (20_001, 5_000)):
        first, second = _drawn(count, block)
        assert len(first) == count
        np.testing.assert_array_equal(first, source[:count])
        np.testing.assert_array_equal(second, target[:count])


def test_stream_is_uniform_over_distinct_tuples() -> None:
    parts = list(random_hyperedges(4, 4, 3, 240_000, seed=0))
    for side in (0, 1):
        tuples = np.concatenate([part[side] for part in parts])
        ordered = np.sort(tuples, axis=1)
        assert np.all(ordered[:, 1:] > ordered[:, :-1])
        _, counts = np.unique(tuples @ [16, 4, 1], return_counts=True)
        assert len(counts) == 24
        # 10,000 expected of each; five standard deviations
        assert np.abs(counts - 10_000).max() < 500


@pytest.mark.parametrize("draw", [distinct_tuples, permuted_tuples])
def test_tuples_are_uniform_and_distinct(draw) -> None:  # type: ignore[no-untyped-def]
    tuples = draw(np.random.default_rng(0), 240_000, 4, 3)
    assert tuples.shape == (240_000, 3)
    _, counts = np.unique(tuples @ [16, 4, 1], return_counts=True)
    # all 24 ordered choices; 10,000 expected of each; five standard deviations
    assert len(counts) == 24
    assert np.abs(counts - 10_000).max() < 500


def test_sets_are_uniform_ascending_and_distinct() -> None:
    sets = distinct_sets(np.random.default_rng(0), 160_000, 4, 2)
    # a quarter of the draws repeats an index
    assert len(sets) == pytest.approx(120_000, abs=1_000)
    found, counts = np.unique(sets, axis=0, return_counts=True)
    assert [tuple(row) for row in found.tolist()] == list(combinations(range(4), 2))
    assert np.abs(counts - len(sets) / 6).max() < 750


def test_another_seed_is_another_stream() -> None:
    one = next(random_hyperedges(9, 12, 4, 100, seed=1))
    two = next(random_hyperedges(9, 12, 4, 100, seed=2))
    assert not np.array_equal(one[0], two[0])


def test_mask_is_respected_and_reached() -> None:
    mask = np.random.default_rng(0).random((9, 12)) < 0.5
    source, target = _drawn(5_000, 1_000, mask=mask)
    assert len(source) == 5_000
    assert mask[source, target].all()


def test_impossible_requests_are_refused() -> None:
    with pytest.raises(InputError, match="at least 4"):
        next(random_hyperedges(3, 12, 4, 10, seed=0))
    with pytest.raises(InputError, match="positive"):
        next(random_hyperedges(9, 12, 4, 0, seed=0))
    nearly_empty = np.zeros((40, 40), dtype=bool)
    nearly_empty[:4, :4] = np.eye(4, dtype=bool)
    with pytest.raises(InputError, match="exhaustive"):
        next(random_hyperedges(40, 40, 4, 10, seed=0, mask=nearly_empty))


def test_wide_first_takes_the_farthest_each_time() -> None:
    points = np.random.default_rng(1).normal(size=(12, 3))
    order = farthest_point_order(points)
    assert sorted(order) == list(range(12))
    for k in range(1, 12):
        gap = [min(np.linalg.norm(points[p] - points[q]) for q in order[:k]) for p in order[k:]]
        assert gap[0] == pytest.approx(max(gap))
