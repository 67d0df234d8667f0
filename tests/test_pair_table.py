"""The table of pairs of a tensor of order 3, and what a search does with it."""

import itertools

import numpy as np
import pytest

from rootmatch.hypergraph.assignment import discretise
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers import MultiStartAscent, ReweightedWalk
from rootmatch.solvers.ascent.assignment_state import change, empty_state
from rootmatch.solvers.ascent.pair_table import pair_total, place_of_pair
from rootmatch.solvers.ascent.random_walk_start import _contract_chosen, random_walk_start
from rootmatch.solvers.ascent.start_selection import lies_within_assignments, next_starts
from rootmatch.solvers.ascent.subset_index import build_index, ranked_hyperedges
from solver_oracles import dense_contraction, dense_tensor, naive_support, planted, random_edges
from test_solvers_ascent import random_tensor


def one_pair(count=28):
    """All hyper-edges share one pair of correspondences, and the last comes twice."""
    edges = [[9, 0, i * 8 + k] for i in range(2, 8) for k in range(2, 8)][:count]
    edges.append([edges[-1][2], 9, 0])
    return AffinityTensor(edges, np.linspace(0.0, 1.0, len(edges)), (8, 8))


def dense():
    """Every triple of correspondences that there is."""
    pairs = itertools.product(itertools.combinations(range(4), 3), itertools.permutations(range(4), 3))
    edges = [np.array(i) * 4 + np.array(k) for i, k in pairs]
    return AffinityTensor(np.array(edges), np.ones(len(edges)), (4, 4))


def tabled(tensor, monkeypatch):
    """The index of a tensor, by a table in any case."""
    monkeypatch.setattr("rootmatch.solvers.ascent.pair_table.SPARSEST", np.inf)
    index = build_index(tensor)
    assert index.paired
    return index


def test_ranks_are_places_in_any_order():
    ranks = [place_of_pair(np.uint32(a), np.uint32(b)) for b in range(12) for a in range(b)]
    assert ranks == list(range(pair_total(12)))
    assert [place_of_pair(np.uint32(b), np.uint32(a)) for b in range(12) for a in range(b)] == ranks


def test_who_gets_a_table():
    assert build_index(random_tensor(0)).paired
    assert not build_index(random_tensor(0, 12, 12)).paired
    rng = np.random.default_rng(0)
    assert not build_index(AffinityTensor(random_edges(rng, 5, 5, 4, 900), np.ones(900), (5, 5))).paired


@pytest.mark.parametrize("make", [lambda: random_tensor(1), lambda: random_tensor(2, 5, 9, count=20), one_pair, dense])
def test_table_against_the_definition(make, monkeypatch):
    tensor = make()
    index = tabled(tensor, monkeypatch)
    size = tensor.shape[0] * tensor.shape[1]
    edges = [set(edge) for edge in tensor.indices.tolist()]
    for b in range(size):
        for a in range(b):
            place = place_of_pair(np.uint32(a), np.uint32(b))
            row = slice(int(index.start[place]), int(index.start[place + 1]))
            held = [(edge - {a, b}, h) for edge, h in zip(edges, tensor.weights, strict=True) if {a, b} <= edge]
            assert [({int(c)}, h) for c, h in zip(index.others[row], index.held[row], strict=True)] == held
            assert index.sums[place] == pytest.approx(sum(h for _, h in held), abs=1e-12)
    totals = [sum(h for edge, h in zip(edges, tensor.weights, strict=True) if a in edge) for a in range(size)]
    np.testing.assert_allclose(index.marginals, totals, atol=1e-12)
    rank, best = ranked_hyperedges(index)
    np.testing.assert_allclose(rank, naive_support(tensor.indices, tensor.weights) + tensor.weights, atol=1e-12)
    for a in range(size):
        containing = np.flatnonzero((tensor.indices == a).any(axis=1))
        assert best[a] == (containing[np.argmax(rank[containing])] if containing.size else -1)


@pytest.mark.parametrize("make", [lambda: random_tensor(3), lambda: random_tensor(4, 5, 9, count=30), one_pair, dense])
def test_gains_are_those_of_the_buckets_to_the_last_bit(make, monkeypatch):
    tensor = make()
    table, buckets = tabled(tensor, monkeypatch), build_index(tensor, bucket_bits=6)
    assert not buckets.paired
    one, other = empty_state(table), empty_state(buckets)
    rng = np.random.default_rng(0)
    for _ in range(200):
        i, k = int(rng.integers(tensor.shape[0])), int(rng.integers(tensor.shape[1]))
        a = i * tensor.shape[1] + k
        entering = one.image[i] < 0 and one.owner[k] < 0
        if not entering and not one.inside[a]:
            continue
        for index, state in ((table, one), (buckets, other)):
            change(index, state, a, entering)
        np.testing.assert_array_equal(one.gains, other.gains)
        np.testing.assert_array_equal(one.pairs, other.pairs)
        assert one.total[0] == other.total[0]


