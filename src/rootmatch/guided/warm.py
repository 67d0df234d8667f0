"""Kernels of the search that come after its largest, compiled ahead of need: see `rootmatch.solvers.warm`."""

from __future__ import annotations

import numpy as np

from rootmatch.guided.search import ALIKE, WEAK
from rootmatch.kernels import proposals
from rootmatch.kernels.weigh import CANDIDATES


def warm() -> None:
    """Compile them, by one proposal. The types are the same for every problem and size."""
    best = np.zeros((1, 1), np.int64)
    candidates = np.full((1, 1, CANDIDATES), -1)
    _, lists = proposals.group(np.zeros(1), best, candidates, 1, ALIKE, WEAK)
    subsets, counts = np.zeros((1, 1), np.int64), np.zeros(1, np.int64)
    proposals.candidate_hyperedges(lists, proposals.membership(lists, 1), subsets, best, best.copy(), counts)
