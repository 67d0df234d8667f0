import itertools

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers import MultiStartAscent
from rootmatch.solvers.alternatives import best_neighbours
from rootmatch.solvers.ascent import multi_start, subset_index
from rootmatch.solvers.ascent.assignment_state import change
from rootmatch.solvers.ascent.climb import climb, state_of
from rootmatch.solvers.ascent.subset_index import build_index, ranked_hyperedges
from solver_oracles import assignments, best_score, naive_support, objective, planted, random_edges
from test_neighbourhood import one_change_neighbours


def random_tensor(seed, n=6, n_target=7, order=3, count=400, unary=False):
    rng = np.random.default_rng(seed)
    indices = random_edges(rng, n, n_target, order, count)
    prior = rng.random((n, n_target)) if unary else None
    return AffinityTensor(indices, rng.random(count), (n, n_target), prior)


def naive_gains(tensor, image):
    """What each correspondence adds to the members; from the definition, hyper-edge by hyper-edge."""
    members = {i * tensor.shape[1] + k for i, k in enumerate(image) if k >= 0}
    gains = np.zeros(tensor.shape[0] * tensor.shape[1])
    pairs = np.zeros((tensor.shape[0],) * 2)
    for edge, h in zip(tensor.indices.tolist(), tensor.weights, strict=True):
        for a in edge:
            if set(edge) - {a} <= members:
                gains[a] += h
        if set(edge) <= members:
            for a, b in itertools.permutations(edge, 2):
                pairs[a // tensor.shape[1], b // tensor.shape[1]] += h
    return gains, pairs


@pytest.mark.parametrize("order", [2, 3, 4, 5])
@pytest.mark.parametrize("bits", [None, 1, 4, 20])
def test_gains_follow_a_random_walk_of_entries_and_removals(order, bits):
    tensor = random_tensor(order, 6, 7, order, 3000, unary=True)
    index = build_index(tensor, bucket_bits=bits)
    rng = np.random.default_rng(0)
    state = state_of(index, np.full(6, -1))
    for step in range(60):
        a = int(rng.integers(42))
        if rng.random() < 0.7 or state.size[0] == 0:
            taken = [b for b in state.members[: state.size[0]] if b // 7 == a // 7 or b % 7 == a % 7]
            for b in taken:
                change(index, state, b, False)
            change(index, state, a, True)
        else:
            change(index, state, int(state.members[rng.integers(state.size[0])]), False)
        if step % 6 == 0:
            gains, pairs = naive_gains(tensor, state.image)
            np.testing.assert_allclose(state.gains, gains, atol=1e-10)
            np.testing.assert_allclose(state.pairs, pairs, atol=1e-10)
            assert state.total[0] == pytest.approx(tensor.score(state.image), abs=1e-10)
            matched = np.flatnonzero(state.image >= 0)
            assert sorted(state.members[: state.size[0]]) == sorted(matched * 7 + state.image[matched])
            np.testing.assert_array_equal(state.owner[state.image[matched]], matched)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
@pytest.mark.parametrize("bits", [None, 1, 3, 20])
def test_index_support_is_exact_but_for_collisions(order, bits):
    tensor = random_tensor(order, 5, 5, order, 150)
    rank, best = ranked_hyperedges(build_index(tensor, bucket_bits=bits))
    expected = naive_support(tensor.indices, tensor.weights) + tensor.weights
    np.testing.assert_allclose(rank, expected, atol=1e-12)
    for a in range(25):
        containing = np.flatnonzero((tensor.indices == a).any(axis=1))
        assert best[a] == (containing[np.argmax(rank[containing])] if containing.size else -1)


def test_index_in_parts_is_the_same_on_any_number_of_threads(monkeypatch):
    tensor = random_tensor(3, 9, 9, 4, 4000)
    found = []
    for threads in (1, 3):
        monkeypatch.setattr(subset_index, "worthwhile_threads", lambda tasks, threads=threads: threads)
        found.append(build_index(tensor, bucket_bits=20))
    at_once = subset_index._index_at_once(
        tensor.indices, tensor.weights, found[0].keys, 20, found[0].bucket_shift, found[0].tag_shift, found[0].edge_bits
    )
    for index in found:
        np.testing.assert_array_equal(index.start, at_once[0])
        np.testing.assert_array_equal(index.entries, at_once[1])
        np.testing.assert_allclose(index.marginals, at_once[2])


def test_support_of_a_hot_bucket():
    # All hyper-edges share one pair of correspondences, so one bucket holds hundreds.
    edges = [[0, 31, i * 30 + k] for i in range(2, 30) for k in range(2, 30)]
    tensor = AffinityTensor(edges, np.ones(len(edges)), (30, 30))
    np.testing.assert_allclose(ranked_hyperedges(build_index(tensor))[0], tensor.support() + tensor.weights)


def tiny(seed):
    rng = np.random.default_rng(seed)
    n, n_target = (int(m) for m in rng.integers(2, 6, 2))
    order = int(rng.integers(2, min(n, n_target, 4) + 1))
    count = int(rng.integers(1, 60))
    return random_tensor(seed, n, n_target, order, count, unary=bool(rng.integers(2)))


def test_a_dominant_assignment_is_what_the_whole_search_finds(monkeypatch):
    fewer = 0
    for seed in range(10):
        indices, weights, truth = planted(seed, 12, 12, 3, 130, 0)
        tensor = AffinityTensor(indices, weights, (12, 12))
        short = MultiStartAscent()(tensor)
        with monkeypatch.context() as searched:
            searched.setattr(multi_start, "DOMINANT", 2.0)
            whole = MultiStartAscent()(tensor)
        np.testing.assert_array_equal(short.assignment, whole.assignment)
        np.testing.assert_array_equal(short.assignment, truth)
        assert max(score for _, score in short.alternatives) >= max(score for _, score in whole.alternatives) - 1e-9
        fewer += short.statistics["starts"] < whole.statistics["starts"]
    assert fewer == 10


@pytest.mark.parametrize("penalty", [0.0, 0.4])
def test_optimum_of_tiny_instances(penalty):
    """Against all assignments. A local search may miss an optimum in general; here it does not."""
    missed = 0
    for seed in range(100):
        tensor = tiny(seed)
        best = best_score(tensor.indices, tensor.weights, tensor.shape, tensor.unary, penalty)
        solution = MultiStartAscent(penalty=penalty)(tensor)
        own = objective(tensor.indices, tensor.weights, solution.assignment, tensor.shape[1], tensor.unary, penalty)
        assert solution.score == pytest.approx(own, abs=1e-10)
        assert own <= best + 1e-10
        missed += own < best - 1e-10
    assert missed == 0


@given(seed=st.integers(0, 2**32 - 1), penalty=st.sampled_from([0.0, 0.3]))
@settings(max_examples=40, deadline=None)
def test_no_single_change_improves_the_answer(seed, penalty):
    tensor = tiny(seed)

    def value(X):
        return objective(tensor.indices, tensor.weights, X, tensor.shape[1], tensor.unary, penalty)

    solution = MultiStartAscent(penalty=penalty)(tensor)
    X, n_target = solution.assignment, tensor.shape[1]
    assert solution.score == pytest.approx(value(X), abs=1e-10)
    for i in range(X.size):
        for k in range(-1, n_target):
            changed = np.where(k == X, -1, X) if k >= 0 else X.copy()
            changed[i] = k
            assert value(changed) <= solution.score + 1e-8
        for j in range(i):
            changed = X.copy()
            changed[[i, j]] = X[[j, i]]
            assert value(changed) <= solution.score + 1e-8


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("penalty", [0.0, 0.2])
def test_ascent_is_strictly_monotone(order, penalty):
    tensor = random_tensor(7, 7, 8, order, 4000 if order > 2 else 300, unary=True)
    index = build_index(tensor)
    rng = np.random.default_rng(1)
    for _ in range(5):
        state = state_of(index, np.full(7, -1))
        for a in random_edges(rng, 7, 8, order, 1)[0]:
            change(index, state, int(a), True)
        value = objective(tensor.indices, tensor.weights, state.image, 8, tensor.unary, penalty)
        steps, begins = 0, np.ones(1, np.int64)
        while climb(index, state, begins, penalty=penalty, limit=1, exchanges=True) == 1:
            new = objective(tensor.indices, tensor.weights, state.image, 8, tensor.unary, penalty)
            assert new > value
            value, steps = new, steps + 1
        assert steps > 0


@pytest.mark.parametrize(
    ("n", "n_target", "order", "false", "hidden"),
    [(10, 10, 3, 2000, 0), (8, 20, 4, 20000, 0), (12, 9, 3, 3000, 0), (12, 12, 4, 20000, 4), (9, 9, 2, 60, 0)],
)
def test_planted_assignment_is_found(n, n_target, order, false, hidden):
    for seed in range(3):
        indices, weights, truth = planted(seed, n, n_target, order, false, hidden)
        solution = MultiStartAscent()(AffinityTensor(indices, weights, (n, n_target)))
        seen = truth >= 0
        np.testing.assert_array_equal(solution.assignment[seen], truth[seen])
        assert solution.converged


def test_penalty_leaves_out_points_without_image():
    indices, weights, truth = planted(3, 14, 14, 3, 10000, hidden=5)
    tensor = AffinityTensor(indices, weights, (14, 14))
    plain, strict = MultiStartAscent()(tensor), MultiStartAscent(penalty=0.2)(tensor)
    assert np.sum(plain.assignment >= 0) > 9
    np.testing.assert_array_equal(strict.assignment, truth)


def test_independent_groups_are_put_together():
    """Several motions: hyper-edges within a group only, so no hyper-edge leads from one group to the next."""
    rng = np.random.default_rng(4)
    truth = rng.permutation(24)
    edges = [list(e) for g in range(4) for e in itertools.combinations(range(6 * g, 6 * g + 6), 3)]
    true = np.array(edges) * 24 + truth[np.array(edges)]
    false = random_edges(rng, 24, 24, 3, 30000)
    weights = np.concatenate([np.exp(-rng.chisquare(2, len(true)) / 2), np.exp(-rng.uniform(0, 12, 30000) / 2)])
    tensor = AffinityTensor(np.concatenate([true, false]), weights, (24, 24))
    solution = MultiStartAscent()(tensor)
    assert solution.score >= tensor.score(truth) - 1e-9
    assert np.mean(solution.assignment == truth) == 1


def test_alternatives_are_different_ordered_and_correctly_scored():
    indices, weights, _ = planted(5, 7, 9, 3, 2000)
    tensor = AffinityTensor(indices, weights, (7, 9))
    solution = MultiStartAscent(keep=12)(tensor)
    assert len(solution.alternatives) == 12
    keys = {tuple(image) for image, _ in solution.alternatives}
    assert len(keys) == 12
    assert tuple(solution.assignment) not in keys
    values = [value for _, value in solution.alternatives]
    assert values == sorted(values, reverse=True)
    for image, value in solution.alternatives:
        assert tensor.score(image) == pytest.approx(value, rel=1e-9)
        assert np.any((image >= 0) & (image != solution.assignment))
    assert solution.margin == pytest.approx(1 - values[0] / solution.score)


def test_best_alternative_of_a_tiny_instance_is_the_second_best_of_all():
    for seed in range(10):
        indices, weights, _ = planted(seed, 4, 4, 3, 40)
        tensor = AffinityTensor(indices, weights, (4, 4))
        solution = MultiStartAscent()(tensor)
        X = solution.assignment
        different = [A for A in assignments(4, 4) if np.any((A >= 0) & (X >= 0) & (A != X))]
        second = max(tensor.score(A) for A in different)
        assert solution.alternatives[0][1] == pytest.approx(second, rel=1e-9)


def test_ambiguous_scene_has_no_margin():
    """The mirrored assignment scores just as well: it must come first among the alternatives."""
    truth, twin = np.arange(7), np.arange(7)[::-1]
    edges = np.array(list(itertools.combinations(range(7), 3)))
    indices = np.concatenate([edges * 7 + truth[edges], edges * 7 + twin[edges]])
    tensor = AffinityTensor(indices, np.ones(len(indices)), (7, 7)).merged()
    solution = MultiStartAscent()(tensor)
    answers = {tuple(solution.assignment), tuple(solution.alternatives[0][0])}
    assert answers == {tuple(truth), tuple(twin)}
    assert solution.margin == 0


def test_doubtful_points_do_not_crowd_out_the_alternatives_that_matter():
    indices, weights, truth = planted(6, 10, 40, 3, 6000, hidden=3)
    tensor = AffinityTensor(indices, weights, (10, 40))
    solution = MultiStartAscent()(tensor)
    seen = truth >= 0
    np.testing.assert_array_equal(solution.assignment[seen], truth[seen])
    moved = [np.any((image != truth) & (image >= 0) & seen) for image, _ in solution.alternatives]
    assert sum(moved) >= 8


def test_groups_that_drown_in_doubtful_matches_are_found():
    """Eight groups of five among so many false hyper-edges that no group alone outweighs what it would push out."""
    rng = np.random.default_rng(1)
    truth = rng.permutation(40)
    edges = np.array([e for g in range(8) for e in itertools.combinations(range(5 * g, 5 * g + 5), 3)])
    false = random_edges(rng, 40, 40, 3, 500_000)
    weights = np.concatenate([np.exp(-rng.chisquare(2, len(edges)) / 2), np.exp(-rng.uniform(0, 12, len(false)) / 2)])
    tensor = AffinityTensor(np.concatenate([edges * 40 + truth[edges], false]), weights, (40, 40))
    np.testing.assert_array_equal(MultiStartAscent()(tensor).assignment, truth)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_scored_neighbours_are_scored_exactly(order):
    tensor = random_tensor(order, 6, 7, order, 3000 if order > 2 else 250, unary=True)
    X = np.array([2, 0, -1, 6, 4, 5])
    images, values = zip(*best_neighbours(tensor, X, 1000), strict=True)
    expected = set()
    for i in np.flatnonzero(X >= 0):
        for k in (1, 3):
            changed = X.copy()
            changed[i] = k
            expected.add(tuple(changed))
        for j in range(6):
            changed = X.copy()
            changed[[i, j]] = X[[j, i]]
            expected.add(tuple(changed))
    expected.discard(tuple(X))
    assert {tuple(image) for image in images} == expected
    for image, value in zip(images, values, strict=True):
        own = objective(tensor.indices, tensor.weights, image, 7, tensor.unary, 0.0)
        assert value == pytest.approx(own, abs=1e-10)
    few_images, few = zip(*best_neighbours(tensor, X, 5), strict=True)
    np.testing.assert_allclose(few, values[:5])
    assert len(few_images) == 5


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("seed", range(4))
def test_neighbours_of_equal_scores_come_in_the_order_in_which_they_are_listed(order, seed):
    rng = np.random.default_rng(seed)
    n, n_target = 5, int(rng.integers(5, 8))
    indices = random_edges(rng, n, n_target, order, 300)
    tensor = AffinityTensor(indices, rng.integers(0, 2, len(indices)) * 1.0, (n, n_target))
    image = np.where(rng.random(n) < 0.8, rng.permutation(n_target)[:n], -1)
    assert (image >= 0).any()
    every = one_change_neighbours(image, n_target).apply_to(image)
    scores = np.array([objective(tensor.indices, tensor.weights, one, n_target, None, 0.0) for one in every])
    best = np.argsort(-scores, kind="stable")
    for keep in (3, 1000):
        images, values = zip(*best_neighbours(tensor, image, keep), strict=True)
        np.testing.assert_array_equal(images, every[best[:keep]])
        np.testing.assert_allclose(values, scores[best[:keep]], atol=1e-12)


@pytest.mark.parametrize("order", [3, 4])
def test_a_state_that_is_reached_at_once_is_the_one_by_pieces(order):
    index = build_index(random_tensor(order, 6, 7, order, 2000, unary=True))
    for image in ([2, 0, -1, 6, 4, 5], [-1] * 6, [0, 1, 2, 3, 4, 5]):
        at_once, by_pieces = (state_of(index, np.array(image), at_once=one) for one in (True, False))
        for name in ("image", "owner", "inside", "size", "gains", "pairs", "total", "reads"):
            np.testing.assert_array_equal(getattr(at_once, name), getattr(by_pieces, name))


def same(a, b):
    np.testing.assert_array_equal(a.assignment, b.assignment)
    assert a.score == b.score
    assert len(a.alternatives) == len(b.alternatives)
    for (x, s), (y, t) in zip(a.alternatives, b.alternatives, strict=True):
        np.testing.assert_array_equal(x, y)
        assert s == t


def test_same_answer_for_any_number_of_threads_and_again():
    indices, weights, _ = planted(7, 12, 14, 4, 60000)
    tensor = AffinityTensor(indices, weights, (12, 14))
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        first = MultiStartAscent()(tensor, seed=0)
        same(first, MultiStartAscent()(tensor, seed=1))
        numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
        same(first, MultiStartAscent()(tensor))
    finally:
        numba.set_num_threads(threads)


def test_collisions_do_not_change_answers():
    indices, weights, _ = planted(8, 8, 8, 3, 3000)
    tensor = AffinityTensor(indices, weights, (8, 8))
    solver = MultiStartAscent()
    usual = solver(tensor)
    for bits in (1, 3):
        crowded = solver.solve(build_index(tensor, bucket_bits=bits))
        np.testing.assert_array_equal(usual.assignment, crowded.assignment)
        assert usual.score == pytest.approx(crowded.score, rel=1e-12)


def test_duplicates_count_as_often_as_they_come():
    indices, weights, _ = planted(9, 6, 6, 3, 300)
    tensor = AffinityTensor(indices, weights, (6, 6)).merged()
    indices, weights = tensor.indices, tensor.weights
    rng = np.random.default_rng(0)
    twice = AffinityTensor(np.concatenate([indices, rng.permuted(indices, axis=1)]), np.tile(weights, 2), (6, 6))
    once, both, merged = (MultiStartAscent()(t) for t in (tensor, twice, twice.merged()))
    np.testing.assert_array_equal(once.assignment, both.assignment)
    assert both.score == pytest.approx(2 * once.score)
    assert merged.score == pytest.approx(once.score)


def test_nothing_and_next_to_nothing():
    empty = AffinityTensor(np.zeros((0, 4), np.int32), [], (5, 6))
    solution = MultiStartAscent()(empty)
    assert solution.assignment.tolist() == [-1] * 5
    assert (solution.score, solution.alternatives, solution.converged) == (0.0, [], True)
    one = MultiStartAscent()(AffinityTensor([[0, 7, 14]], [0.5], (5, 6)))
    assert one.assignment.tolist() == [0, 1, 2, -1, -1]
    assert one.score == 0.5
    for steps in (0, 15):
        assert MultiStartAscent(walk=steps)(AffinityTensor([[0, 7, 14]], [0.5], (5, 6))).score == 0.5
    # A penalty above every weight: the empty assignment is the best.
    none = MultiStartAscent(penalty=1.0)(AffinityTensor([[0, 7, 14]], [0.5], (5, 6)))
    assert none.assignment.tolist() == [-1] * 5
    assert none.score == 0


def test_unary_weights_decide_alone_and_break_ties():
    unary = np.array([[1.0, 5.0, 0.0], [4.0, 5.0, 0.0]])
    alone = MultiStartAscent()(AffinityTensor(np.zeros((0, 2), np.int32), [], (2, 3), unary))
    assert alone.assignment.tolist() == [1, 0]
    assert alone.score == 9.0
    edges = [[0, 4], [1, 3]]
    tied = MultiStartAscent()(AffinityTensor(edges, [1.0, 1.0], (2, 3), np.array([[0.1, 0, 0], [0, 0, 0]])))
    assert tied.assignment.tolist() == [0, 1]


def test_options_are_judged():
    for options in (
        {"starts": 0},
        {"walk": -1},
        {"penalty": -1},
        {"penalty": float("nan")},
        {"keep": -1},
        {"limit": 0},
    ):
        with pytest.raises(InputError):
            MultiStartAscent(**options)


def test_a_limit_that_was_reached_is_said():
    indices, weights, _ = planted(1, 8, 8, 3, 500)
    solution = MultiStartAscent(limit=1)(AffinityTensor(indices, weights, (8, 8)))
    assert not solution.converged
    assert "limit" in solution.status
