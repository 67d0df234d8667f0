import math
import warnings

import numba
import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st

from rootmatch.errors import InputError, InputWarning
from rootmatch.hypergraph.tensor import AffinityTensor
from solver_oracles import (
    dense_contraction,
    dense_tensor,
    naive_score,
    naive_support,
    random_edges,
)

SHAPES = [(2, 4, 4), (3, 4, 5), (4, 5, 4), (5, 5, 5)]


def instance(order, n, n_target, count, seed=0, unary=False):
    rng = np.random.default_rng(seed)
    indices = random_edges(rng, n, n_target, order, count)
    prior = rng.random((n, n_target)) if unary else None
    return AffinityTensor(indices, rng.random(count), (n, n_target), prior), rng


@pytest.mark.parametrize(("order", "n", "n_target"), SHAPES)
@pytest.mark.parametrize("count", [0, 1, 2, 37])
def test_contraction_is_that_of_the_full_tensor(order, n, n_target, count):
    tensor, rng = instance(order, n, n_target, count, seed=order)
    x = rng.random((n, n_target))
    dense = dense_tensor(tensor.indices, tensor.weights, n * n_target)
    np.testing.assert_allclose(tensor.contract(x), dense_contraction(dense, x), rtol=1e-12)
    np.testing.assert_allclose(tensor.marginals(), dense_contraction(dense, np.ones_like(x)), rtol=1e-12)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_contraction_by_several_chunks_and_threads(order):
    tensor, rng = instance(order, 6, 7, 80_001, seed=1)
    x = rng.random((6, 7))
    flat = x.ravel()[tensor.indices]
    expected = np.zeros(42)
    for p in range(order):
        others = np.delete(flat, p, axis=1).prod(axis=1)
        np.add.at(expected, tensor.indices[:, p], tensor.weights * others)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = tensor.contract(x)
        numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
        np.testing.assert_array_equal(one, tensor.contract(x))
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_allclose(one.ravel(), expected, rtol=1e-11)


def test_contraction_at_zeros_has_no_division():
    tensor, _ = instance(5, 6, 6, 50)
    x = np.zeros((6, 6))
    x[np.arange(5), np.arange(5)] = 1
    dense_edges = np.isin(tensor.indices, np.flatnonzero(x)).sum(axis=1)
    expected = np.zeros(36)
    for edge, inside, h in zip(tensor.indices, dense_edges, tensor.weights, strict=True):
        for a in edge:
            if inside - x.ravel()[a] == 4:
                expected[a] += h
    np.testing.assert_allclose(tensor.contract(x).ravel(), expected, atol=1e-15)


@pytest.mark.parametrize(("order", "n", "n_target"), SHAPES)
def test_score_counts_the_hyperedges_inside(order, n, n_target):
    tensor, rng = instance(order, n, n_target, 400, seed=3, unary=True)
    m = min(n, n_target)
    for matched in range(order - 1, m + 1):
        assignment = np.full(n, -1)
        assignment[rng.permutation(n)[:matched]] = rng.permutation(n_target)[:matched]
        expected = naive_score(tensor.indices, tensor.weights, assignment, n_target)
        expected += sum(tensor.unary[i, k] for i, k in enumerate(assignment) if k >= 0)
        assert tensor.score(assignment) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("unary", [False, True])
def test_part_inside_an_assignment(unary):
    tensor, _ = instance(3, 7, 8, 300_000, seed=4, unary=unary)
    assignment = np.array([4, -1, 0, 7, 2, 1, 3])
    chosen = {i * 8 + k for i, k in enumerate(assignment) if k >= 0}
    part = tensor.inside(assignment)
    expected = np.flatnonzero(np.isin(tensor.indices, list(chosen)).all(axis=1))
    assert len(expected) > 256
    np.testing.assert_array_equal(part.indices, tensor.indices[expected])
    assert part.score(assignment) == pytest.approx(tensor.score(assignment), rel=1e-12)


def test_gradient_at_an_assignment_sums_to_the_score():
    tensor, rng = instance(4, 6, 7, 5000, seed=5)
    assignment = rng.permutation(7)[:6]
    x = np.zeros(tensor.shape)
    x[np.arange(6), assignment] = 1
    assert (tensor.contract(x) * x).sum() == pytest.approx(4 * tensor.score(assignment), rel=1e-12)


