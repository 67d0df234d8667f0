"""Import a matching problem from another library, and export one to another.

Only NumPy and SciPy are needed; comments name the calls of networkx and pygmtools that produce or accept these arrays.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.linalg import eigsh

import rootmatch as rm
from rootmatch.solvers import get_solver


def two_graphs(n, seed):
    """A weighted graph, a copy with perturbed weights and shuffled nodes, and the true assignment."""
    rng = np.random.default_rng(seed)
    weights = np.triu(rng.uniform(0.5, 1.5, (n, n)) * (rng.random((n, n)) < 0.5), 1)
    first = weights + weights.T
    noise = np.triu(rng.normal(0.0, 0.03, (n, n)), 1)
    order = rng.permutation(n)
    second = np.where(first > 0.0, first + noise + noise.T, 0.0)[np.ix_(order, order)]
    # networkx.to_scipy_sparse_array(graph) gives such matrices
    return csr_array(first), csr_array(second), np.argsort(order)


def dense_affinity(first, second):
    """K (n n', n n') as pygmtools.utils.build_aff_mat makes it: pair (i, k) has the index k n + i, column by column."""
    a, b = first.toarray(), second.toarray()
    n, n_target = len(a), len(b)
    similarity = np.exp(-((a[:, :, None, None] - b[None, None]) ** 2) / 0.1)  # i, j, k, l
    similarity *= (a > 0.0)[:, :, None, None] & (b > 0.0)[None, None]
    return similarity.transpose(2, 0, 3, 1).reshape(n * n_target, n * n_target)


def import_dense():
    """Import a dense K of order 2 as a tensor and run the discrete ascent on it."""
    first, second, truth = two_graphs(12, seed=1)
    K = dense_affinity(first, second)
    tensor = rm.AffinityTensor.from_dense(K, (12, 12), layout="column", conflicts="drop")
    found = get_solver("ascent")(tensor, seed=0).assignment
    print(f"imported: {tensor.size} edges from {np.count_nonzero(K)} entries, {np.mean(found == truth):.0%} right")

    # exported again: the same matrix, bit for bit
    assert np.array_equal(tensor.to_dense(layout="column"), K)
    soft = get_solver("power-dense")(tensor).soft  # (n, n'): pygmtools.hungarian(soft) takes it
    print(f"a solver's soft assignment, discretised elsewhere: {np.mean(discretised(soft) == truth):.0%} right")


def export_sparse():
    """Export triangles of two point sets as a tensor of order 3, and its pairs as a matrix for a spectral method."""
    rng = np.random.default_rng(2)
    source = rng.normal(size=(10, 2))
    order = rng.permutation(10)
    target = (1.5 * source + 0.01 * rng.normal(size=(10, 2)))[order]
    tensor = rm.AffinityTensor(*rm.invariant_affinities(source, target, "signed-angles"))

    # order 3: coordinates (3, nnz) and values, each hyper-edge in one order only
    coordinates, values = tensor.to_coo(symmetric=False)
    again = rm.AffinityTensor.from_coo(coordinates, values, tensor.shape, layout="row")
    assert again.size == tensor.size

    # order 2: every hyper-edge votes for its three pairs
    pairs = np.concatenate([coordinates[[a, b]] for a, b in ((0, 1), (0, 2), (1, 2))], axis=1)
    graph = rm.AffinityTensor(pairs.T, np.tile(values, 3), tensor.shape).merged("sum")
    matrix = graph.to_scipy()  # networkx.from_scipy_sparse_array(matrix) is the association graph
    _, leading = eigsh(matrix.astype(float), k=1, which="LA")
    found = discretised(np.abs(leading).reshape(graph.shape))
    print(f"exported: {matrix.nnz} entries, {np.mean(found == np.argsort(order)):.0%} right by the leading eigenvector")

    # a dense tensor is built where it fits, and refused where it does not
    try:
        tensor.to_dense(max_bytes=1e6)
    except rm.InputError as refused:
        print(f"refused: {refused}")


def discretised(soft):
    """Assignment of the largest sum, by another library."""
    return linear_sum_assignment(soft, maximize=True)[1]


if __name__ == "__main__":
    import_dense()
    export_sparse()
