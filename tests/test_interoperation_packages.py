"""The conversions of docs/howto/graph-matching.md, tried with the packages that they are for."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.solvers import get_solver

N = 12


@pytest.fixture(scope="module")
def pair_graph() -> tuple[rm.AffinityTensor, np.ndarray]:
    """Triangles of a point set and its shuffled copy as a graph of pairs, and the truth."""
    rng = np.random.default_rng(5)
    source = rng.normal(size=(N, 2))
    order = rng.permutation(N)
    target = (1.5 * source + 0.005 * rng.normal(size=(N, 2)))[order]
    indices, weights, shape = rm.invariant_affinities(source, target, "signed-angles")
    coordinates, values = rm.AffinityTensor(indices, weights, shape).to_coo(symmetric=False)
    pairs = np.concatenate([coordinates[[a, b]] for a, b in ((0, 1), (0, 2), (1, 2))], axis=1)
    return rm.AffinityTensor(pairs.T, np.tile(values, 3), shape).merged("sum"), np.argsort(order)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # its ipfp divides by 0 once it has settled
@pytest.mark.parametrize("solver", ["rrwm", "sm", "ipfp"])
def test_pygmtools_takes_the_exported_affinity(solver: str, pair_graph: tuple[rm.AffinityTensor, np.ndarray]) -> None:
    pygmtools = pytest.importorskip("pygmtools", exc_type=ImportError)
    pygmtools.set_backend("numpy")
    graph, truth = pair_graph
    K = graph.to_dense(layout="column")
    soft = getattr(pygmtools, solver)(K[None], n1=[N], n2=[N])
    found = pygmtools.hungarian(soft)[0]
    np.testing.assert_array_equal(found.argmax(axis=1), truth)
    score = float(pygmtools.utils.compute_affinity_score(found[None], K[None])[0])
    # it counts each pair in both orders
    assert score == pytest.approx(2.0 * graph.score(truth), rel=1e-6)


def test_an_affinity_of_pygmtools_comes_back_bit_for_bit() -> None:
    pygmtools = pytest.importorskip("pygmtools", exc_type=ImportError)
    pygmtools.set_backend("numpy")
    rng = np.random.default_rng(1)
    weights = np.triu(rng.uniform(0.5, 1.5, (N, N)), 1)
    first, order = weights + weights.T, rng.permutation(N)
    second = first[np.ix_(order, order)]
    connected, edges, counts = zip(
        *(pygmtools.utils.dense_to_sparse(graph[None]) for graph in (first, second)), strict=True
    )
    K = pygmtools.utils.build_aff_mat(
        None, edges[0], connected[0], None, edges[1], connected[1], np.array([N]), counts[0], np.array([N]), counts[1],
        edge_aff_fn=lambda a, b: np.exp(-((a - b.transpose(0, 2, 1)) ** 2) / 0.1),
    )[0]  # fmt: skip
    tensor = rm.AffinityTensor.from_dense(K, (N, N), layout="column", conflicts="drop")
    np.testing.assert_array_equal(tensor.to_dense(layout="column"), K)
    np.testing.assert_array_equal(get_solver("ascent")(tensor, seed=0).assignment, np.argsort(order))


def test_networkx_reads_the_association_graph(pair_graph: tuple[rm.AffinityTensor, np.ndarray]) -> None:
    networkx = pytest.importorskip("networkx")
    graph, truth = pair_graph
    association = networkx.from_scipy_sparse_array(graph.to_scipy())
    assert association.number_of_edges() == graph.size
    right = [i * N + int(k) for i, k in enumerate(truth)]
    total = sum(data["weight"] for _, _, data in association.subgraph(right).edges(data=True))
    assert total == pytest.approx(graph.score(truth))
    matrix = networkx.to_scipy_sparse_array(association, nodelist=range(N * N))
    again = rm.AffinityTensor.from_scipy(matrix, (N, N), layout="row")
    assert again.size == graph.size
    np.testing.assert_array_equal(get_solver("ascent")(again, seed=0).assignment, truth)