def test_unary_weights_enter_contraction_and_score_but_not_marginals():
    tensor, rng = instance(3, 4, 5, 30, unary=True)
    plain = AffinityTensor(tensor.indices, tensor.weights, tensor.shape)
    x = rng.random((4, 5))
    np.testing.assert_allclose(tensor.contract(x), plain.contract(x) + tensor.unary)
    np.testing.assert_allclose(tensor.marginals(), plain.marginals())
    assert tensor.score([0, 1, -1, 4]) == pytest.approx(
        plain.score([0, 1, -1, 4]) + tensor.unary[0, 0] + tensor.unary[1, 1] + tensor.unary[3, 4]
    )


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_support_is_the_weight_of_the_neighbours(order):
    tensor, _ = instance(order, 5, 5, 200, seed=6)
    np.testing.assert_allclose(tensor.support(), naive_support(tensor.indices, tensor.weights), atol=1e-12)


def test_support_when_subsets_do_not_fit_one_integer():
    rng = np.random.default_rng(0)
    small = random_edges(rng, 5, 5, 4, 120)
    # The same hyper-edges inside a huge grid: 4e9^(d-1) is far above 2^63.
    i, k = np.divmod(small, 5)
    large = (i * 40_000 + k).astype(np.int32)
    h = rng.random(120)
    a, b = AffinityTensor(small, h, (5, 5)), AffinityTensor(large, h, (40_000, 40_000))
    np.testing.assert_allclose(a.support(), b.support(), atol=1e-12)


def test_merged_keeps_one_of_each_set():
    indices = [[0, 4], [4, 0], [0, 5], [4, 0], [1, 3]]
    tensor = AffinityTensor(indices, [0.5, 0.25, 1.0, 0.5, 2.0], (2, 3))
    merged = tensor.merged()
    np.testing.assert_array_equal(merged.indices, [[0, 4], [0, 5], [1, 3]])
    np.testing.assert_array_equal(merged.weights, [0.5, 1.0, 2.0])
    np.testing.assert_array_equal(tensor.merged("sum").weights, [1.25, 1.0, 2.0])
    with pytest.raises(InputError, match="how"):
        tensor.merged("mean")


@given(seed=st.integers(0, 2**32 - 1), order=st.integers(2, 4), count=st.integers(0, 60))
@settings(max_examples=40, deadline=None)
def test_merging_the_shuffled_copy_of_a_tensor_gives_the_tensor(seed, order, count):
    tensor, rng = instance(order, 4, 4, count, seed)
    tensor = tensor.merged()
    twice = np.concatenate([tensor.indices, rng.permuted(tensor.indices, axis=1)])
    again = AffinityTensor(twice, np.tile(tensor.weights, 2), tensor.shape).merged()
    np.testing.assert_array_equal(again.indices, tensor.indices)
    np.testing.assert_array_equal(again.weights, tensor.weights)


@pytest.mark.parametrize(
    ("indices", "weights", "words"),
    [
        ([[0, 4], [0, 1]], [1, 1], "hyper-edge 1.*source"),
        ([[0, 4], [0, 3]], [1, 1], "hyper-edge 1.*target"),
        ([[4, 4]], [1], "hyper-edge 0.*source"),
        ([[0, 9]], [1], "0 … 8"),
        ([[-1, 4]], [1], "0 … 8"),
        ([[0, 2**32 + 4]], [1], "0 … 8"),
        ([[0, 4]], [-1], "hyper-edge 0.*weight"),
        ([[0, 4]], [math.nan], "hyper-edge 0.*weight"),
        ([[0, 4]], [math.inf], "hyper-edge 0.*weight"),
        ([[0, 4]], [1, 2], r"expected \(1,\)"),
        ([[0], [4]], [1, 2], "order"),
        ([0, 4], [1, 2], "order"),
        ([[0.0, 4.0]], [1], "integers"),
        ([[0, 4]], ["x"], "numbers"),
    ],
)
def test_bad_hyperedges_are_named(indices, weights, words):
    with pytest.raises(InputError, match=words):
        AffinityTensor(indices, weights, (3, 3))


