import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.simulation import p3p_scene
from rootmatch.solvers import SOLVERS, PowerIteration, get_solver
from rootmatch.solvers.alternatives import best_neighbours
from solver_oracles import planted, random_edges


def full_tensor(edges, weights, n, n_target):
    """H[i, i', j, j', …] of the paper, with every order of the correspondences of each hyper-edge."""
    order = len(edges[0])
    H = np.zeros((n, n_target) * order)
    for edge, weight in zip(edges, weights, strict=True):
        for correspondences in itertools.permutations(divmod(int(a), n_target) for a in edge):
            H[tuple(itertools.chain(*correspondences))] += weight
    return H


def contracted(H, X):
    """Σ over all correspondences but the first of H X … X, one axis after another from the last."""
    while H.ndim > 2:
        H = np.tensordot(H, X, axes=2)
    return H


def rows_of_the_paper(H, n, n_target, steps, bias=0.0):
    """X with Σ_i' X_ii' = 1 for each source point i: algorithm 2, one entry at a time, without any rule about n, n'."""
    start = n_target**-0.5
    Y = [[start] * n_target for _ in range(n)]
    for _ in range(steps):
        V = contracted(H, np.square(Y)) / math.factorial(H.ndim // 2 - 1)
        for i in range(n):
            row = [Y[i][k] * V[i, k] + bias * start for k in range(n_target)]
            length = math.hypot(*row)
            Y[i] = [value / length for value in row] if length > 0 else Y[i]
    return np.square(Y)


def dense_of_the_paper(H, n, n_target, steps, bias=0.0):
    """Algorithm 1: the vector of all entries has length 1."""
    X = start = np.full((n, n_target), (n * n_target) ** -0.5)
    for _ in range(steps):
        X = contracted(H, X) / math.factorial(H.ndim // 2 - 1) + bias * start
        X = X / math.hypot(*X.ravel())
    return X


def random_case(order, n, n_target):
    rng = np.random.default_rng(order)
    edges = random_edges(rng, n, n_target, order, 300)
    weights = rng.random(300)
    return AffinityTensor(edges, weights, (n, n_target)), full_tensor(edges, weights, n, n_target)


SIZES = [(2, 4, 4), (3, 4, 5), (3, 5, 4), (4, 5, 4), (4, 4, 4)]


@pytest.mark.parametrize("bias", [0.0, 0.5])
@pytest.mark.parametrize(("order", "n", "n_target"), SIZES)
def test_iterates_of_the_named_solvers_are_those_of_the_papers_equations(bias, order, n, n_target):
    """Rows of the source, whether they are more, fewer or as many as the targets."""
    tensor, H = random_case(order, n, n_target)
    for name, expected in (("power-l1", rows_of_the_paper), ("power-dense", dense_of_the_paper)):
        for steps in (1, 2, 5):
            solver = replace(get_solver(name), bias=bias, iterations=steps)
            np.testing.assert_allclose(solver(tensor).soft, expected(H, n, n_target, steps, bias), rtol=1e-9)


@pytest.mark.parametrize(("order", "n", "n_target"), SIZES)
def test_each_way_to_normalise_sums_its_own_lines_to_one(order, n, n_target):
    tensor, H = random_case(order, n, n_target)
    for steps in (1, 5):
        ways = {
            w: PowerIteration("l1", normalise=w, iterations=steps)(tensor).soft for w in ("rows", "both", "smaller")
        }
        np.testing.assert_allclose(ways["rows"].sum(axis=1), 1.0, rtol=1e-12)
        np.testing.assert_allclose(ways["both"].sum(axis=0), 1.0, rtol=1e-12)
        if n == n_target:
            np.testing.assert_array_equal(ways["smaller"], ways["both"])
        elif n < n_target:
            np.testing.assert_array_equal(ways["smaller"], ways["rows"])
        else:
            # the problem the other way round has its sources where this one has its targets
            turned = np.moveaxis(H, range(H.ndim), [a ^ 1 for a in range(H.ndim)])
            np.testing.assert_allclose(ways["smaller"].T, rows_of_the_paper(turned, n_target, n, steps), rtol=1e-9)
        assert np.abs(ways["both"] - ways["rows"]).max() > 1e-3


def test_rows_let_points_gather_on_one_target_and_balancing_does_not():
    """Points 0 and 1 both like target 0 best, in the company of (2, 2)."""
    edges = np.array([[0, 8], [1, 8], [3, 8], [4, 8]])  # (0, 0), (0, 1), (1, 0), (1, 1), each with (2, 2)
    tensor = AffinityTensor(edges, [1.0, 0.2, 0.9, 0.3], (3, 3))
    rows, both = (PowerIteration("l1", normalise=way)(tensor).soft for way in ("rows", "both"))
    np.testing.assert_allclose(rows[:2, 0], 1.0, rtol=1e-6)
    assert both[:, 0].sum() == pytest.approx(1.0)


def test_the_preset_of_the_paper_has_its_rows_and_the_balanced_solver_a_name():
    scene = p3p_scene(noise=0.5, seed=3)
    found = {
        name: rm.match(scene.source, scene.target, scene.problem, preset="paper", samples=20_000, seed=3, solver=name)
        for name in (None, "power-l1", "power-l1-balanced")
    }
    tensor = found[None].tensor
    np.testing.assert_array_equal(found[None].soft_assignment, found["power-l1"].soft_assignment)
    np.testing.assert_array_equal(found[None].soft_assignment, PowerIteration("l1", normalise="rows")(tensor).soft)
    np.testing.assert_allclose(found["power-l1-balanced"].soft_assignment.sum(axis=0), 1.0, rtol=1e-12)
    assert np.abs(found[None].soft_assignment.sum(axis=0) - 1.0).max() > 0.5


@pytest.mark.parametrize("name", ["power-l1", "power-l1-balanced", "power-dense"])
@pytest.mark.parametrize(("n", "n_target", "order"), [(8, 8, 3), (7, 9, 3), (9, 7, 3), (7, 8, 4), (8, 8, 2)])
def test_planted_assignment_is_found(name, n, n_target, order):
    indices, weights, truth = planted(5, n, n_target, order, 60 if order == 2 else 500)
    solution = get_solver(name)(AffinityTensor(indices, weights, (n, n_target)))
    np.testing.assert_array_equal(solution.assignment[truth >= 0], truth[truth >= 0])
    assert solution.converged
    assert solution.status == "converged"


def test_sparse_iteration_ends_close_to_boolean_and_dense_does_not():
    indices, weights, _ = planted(6, 8, 10, 3, 400)
    tensor = AffinityTensor(indices, weights, (8, 10))
    sparse, dense = PowerIteration("l1")(tensor).soft, PowerIteration("l2")(tensor).soft
    assert np.all(sparse.max(axis=1) > 0.999)
    np.testing.assert_allclose(sparse.sum(axis=1), 1, rtol=1e-12)
    assert np.linalg.norm(dense) == pytest.approx(1)
    assert np.all(dense.max(axis=1) < 0.99)


def test_scale_of_weights_matters_with_a_bias_only():
    indices, weights, _ = planted(7, 6, 8, 3, 400)
    small, large = (AffinityTensor(indices, weights * s, (6, 8)) for s in (1e-90, 1e90))
    options = {"iterations": 3}
    for kind in ("l1", "l2"):
        a, b = (PowerIteration(kind, **options)(t).soft for t in (small, large))
        np.testing.assert_allclose(a, b, rtol=1e-9)
        a, b = (PowerIteration(kind, bias=0.1, **options)(t).soft for t in (small, large))
        assert np.abs(a - b).max() > 1e-3


def test_dead_rows_stay_finite_and_unmatched():
    indices, weights, truth = planted(8, 6, 7, 3, 0, hidden=1)
    tensor = AffinityTensor(indices, weights, (6, 7))
    for name in ("power-l1", "power-l1-balanced", "power-dense"):
        solution = get_solver(name)(tensor)
        assert np.isfinite(solution.soft).all()
        np.testing.assert_array_equal(solution.assignment, truth)
        assert solution.statistics["dead_rows"] == 1


@pytest.mark.parametrize("name", ["power-l1", "power-l1-balanced", "power-dense"])
def test_nothing_to_solve(name):
    for tensor in (
        AffinityTensor(np.zeros((0, 3), np.int32), [], (4, 5)),
        AffinityTensor([[0, 6, 12]], [0.0], (4, 5)),
    ):
        solution = get_solver(name)(tensor)
        np.testing.assert_array_equal(solution.assignment, [-1] * 4)
        assert solution.score == 0
        assert solution.alternatives == []
        assert solution.status.startswith("empty")


def test_unary_weights_alone_are_solved_too():
    unary = np.array([[1.0, 2.0], [1.5, 1.0]])
    tensor = AffinityTensor(np.zeros((0, 2), np.int32), [], (2, 2), unary)
    assert get_solver("power-dense")(tensor).assignment.tolist() == [1, 0]


def test_stopping_at_the_limit_is_said():
    indices, weights, _ = planted(9, 6, 8, 3, 400)
    solution = PowerIteration("l2", iterations=2)(AffinityTensor(indices, weights, (6, 8)))
    assert not solution.converged
    assert solution.iterations == 2
    assert "raise" in solution.status


def test_neighbours_are_the_best_single_changes():
    indices, weights, truth = planted(10, 4, 5, 3, 200)
    tensor = AffinityTensor(indices, weights, (4, 5))
    start = truth.copy()
    start[2] = -1
    expected = {}
    free = sorted(set(range(5)) - set(start))
    for i in (0, 1, 3):
        for k in free:
            changed = start.copy()
            changed[i] = k
            expected[tuple(changed)] = tensor.score(changed)
        for j in range(4):
            changed = start.copy()
            changed[i], changed[j] = changed[j], changed[i]
            if j != i:
                expected[tuple(changed)] = tensor.score(changed)
    found = best_neighbours(tensor, start, 100)
    assert {tuple(a): s for a, s in found} == pytest.approx(expected)
    np.testing.assert_allclose([s for _, s in found], sorted(expected.values(), reverse=True), rtol=1e-12, atol=1e-14)
    assert len(best_neighbours(tensor, start, 3)) == 3


def test_options_and_names_are_judged():
    for options in ({"bias": -1}, {"iterations": 0}, {"tolerance": float("nan")}):
        with pytest.raises(InputError, match="expected"):
            PowerIteration(**options)
    with pytest.raises(InputError, match="norm: got 'l3'"):
        PowerIteration("l3")
    with pytest.raises(InputError, match="normalise: got 'columns'; expected 'rows', 'both' or 'smaller'"):
        PowerIteration(normalise="columns")
    for bad in ("powr", 3, PowerIteration):
        with pytest.raises(InputError, match="solver"):
            get_solver(bad)
    own = PowerIteration("l2")
    assert get_solver(own) is own


@pytest.mark.parametrize("name", SOLVERS)
def test_an_array_is_no_tensor(name):
    with pytest.raises(InputError, match=r"tensor: ndarray given; give an AffinityTensor"):
        get_solver(name)(np.ones((4, 4)))
