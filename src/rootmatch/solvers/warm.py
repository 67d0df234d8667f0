"""The kernels of the default solver, compiled ahead of need: the first time takes seconds, and other work can go on."""

from __future__ import annotations

import numpy as np

from rootmatch.hypergraph.random_tuples import permuted_tuples
from rootmatch.hypergraph.support import drop_unsupported
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.cache import is_compiled
from rootmatch.solvers.ascent import local_search
from rootmatch.solvers.ascent.solver import MultiStartAscent
from rootmatch.solvers.packing import branch_and_bound
from rootmatch.solvers.packing.tabu_search import pack


def is_cold(several: bool = False) -> bool:
    """Whether the largest kernel of the ascent, or of the packing of several motions, is not compiled.

    That is neither in Numba's cache on disk nor by now in this process. Nothing is where NUMBA_DISABLE_JIT is set.
    """
    return not is_compiled(branch_and_bound.search if several else local_search._ascend)


def warm(*orders: int) -> None:
    """Compile, by the solution of a small tensor of each order. The types are the same for every problem and size."""
    rng = np.random.default_rng(0)
    shape, count = (6, 7), 2000
    # tensors of order 3 have a few kernels of their own
    for order in orders or (4, 3):
        sources = permuted_tuples(rng, count, shape[0], order)
        targets = permuted_tuples(rng, count, shape[1], order)
        indices = (sources * shape[1] + targets).astype(np.int32)
        tensor = AffinityTensor.unchecked(indices, rng.random(count), shape)
        answer = MultiStartAscent()(tensor).assignment
        drop_unsupported(tensor, answer[None], 0.1)


def warm_packing() -> None:
    """Compile the selection among groups of several motions, by two groups."""
    elements, values, price = np.arange(4).reshape(2, 2), np.ones(2), np.ones(4)
    pack(elements, values, len(price), 2, np.zeros(2, np.bool_), 1)
    branch_and_bound.search(elements, values, price, 1.0, 2, 1.0, 1)
