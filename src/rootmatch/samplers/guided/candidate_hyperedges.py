"""The hyper-edges among the correspondences that the clusters of hypotheses name."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph.enumeration import subsets as every_subset
from rootmatch.hypergraph.random_tuples import distinct_sets, distinct_tuples
from rootmatch.jit.threads import in_pieces
from rootmatch.samplers.guided.hypotheses import HypothesisClusters
from rootmatch.samplers.guided.hypothesis_clustering import candidate_hyperedges, membership
from rootmatch.samplers.guided.options import GuidedOptions

Integers = NDArray[np.int64]
COUNTED = 0.4
"""Share of the time left at a deadline in which hyper-edges are counted; to list them takes as long again."""


def hyperedges_among(
    clusters: HypothesisClusters,
    shape: tuple[int, int],
    order: int,
    options: GuidedOptions,
    rng: np.random.Generator,
    *,
    deadline: Deadline = NEVER,
) -> tuple[Integers, Integers, float]:
    """Hyper-edges within each cluster of hypotheses, each once.

    The same d-subsets of source points serve all clusters, so that their scores can be compared. Near a deadline they
    are fewer.

    Returns
    -------
    source, target : (E, d) int64 arrays
        Source points ascending.
    coverage : float
        Fraction of the d-subsets that was used.
    """
    lists = clusters.lists
    mask = membership(lists, shape[1])
    subsets, coverage = _subsets(clusters, shape[0], order, options, rng)
    nothing = np.empty((0, order), np.int64)
    counts, counted = _counts(lists, mask, subsets, deadline.part(COUNTED))
    if len(counted) < len(subsets):
        coverage *= len(counted) / len(subsets)
        subsets = counted
    if len(counts) and counts[0] > options.edges:
        keep = max(1, int(len(subsets) * options.edges / counts[0]))
        coverage *= keep / len(subsets)
        subsets = subsets[np.sort(rng.permutation(len(subsets))[:keep])]
        candidate_hyperedges(lists, mask, subsets, nothing, nothing, counts)
    counts = counts[np.cumsum(counts) <= max(options.edges, counts[:1].sum())]
    source, target = np.empty((2, int(counts.sum()), order), np.int64)
    candidate_hyperedges(lists[: len(counts)], mask, subsets, source, target, counts)
    return source, target, coverage


def _counts(
    lists: Integers, mask: NDArray[np.uint64], subsets: Integers, deadline: Deadline
) -> tuple[Integers, Integers]:
    """How many hyper-edges each cluster has, and of which subsets: all that can be counted by a deadline."""
    counts, done = np.zeros(len(lists), np.int64), 0
    nothing = np.empty((0, subsets.shape[1]), np.int64)
    # the first ones of a list are of the first points; without a deadline all are counted in any order
    order = np.random.default_rng(0).permutation(len(subsets)) if deadline.is_set else np.arange(len(subsets))

    def count(first: int, last: int) -> None:
        nonlocal counts, done
        some = np.zeros(len(lists), np.int64)
        candidate_hyperedges(lists, mask, subsets[order[first:last]], nothing, nothing, some)
        counts, done = counts + some, last

    with deadline.within():
        in_pieces(count, len(subsets))
    return counts, subsets[np.sort(order[:done])]


def _subsets(
    clusters: HypothesisClusters, n: int, order: int, options: GuidedOptions, rng: np.random.Generator
) -> tuple[Integers, float]:
    """Subsets (S, d) of source points, ascending, and which fraction of all they are.

    Where there are more than ``options.subsets``, a random selection among the points of the clusters that are beyond
    chance (of the best cluster when none is).
    """
    most = options.subsets
    if math.comb(n, order) <= most:
        return every_subset(n, order), 1.0
    beyond_chance = max(1, int((clusters.evidence > clusters.false_alarm_level).sum()))
    points = np.flatnonzero((clusters.lists[:beyond_chance, :, 0] >= 0).any(axis=0))
    every = math.comb(len(points), order)
    if every <= most:
        return points[every_subset(len(points), order)], 1.0
    drawn = distinct_sets(rng, int(options.surplus * most), len(points), order)
    # each once, by number: a row is a number to the base of how many points there are
    places = len(points) ** np.arange(order - 1, -1, -1)
    if every < 2**62:
        drawn = drawn[np.unique(drawn @ places, return_index=True)[1]]
    else:
        drawn = np.unique(drawn, axis=0)
    drawn = drawn[np.sort(rng.permutation(len(drawn))[:most])]
    return points[drawn], len(drawn) / every


def random_hyperedges(
    shape: tuple[int, int], order: int, count: int, rng: np.random.Generator
) -> tuple[Integers, Integers]:
    """Uniform hyper-edges (count, d), a quick draw for few of them."""
    return distinct_tuples(rng, count, shape[0], order), distinct_tuples(rng, count, shape[1], order)
