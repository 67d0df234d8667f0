"""Which hyper-edges the ascent starts from in a large tensor, and how much it reads there."""

import numba
import numpy as np
import pytest

from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers import MultiStartAscent
from rootmatch.solvers.ascent import bounded_ascents, multi_start
from rootmatch.solvers.ascent.bounded_ascents import BoundedAscents
from rootmatch.solvers.ascent.climb import climb_from, state_of
from rootmatch.solvers.ascent.start_ranking import heaviest, rank_candidates, rank_heaviest
from rootmatch.solvers.ascent.subset_index import build_index
from solver_oracles import naive_support, planted
from test_solvers_ascent import random_tensor


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_ranks_that_are_looked_up_are_weights_with_support(order):
    tensor = random_tensor(order, 5, 5, order, 150)
    index = build_index(tensor, bucket_bits=20)
    expected = naive_support(tensor.indices, tensor.weights) + tensor.weights
    numbers, ranks = rank_heaviest(index, 10**9)
    assert sorted(numbers) == list(range(150))
    np.testing.assert_allclose(ranks, expected[numbers], atol=1e-12)
    some, few = rank_heaviest(index, 60)
    assert 0 < len(some) <= 60 // order + 1
    np.testing.assert_allclose(few, expected[some], atol=1e-12)


@pytest.mark.parametrize("maximum", [10**9, 400])
def test_candidates_are_the_best_of_those_that_are_ranked(maximum, monkeypatch):
    tensor = random_tensor(3, 6, 7, 3, 600)
    index = build_index(tensor, bucket_bits=12)
    edges, ranks = rank_candidates(index, 5, maximum)
    rank = naive_support(tensor.indices, tensor.weights) + tensor.weights
    ranked = np.arange(600) if maximum > 600 else rank_heaviest(index, maximum)[0]
    wanted = set(ranked[np.argsort(-rank[ranked])[:5]].tolist())
    for a in range(42):
        containing = ranked[(tensor.indices[ranked] == a).any(axis=1)]
        wanted |= {containing[np.argmax(rank[containing])]} if containing.size else set()
    assert {tuple(edge) for edge in edges} == {tuple(tensor.indices[e]) for e in wanted}
    np.testing.assert_allclose(ranks, sorted(rank[list(wanted)], reverse=True), atol=1e-12)


def test_the_heaviest_are_told_from_the_others():
    rng = np.random.default_rng(0)
    weights = rng.random(5000)
    few = heaviest(weights, 700)
    np.testing.assert_array_equal(few, np.sort(few))
    assert len(few) == pytest.approx(700, abs=150)  # by a sample, which repeats some places
    assert weights[few].min() > np.delete(weights, few).max()
    np.testing.assert_array_equal(heaviest(weights, 5000), np.arange(5000))


def test_of_equal_weights_some_are_taken_from_everywhere():
    weights = np.full(9000, 0.5)
    weights[::100] = 1.0
    few = heaviest(weights, 900)
    assert set(few) >= set(range(0, 9000, 100))
    assert len(few) == pytest.approx(900, abs=30)
    assert np.histogram(few, 9, (0, 9000))[0].min() > 80


def test_a_state_reached_from_another_is_the_same():
    tensor = random_tensor(3, 7, 8, 4, 4000)
    index = build_index(tensor)
    root = state_of(index, np.array([0, 1, 2, 3, 4, 5, -1]))
    image = np.array([1, 0, 2, -1, 7, 5, 6])
    near, far = state_of(index, image, root), state_of(index, image)
    np.testing.assert_array_equal(root.image, [0, 1, 2, 3, 4, 5, -1])
    np.testing.assert_array_equal(near.image, image)
    np.testing.assert_allclose(near.gains, far.gains, atol=1e-10)
    np.testing.assert_allclose(near.pairs, far.pairs, atol=1e-10)
    assert near.total[0] == pytest.approx(far.total[0], abs=1e-10)


