"""Kernels of the search that come after its largest, compiled ahead of need: see `rootmatch.solvers.warm`."""

from __future__ import annotations

import numpy as np

from rootmatch.samplers.guided import hypothesis_clustering
from rootmatch.samplers.guided.search import ALIKE, WEAK
from rootmatch.samplers.guided.verification import CANDIDATES


def warm() -> None:
    """Compile them, by one proposal. The types are the same for every problem and size."""
    best = np.zeros((1, 1), np.int64)
    candidates = np.full((1, 1, CANDIDATES), -1)
    _, lists = hypothesis_clustering.group(np.zeros(1), best, candidates, 1, ALIKE, WEAK)
    subsets, counts = np.zeros((1, 1), np.int64), np.zeros(1, np.int64)
    hypothesis_clustering.candidate_hyperedges(
        lists, hypothesis_clustering.membership(lists, 1), subsets, best, best.copy(), counts
    )