def test_the_first_of_many_faults_is_named():
    rng = np.random.default_rng(0)
    indices = random_edges(rng, 6, 6, 3, 200_000)
    weights = rng.random(200_000)
    weights[[150_000, 123_456, 190_000]] = np.nan
    with pytest.raises(InputError, match="hyper-edge 123456,"):
        AffinityTensor(indices, weights, (6, 6))


@pytest.mark.parametrize("shape", [(0, 3), (3,), "ab", (1 << 16, 1 << 16), None])
def test_bad_shapes(shape):
    with pytest.raises(InputError, match="shape"):
        AffinityTensor([[0, 4]], [1.0], shape)


def test_bad_unary_and_arguments():
    with pytest.raises(InputError, match="unary"):
        AffinityTensor([[0, 4]], [1.0], (3, 3), np.ones((3, 2)))
    with pytest.raises(InputError, match="unary"):
        AffinityTensor([[0, 4]], [1.0], (3, 3), -np.ones((3, 3)))
    tensor = AffinityTensor([[0, 4]], [1.0], (3, 3))
    with pytest.raises(InputError, match="x:"):
        tensor.contract(np.ones(9))
    for bad in ([0, 1], [0, 0, 1], [0, 1, 3], [0, 1, -2], [0.0, 1.0, 2.0]):
        with pytest.raises(InputError, match="assignment"):
            tensor.score(bad)


def test_tensor_does_not_change_and_does_not_follow_integers_of_another_type():
    tensor = AffinityTensor(np.array([[0, 4]], np.int64), np.array([1], np.float32), (3, 3))
    assert (tensor.indices.dtype, tensor.weights.dtype) == (np.int32, np.float64)
    with pytest.raises(AttributeError):
        tensor.shape = (2, 2)
    assert repr(tensor) == "AffinityTensor(1 hyper-edges of order 2, 3 × 3)"


@pytest.mark.parametrize("layout", ["row", "column"])
@pytest.mark.parametrize(("order", "n", "n_target"), SHAPES[:3])
def test_dense_and_back(order, n, n_target, layout):
    tensor, _ = instance(order, n, n_target, 25, seed=8)
    tensor = tensor.merged()
    dense = tensor.to_dense(layout=layout)
    if layout == "row":
        np.testing.assert_array_equal(dense, dense_tensor(tensor.indices, tensor.weights, n * n_target))
    else:
        grid = np.arange(n * n_target).reshape(n, n_target)
        other = np.empty(n * n_target, np.int64)
        for i in range(n):
            for k in range(n_target):
                other[grid[i, k]] = k * n + i
        np.testing.assert_array_equal(dense, dense_tensor(other[tensor.indices], tensor.weights, n * n_target))
    back = AffinityTensor.from_dense(dense, (n, n_target), layout=layout)
    np.testing.assert_array_equal(back.indices, tensor.indices)
    np.testing.assert_array_equal(back.weights, tensor.weights)


def test_dense_is_refused_when_too_large():
    tensor, _ = instance(4, 20, 20, 10)
    with pytest.raises(InputError, match=r"400\^4 entries takes 2.05e\+11 bytes"):
        tensor.to_dense()


def test_dense_must_be_symmetric_and_square():
    dense = np.zeros((9, 9))
    dense[0, 4] = 1
    with pytest.raises(InputError, match="not symmetric"):
        AffinityTensor.from_dense(dense, (3, 3))
    with pytest.raises(InputError, match="along each"):
        AffinityTensor.from_dense(np.zeros((9, 8)), (3, 3))
    dense[4, 0] = dense[0, 4] = np.nan
    with pytest.raises(InputError, match="NaN or infinity in 2 entries"):
        AffinityTensor.from_dense(dense, (3, 3))


