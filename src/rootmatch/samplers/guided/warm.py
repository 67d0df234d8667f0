"""Kernels of the search that come after its largest, compiled ahead of need: see `rootmatch.solvers.warm`."""

from __future__ import annotations

import numpy as np

from rootmatch.samplers.guided.hypothesis_clustering import candidate_hyperedges, cluster, membership


def warm() -> None:
    """Compile them, by one hypothesis. The types are the same for every problem and size."""
    best, candidates = np.zeros((1, 1), np.int64), np.full((1, 1, 1), -1)
    _, lists = cluster(np.zeros(1), best, candidates, 1)
    subsets, counts = np.zeros((1, 1), np.int64), np.zeros(1, np.int64)
    candidate_hyperedges(lists, membership(lists, 1), subsets, best, best.copy(), counts)
