import itertools

import numpy as np
import pytest

from rootmatch.errors import InputError
from rootmatch.hypergraph.assignment import discretise, drop_unsupported, gains, margin
from rootmatch.hypergraph.tensor import AffinityTensor
from solver_oracles import planted


@pytest.mark.parametrize(("n", "n_target"), [(4, 4), (3, 5), (5, 3), (1, 4)])
def test_discretise_has_the_largest_total(n, n_target):
    soft = np.random.default_rng(n).random((n, n_target)) + 0.01
    assignment = discretise(soft)
    matched = assignment[assignment >= 0]
    assert len(set(matched)) == len(matched) == min(n, n_target)
    rows = itertools.permutations(range(n), min(n, n_target))
    best = max(
        sum(soft[i, k] for i, k in zip(r, c, strict=True))
        for r in rows
        for c in itertools.combinations(range(n_target), len(r))
    )
    found = sum(soft[i, k] for i, k in enumerate(assignment) if k >= 0)
    assert found == pytest.approx(best, rel=1e-12)


def test_discretise_leaves_out_what_has_no_evidence():
    np.testing.assert_array_equal(discretise(np.zeros((2, 3))), [-1, -1])
    np.testing.assert_array_equal(discretise([[0, 0.5, 0], [0, 0, 0]]), [1, -1])
    assert discretise(np.zeros((0, 3))).shape == (0,)
    np.testing.assert_array_equal(discretise([[1e308, 1e-300], [1e308, 1e308]]), [0, 1])


@pytest.mark.parametrize("bad", [[[np.nan]], [[np.inf]], [[-1.0]], [1.0]])
def test_discretise_refuses(bad):
    with pytest.raises(InputError, match="soft"):
        discretise(bad)


def test_gains_are_losses_of_score_when_a_point_goes():
    indices, weights, truth = planted(1, 7, 8, 3, 500, hidden=1)
    tensor = AffinityTensor(indices, weights, (7, 8))
    gain = gains(truth, tensor)
    for i in range(7):
        without = truth.copy()
        without[i] = -1
        assert gain[i] == pytest.approx(tensor.score(truth) - tensor.score(without), abs=1e-12)


def test_unsupported_points_are_dropped_and_no_others():
    indices, weights, truth = planted(2, 9, 10, 3, 300, hidden=2)
    tensor = AffinityTensor(indices, weights, (9, 10))
    full = truth.copy()
    free = np.setdiff1d(np.arange(10), truth)
    full[truth < 0] = free[:2]
    np.testing.assert_array_equal(drop_unsupported(full, tensor, 0.2), truth)
    np.testing.assert_array_equal(drop_unsupported(truth, tensor, 0.2), truth)


def test_dropping_goes_on_until_nothing_changes():
    # 0-1-2 hold together; 3 leans on 4 and 4 on 3 alone, more weakly.
    pairs = [[0, 6], [0, 12], [6, 12], [18, 24], [12, 18]]
    tensor = AffinityTensor(pairs, [10.0, 10.0, 10.0, 1.0, 2.5], (5, 5))
    everyone = np.arange(5)
    np.testing.assert_array_equal(drop_unsupported(everyone, tensor, 0.1), [0, 1, 2, 3, -1])
    # With a larger fraction 4 goes first, then 3, which had its help.
    np.testing.assert_array_equal(drop_unsupported(everyone, tensor, 0.15), [0, 1, 2, -1, -1])
    np.testing.assert_array_equal(drop_unsupported([0, 1, -1, 3, -1], tensor, 0.0), [0, 1, -1, -1, -1])
    np.testing.assert_array_equal(drop_unsupported([-1] * 5, tensor), [-1] * 5)
    with pytest.raises(InputError, match="fraction"):
        drop_unsupported(everyone, tensor, 2)
    with pytest.raises(InputError, match="assignment"):
        drop_unsupported([0, 0, 1, 2, 3], tensor)


def test_margin():
    answer = np.array([0, 1, 2])
    others = [(np.array([0, 2, 1]), 6.0), (np.array([0, 1, 3]), 9.0)]
    assert margin(10.0, others) == pytest.approx(0.1)
    assert margin(10.0, []) == 1.0
    assert margin(10.0, [(answer[::-1], 10.0)]) == 0.0
    assert margin(0.0, []) == 0.0
    # Point 2 is not claimed: the alternative that moves only it is no other answer.
    assert margin(10.0, others, np.array([0, 1, -1])) == pytest.approx(0.4)
    assert margin(10.0, [(np.array([0, -1, 2]), 9.0)], answer) == 1.0


@pytest.mark.parametrize("shape", [(5, 5), (4, 7), (7, 4), (1, 3), (3, 1)])
def test_a_clear_case_is_what_the_hungarian_method_says(shape):
    rng = np.random.default_rng(sum(shape))
    least = min(shape)
    for _ in range(20):
        soft = rng.random(shape)
        rows, columns = rng.permutation(shape[0])[:least], rng.permutation(shape[1])[:least]
        soft[rows, columns] += 1.0
        expected = np.full(shape[0], -1)
        expected[rows] = columns
        np.testing.assert_array_equal(discretise(soft), expected)
        # Liked twice by two lines: the total decides, not the order.
        if least > 1:
            soft[rows[0], columns[1]] = 3.0
            np.testing.assert_array_equal(discretise(soft), expected_by_scipy(soft))


def expected_by_scipy(soft):
    from scipy.optimize import linear_sum_assignment

    assignment = np.full(soft.shape[0], -1)
    rows, columns = linear_sum_assignment(soft, maximize=True)
    assignment[rows] = columns
    return assignment