def test_reads_are_the_subsets_that_are_looked_up_and_what_is_found():
    """The members 0 … 5 enter in turn: of each with any two of those before there is one look-up, at order 4."""
    edges = [[0, 9, 18, 27], [0, 9, 18, 36]]
    index = build_index(AffinityTensor(edges, np.ones(2), (8, 8)), bucket_bits=20)
    state = state_of(index, np.array([0, 1, 2, 3, 4, 5, -1, -1]))
    # A hyper-edge is read with each of its subsets of three, but with those of its first three members only once.
    found = sum(np.all(np.isin([a, b, c], edge)) for edge in edges for c in M for b in M if b < c for a in M if a < b)
    assert state.reads[0] == 0 + 1 + 3 + 6 + 10 + found


M = [0, 9, 18, 27, 36, 45]


def hard():
    indices, weights, truth = planted(9, 12, 14, 3, 4000)
    return AffinityTensor(indices, weights, (12, 14)), truth


def test_no_ascent_begins_beyond_the_reads_that_are_allowed():
    tensor, _ = hard()
    free = MultiStartAscent()(tensor)
    reads = int(free.statistics["reads"])
    same = MultiStartAscent(max_reads=2 * reads)(tensor)
    minimum = MultiStartAscent(max_reads=0)(tensor).statistics["reads"]
    assert free.converged
    assert (same.score, same.statistics) == (free.score, free.statistics)
    last = free.statistics["starts"]
    for share in (2, 5, 20, 100):
        few = MultiStartAscent(max_reads=reads // share)(tensor)
        assert not few.converged
        assert few.statistics["starts"] <= last
        # one ascent of each stage may go beyond
        assert few.statistics["reads"] <= reads / share + 3 * minimum
        assert few.score == pytest.approx(tensor.score(few.assignment))
        last = few.statistics["starts"]
    assert last < free.statistics["starts"]


def test_without_reads_the_first_ascent_is_made_and_goes_on_with_exchanges():
    tensor, truth = hard()
    index = build_index(tensor)
    solution = MultiStartAscent(max_reads=0)(tensor)
    assert solution.statistics["starts"] >= 2
    np.testing.assert_array_equal(solution.assignment, truth)
    again = climb_from(
        index, state_of(index, solution.assignment), solution.assignment[None], penalty=0.0, limit=9, exchanges=True
    )
    assert again.moves[0] == 0


def test_what_is_left_out_does_not_depend_on_threads(monkeypatch):
    monkeypatch.setattr(multi_start, "RANKED", 3000)
    monkeypatch.setattr(bounded_ascents, "LOOKUPS_PER_THREAD", 100)
    indices, weights, _ = planted(9, 12, 14, 4, 20_000)
    tensor = AffinityTensor(indices, weights, (12, 14))
    solver = MultiStartAscent(max_reads=5000)
    threads, found = numba.get_num_threads(), []
    try:
        for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(count)
            found.append(solver(tensor))
    finally:
        numba.set_num_threads(threads)
    assert found[0].score == found[1].score
    assert found[0].statistics == found[1].statistics
    assert not found[0].converged


def test_a_stage_is_known_by_what_its_ascents_read():
    tensor, _ = hard()
    ascents = BoundedAscents(MultiStartAscent(max_reads=1000), build_index(tensor))
    ascents.made, ascents.reads, ascents.dearest = 1, 400, 500
    assert ascents.affordable(9, "rivals") == 1  # as dear as the dearest, until known
    ascents.mean_reads["rivals"] = 100.0
    assert ascents.affordable(9, "rivals") == 6
    assert ascents.affordable(4, "rivals") == 4
    ascents.reads = 990
    assert ascents.affordable(9, "rivals") == 0
    assert ascents.affordable(9, "forced") == 1  # one tells what more would take
    ascents.reads = 1000
    assert ascents.affordable(9, "forced") == 0
