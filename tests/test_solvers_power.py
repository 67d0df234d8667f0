import numpy as np
import pytest

from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers import PowerIteration, get_solver
from rootmatch.solvers.base import neighbours
from solver_oracles import dense_contraction, dense_tensor, planted, random_edges


def naive_power(dense, shape, sparse, bias, steps):
    n, n_target = shape
    x = np.ones(shape)

    def lines(y):
        for axis in [1, 0] if n == n_target else [1] if n < n_target else [0]:
            y = y / np.sqrt((y**2).sum(axis=axis, keepdims=True))
        return y

    if not sparse:
        x = start = x / np.sqrt((x**2).sum())
        for _ in range(steps):
            x = dense_contraction(dense, x) + bias * start
            x = x / np.sqrt((x**2).sum())
        return x
    y = start = lines(x)
    for _ in range(steps):
        y = lines(y * dense_contraction(dense, y**2) + bias * start)
    return y**2


@pytest.mark.parametrize("normalisation", ["l1", "l2"])
@pytest.mark.parametrize("bias", [0.0, 0.5])
@pytest.mark.parametrize(("order", "n", "n_target"), [(2, 4, 4), (3, 4, 5), (4, 5, 4)])
def test_iterates_are_those_of_the_equations(normalisation, bias, order, n, n_target):
    rng = np.random.default_rng(order)
    indices = random_edges(rng, n, n_target, order, 300)
    tensor = AffinityTensor(indices, rng.random(300), (n, n_target))
    dense = dense_tensor(indices, tensor.weights, n * n_target)
    for steps in (1, 4):
        soft = PowerIteration(normalisation, bias=bias, iterations=steps)(tensor).soft
        expected = naive_power(dense, (n, n_target), normalisation == "l1", bias, steps)
        np.testing.assert_allclose(soft, expected, rtol=1e-10)


@pytest.mark.parametrize("name", ["power-l1", "power-dense"])
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
    for name in ("power-l1", "power-dense"):
        solution = get_solver(name)(tensor)
        assert np.isfinite(solution.soft).all()
        np.testing.assert_array_equal(solution.assignment, truth)
        assert solution.statistics["dead_rows"] == 1


@pytest.mark.parametrize("name", ["power-l1", "power-dense"])
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
    found = neighbours(tensor, start, 100)
    assert {tuple(a): s for a, s in found} == pytest.approx(expected)
    np.testing.assert_allclose([s for _, s in found], sorted(expected.values(), reverse=True), rtol=1e-12, atol=1e-14)
    assert len(neighbours(tensor, start, 3)) == 3


def test_options_and_names_are_judged():
    for options in ({"normalisation": "l3"}, {"bias": -1}, {"iterations": 0}, {"tolerance": float("nan")}):
        with pytest.raises(InputError):
            PowerIteration(**options)
    for bad in ("powr", 3, PowerIteration):
        with pytest.raises(InputError, match="solver"):
            get_solver(bad)
    own = PowerIteration("l2")
    assert get_solver(own) is own