def test_coordinates_once_or_in_all_orders():
    tensor, _ = instance(3, 4, 4, 20, seed=9)
    tensor = tensor.merged()
    full = AffinityTensor.from_coo(*tensor.to_coo(), tensor.shape, layout="row")
    once = AffinityTensor.from_coo(*tensor.to_coo(symmetric=False), tensor.shape, layout="row")
    assert tensor.to_coo()[1].size == 6 * tensor.size
    for other in (full, once):
        np.testing.assert_array_equal(other.indices, tensor.indices)
        np.testing.assert_array_equal(other.weights, tensor.weights)
    with pytest.raises(InputError, match="differs"):
        AffinityTensor.from_coo([[0, 5], [5, 0]], [1.0, 2.0], (4, 4))
    with pytest.raises(InputError, match="values"):
        AffinityTensor.from_coo([[0, 5], [5, 0]], [1.0], (4, 4))
    with pytest.raises(InputError, match="0 … 15"):
        AffinityTensor.from_coo([[0], [16]], [1.0], (4, 4))
    with pytest.raises(InputError, match="coordinates: got float64; expected integers"):
        AffinityTensor.from_coo([[0.0], [5.9]], [1.0], (4, 4))


def test_conflicting_entries_are_refused_or_dropped():
    entries = ([[0, 0, 0], [1, 3, 5]], [1.0, 2.0, 3.0], (3, 3))
    with pytest.raises(InputError, match="share"):
        AffinityTensor.from_coo(*entries, layout="row")
    with pytest.warns(InputWarning, match="the entries fit neither"):
        kept = AffinityTensor.from_coo(*entries, conflicts="drop")
    np.testing.assert_array_equal(kept.indices, [[0, 5]])


def test_complex_weights_are_refused():
    with pytest.raises(InputError, match="weights: expected an array of real numbers"):
        AffinityTensor([[0, 4]], [1.0 + 1.0j], (3, 3))


@pytest.mark.parametrize("layout", ["row", "column"])
def test_scipy_matrix_of_order_two_with_unary_diagonal(layout):
    tensor, _ = instance(2, 4, 3, 20, seed=10, unary=True)
    tensor = tensor.merged()
    matrix = tensor.to_scipy(layout=layout)
    assert scipy.sparse.issparse(matrix)
    back = AffinityTensor.from_scipy(matrix, (4, 3), layout=layout)
    np.testing.assert_array_equal(back.indices, tensor.indices)
    np.testing.assert_array_equal(back.weights, tensor.weights)
    np.testing.assert_array_equal(back.unary, tensor.unary)
    # The quadratic form counts each pair twice and each single once.
    assignment = np.array([2, 0, -1, 1])
    x = np.zeros((4, 3))
    x[[0, 1, 3], [2, 0, 1]] = 1
    flat = x.ravel() if layout == "row" else x.T.ravel()
    single = tensor.unary[x > 0].sum()
    assert (flat @ matrix @ flat + single) / 2 == pytest.approx(tensor.score(assignment), rel=1e-12)
    with pytest.raises(InputError, match="order 2"):
        instance(3, 4, 4, 5)[0].to_scipy()


def test_another_layout_is_not_taken_for_this_one_silently():
    wide, _ = instance(2, 3, 5, 30, seed=11)
    dense = wide.merged().to_dense(layout="column")
    for conflicts in ("error", "drop"):
        with pytest.raises(InputError, match=r"fit layout=.column.* as in pygmtools"):
            AffinityTensor.from_dense(dense, (3, 5), conflicts=conflicts)
    square, _ = instance(2, 4, 4, 30, seed=12)
    matrix = square.merged().to_scipy()
    made = (
        lambda: AffinityTensor.from_scipy(matrix, (4, 4)),
        lambda: AffinityTensor.from_dense(matrix.toarray(), (4, 4)),
        lambda: AffinityTensor.from_coo(matrix.tocoo().coords, matrix.tocoo().data, (4, 4)),
    )
    for make in made:
        with pytest.warns(UserWarning, match="pygmtools and MATLAB") as told:
            make()
        assert [one.filename for one in told] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = AffinityTensor.from_scipy(matrix, (4, 4), layout="row")
        AffinityTensor.from_coo([[0, 5], [5, 0]], [1.0, 1.0], (4, 4))  # the same in both
    np.testing.assert_array_equal(back.indices, square.merged().indices)
    with pytest.raises(InputError, match="layout: 'F' given"):
        AffinityTensor.from_scipy(matrix, (4, 4), layout="F")


def test_memory_of_a_hyperedge():
    tensor, _ = instance(4, 10, 10, 1000)
    assert (tensor.indices.nbytes + tensor.weights.nbytes) / tensor.size <= 40
