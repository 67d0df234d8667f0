import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rootmatch.errors import InputError
from rootmatch.hypergraph.assignment import (
    CLEAR,
    INVALID,
    UNCLEAR,
    are_targets_disjoint,
    assign_clear,
    discretise,
    margin,
)


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
    minimum = min(shape)
    for _ in range(20):
        soft = rng.random(shape)
        rows, columns = rng.permutation(shape[0])[:minimum], rng.permutation(shape[1])[:minimum]
        soft[rows, columns] += 1.0
        expected = np.full(shape[0], -1)
        expected[rows] = columns
        np.testing.assert_array_equal(discretise(soft), expected)
        # Liked twice by two lines: the total decides, not the order.
        if minimum > 1:
            soft[rows[0], columns[1]] = 3.0
            np.testing.assert_array_equal(discretise(soft), expected_by_scipy(soft))


def expected_by_scipy(soft):
    from scipy.optimize import linear_sum_assignment

    assignment = np.full(soft.shape[0], -1)
    rows, columns = linear_sum_assignment(soft, maximize=True)
    assignment[rows] = columns
    return assignment


def test_what_is_clear_and_what_is_not():
    def verdict(soft):
        value = np.array(soft, float)
        return assign_clear(value, np.empty(len(value), np.int64), np.zeros(max(value.shape), np.bool_))

    assert verdict([[1.0, 2.0], [3.0, 1.0]]) == CLEAR
    assert verdict([[1.0, 2.0], [1.0, 3.0]]) == UNCLEAR  # both like the second
    assert verdict([[2.0, 2.0, 1.0]]) == UNCLEAR  # a tie
    assert verdict([[2.0], [2.0]]) == UNCLEAR
    assert verdict([[0.0, 0.0]]) == UNCLEAR
    assert verdict([[1.0, -1e-300], [0.0, 2.0]]) == INVALID
    assert verdict([[1.0, np.inf]]) == verdict([[np.nan, 1.0]]) == INVALID


@given(st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_assignments_apart_share_no_target(seed):
    rng = np.random.default_rng(seed)
    every, other = rng.integers(-1, 6, (4, 3)), rng.integers(-1, 6, 3)
    expected = [not (set(one[one >= 0]) & set(other[other >= 0])) for one in every]
    assert are_targets_disjoint(every, other).tolist() == expected