def test_solutions_with_and_without_a_table_are_the_same(monkeypatch):
    solver = MultiStartAscent(walk=0)
    for seed in range(6):
        indices, weights, _ = planted(seed, 8, 9, 3, 1500)
        tensor = AffinityTensor(indices, weights, (8, 9))
        one, other = solver.solve(tabled(tensor, monkeypatch)), solver.solve(build_index(tensor, bucket_bits=9))
        np.testing.assert_array_equal(one.assignment, other.assignment)
        assert one.score == pytest.approx(other.score, rel=1e-12)
        assert [v for _, v in one.alternatives] == pytest.approx([v for _, v in other.alternatives], rel=1e-9)


def test_contraction_among_few_correspondences(monkeypatch):
    tensor = random_tensor(5)
    index = tabled(tensor, monkeypatch)
    rng = np.random.default_rng(0)
    chosen = np.sort(rng.permutation(42)[:17])
    x = np.zeros(42)
    x[chosen] = rng.random(17)
    v = np.zeros(42)
    _contract_chosen(index, x, chosen, v)
    expected = dense_contraction(dense_tensor(tensor.indices, tensor.weights, 42), x)
    np.testing.assert_allclose(v, expected, atol=1e-12)


@pytest.mark.parametrize("steps", [1, 3, 10])
def test_a_walk_of_all_correspondences_is_the_published_one(steps, monkeypatch):
    for seed in range(5):
        indices, weights, _ = planted(seed, 7, 8, 3, 800)
        unary = np.random.default_rng(seed).random((7, 8)) * 1e-3 if seed % 2 else None
        tensor = AffinityTensor(indices, weights, (7, 8), unary)
        walked = ReweightedWalk(iterations=steps, keep=0)(tensor).assignment
        np.testing.assert_array_equal(random_walk_start(tabled(tensor, monkeypatch), steps), walked)
        np.testing.assert_array_equal(random_walk_start(build_index(tensor, bucket_bits=9), steps), walked)


def test_a_walk_that_forgets_the_lightest_still_finds_what_is_planted(monkeypatch):
    indices, weights, truth = planted(2, 12, 14, 3, 4000)
    index = tabled(AffinityTensor(indices, weights, (12, 14)), monkeypatch)
    monkeypatch.setattr("rootmatch.solvers.ascent.random_walk_start.HEAVIEST", 40)
    np.testing.assert_array_equal(random_walk_start(index, 10), truth)
    # Nothing to walk on: what is left is any assignment at all.
    nowhere = tabled(AffinityTensor([[0, 4, 8]], [0.0], (3, 3), np.zeros((3, 3))), monkeypatch)
    np.testing.assert_array_equal(random_walk_start(nowhere, 10), discretise(np.full((3, 3), 1 / 9)))


@pytest.mark.parametrize("known", [0, 3])
def test_next_starts_against_the_definition(known):
    rng = np.random.default_rng(3)
    images = np.array([rng.permutation(6) for _ in range(known)], np.int64).reshape(-1, 6)
    for count in (1, 4, 30):
        candidates = random_edges(rng, 6, 6, 3, 60).astype(np.int32)
        open_ = rng.random(60) < 0.7
        far = [all(sum(i * 6 + k in c for i, k in enumerate(s)) < 2 for s in images.tolist()) for c in candidates]
        assert all(far) == (known == 0)
        chosen: list[int] = []
        for c in np.flatnonzero(open_ & far):
            if all(len(set(candidates[c]) & set(candidates[s])) <= 1 for s in chosen) and len(chosen) < count:
                chosen.append(int(c))
        left = open_ & far
        left[chosen] = False
        np.testing.assert_array_equal(next_starts(candidates, open_, images, 6, minimum=2, count=count), chosen)
        np.testing.assert_array_equal(open_, left)


def test_candidates_within_assignments_against_the_definition():
    rng = np.random.default_rng(4)
    candidates = random_edges(rng, 5, 6, 3, 200).astype(np.int32)
    images = np.array([rng.permutation(6)[:5] for _ in range(4)])
    images[1, 2] = images[2, 0] = -1
    sets = [{i * 6 + k for i, k in enumerate(image) if k >= 0} for image in images]
    for minimum in (1, 2, 3):
        expected = [any(len(set(c) & s) >= minimum for s in sets) for c in candidates.tolist()]
        np.testing.assert_array_equal(lies_within_assignments(candidates, images, 6, minimum), expected)
        assert 0 < sum(expected) < 200
    assert not lies_within_assignments(candidates, images[:0], 6, 2).any()
