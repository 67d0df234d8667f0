"""The hyper-edges among the correspondences that proposals name."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rootmatch.samplers.guided import hypothesis_clustering
from rootmatch.samplers.guided.hypotheses import Found
from rootmatch.samplers.guided.options import GuidedOptions

Integers = NDArray[np.int64]


def hyperedges_among(
    found: Found, shape: tuple[int, int], order: int, options: GuidedOptions, rng: np.random.Generator
) -> tuple[Integers, Integers, float]:
    """Hyper-edges within each group of proposals, each once.

    The same d-subsets of source points serve all groups, so that their scores can be compared.

    Returns
    -------
    source, target : (E, d) int64 arrays
        Source points ascending.
    share : float
        Part of the d-subsets that was used.
    """
    lists = found.lists
    mask = hypothesis_clustering.membership(lists, shape[1])
    subsets, share = _subsets(found, shape[0], order, options.subsets, rng)
    nothing = np.empty((0, order), np.int64)
    counts = np.zeros(len(lists), np.int64)
    hypothesis_clustering.candidate_hyperedges(lists, mask, subsets, nothing, nothing, counts)
    if len(counts) and counts[0] > options.edges:
        keep = max(1, int(len(subsets) * options.edges / counts[0]))
        share *= keep / len(subsets)
        subsets = subsets[np.sort(rng.permutation(len(subsets))[:keep])]
        hypothesis_clustering.candidate_hyperedges(lists[:1], mask, subsets, nothing, nothing, counts)
    total = int(counts[np.cumsum(counts) <= max(options.edges, counts[:1].sum())].sum())
    source, target = np.empty((total, order), np.int64), np.empty((total, order), np.int64)
    hypothesis_clustering.candidate_hyperedges(lists, mask, subsets, source, target, counts)
    return source, target, share


def _subsets(found: Found, n: int, order: int, most: int, rng: np.random.Generator) -> tuple[Integers, float]:
    """Subsets (S, d) of source points, ascending, and which part of all they are.

    Where there are more than ``most``, a random choice among the points of the groups that are beyond chance (of the
    best group when none is).
    """
    if math.comb(n, order) <= most:
        return np.array(list(combinations(range(n), order)), dtype=np.int64).reshape(-1, order), 1.0
    sure = max(1, int((found.evidence > found.accident).sum()))
    points = np.flatnonzero((found.lists[:sure, :, 0] >= 0).any(axis=0))
    every = math.comb(len(points), order)
    if every <= most:
        return points[np.array(list(combinations(range(len(points)), order)), dtype=np.int64).reshape(-1, order)], 1.0
    drawn = np.sort(rng.integers(0, len(points), (most + most // 2, order)), axis=1)
    drawn = np.unique(drawn[(drawn[:, 1:] != drawn[:, :-1]).all(axis=1)], axis=0)
    drawn = drawn[np.sort(rng.permutation(len(drawn))[:most])]
    return points[drawn], len(drawn) / every


def random_hyperedges(
    shape: tuple[int, int], order: int, count: int, rng: np.random.Generator
) -> tuple[Integers, Integers]:
    """Uniform hyper-edges (count, d), a quick draw for few of them."""
    return _distinct(shape[0], order, count, rng), _distinct(shape[1], order, count, rng)


def _distinct(points: int, size: int, count: int, rng: np.random.Generator) -> Integers:
    """Rows (count, size) of distinct indices below ``points``, each ordered choice as likely as any other.

    The p-th index is drawn among those that are left, and stepped over the ones before it in increasing order.
    """
    chosen: list[Integers] = []
    ascending: list[Integers] = []
    for p in range(size):
        drawn = rng.integers(0, points - p, count)
        for before in ascending:
            drawn += drawn >= before
        chosen.append(drawn)
        # keep those before in order: the new one moves down past the greater ones
        moving = drawn
        for q, before in enumerate(ascending):
            ascending[q], moving = np.minimum(before, moving), np.maximum(before, moving)
        ascending.append(moving)
    return np.stack(chosen, axis=1)
