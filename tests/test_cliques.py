"""Cliques of hyper-edges against trying all sets."""

from itertools import combinations

import numpy as np
import pytest

from rootmatch.solvers.packing.fitted_groups import cliques


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("seed", range(6))
def test_cliques_are_those_of_trying_all_sets(order: int, seed: int) -> None:
    rng = np.random.default_rng([order, seed])
    n = n_target = 4 + order // 4
    pairs = [(i, k) for i in range(n) for k in range(n_target)]
    one_to_one = [
        edge
        for edge in combinations(range(len(pairs)), order)
        if len({pairs[a][0] for a in edge}) == order == len({pairs[a][1] for a in edge})
    ]
    kept = [edge for edge in one_to_one if rng.random() < (0.5 if order == 2 else 0.75)]
    known = set(kept)
    wanted = [
        chosen
        for chosen in combinations(range(len(pairs)), order + 1)
        if all(part in known for part in combinations(chosen, order))
    ]
    # in any order, within a hyper-edge and among them, and some of them twice
    given = np.array([rng.permutation(edge) for edge in kept + kept[:5]], np.int32)
    found = cliques(rng.permutation(given), (n, n_target), 10_000_000)
    assert found is not None
    assert len(wanted) > 0
    np.testing.assert_array_equal(found, np.array(wanted))


def test_too_many_cliques_are_not_listed() -> None:
    complete = np.array([[i * 12 + i for i in edge] for edge in combinations(range(12), 3)], np.int32)
    assert cliques(complete, (12, 12), 400) is None
    found = cliques(complete, (12, 12), 495)
    assert found is not None
    assert len(found) == 495


def test_no_hyperedges_have_no_cliques() -> None:
    found = cliques(np.empty((0, 3), np.int32), (4, 4), 10)
    assert found is not None
    assert found.shape == (0, 4)
