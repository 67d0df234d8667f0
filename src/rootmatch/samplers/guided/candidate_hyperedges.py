"""The hyper-edges among the correspondences that the clusters of hypotheses name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Integers
from rootmatch.backends import cpu
from rootmatch.deadline import NEVER, Deadline, OutOfTime
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.enumeration import subsets as every_subset
from rootmatch.hypergraph.random_tuples import distinct_sets, distinct_tuples
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.threads import run_in_pieces
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.exhaustive import tensor_of_hyperedges
from rootmatch.samplers.guided.hypotheses import HypothesisClusters
from rootmatch.samplers.guided.hypothesis_clustering import candidate_hyperedges, membership
from rootmatch.samplers.guided.options import GuidedOptions

COUNTED = 0.4
"""Share of the time left at a deadline in which hyper-edges are counted; to list them takes as long again."""
SURPLUS = 1.5
"""Drawn d-subsets for each that is used, as some are drawn twice or repeat a point."""
WEIGHED = 0.5
"""Share of the time left at a deadline for the hyper-edges of what a search has found."""
SECONDS_PER_EDGE = 4e-7
"""To evaluate one of those, at most (benchmarks/kernels.py)."""
CHANCE_SAMPLES = 4_096
"""Random hyper-edges that estimate the mean weight by chance. Evaluated in half a millisecond."""


def sample_clusters(
    task: SamplingTask,
    clusters: Callable[[], HypothesisClusters],
    options: GuidedOptions,
    rng: np.random.Generator,
    evaluated: int,
    *,
    later: bool = True,
    chance_samples: int = CHANCE_SAMPLES,
    deadline: Deadline = NEVER,
    **found: Any,
) -> SampledTensor:
    """What a search hands on: the hyper-edges among the correspondences of its clusters, evaluated.

    Parameters
    ----------
    task : SamplingTask
    clusters : callable
        The clusters of hypotheses that the search ended with.
    options : GuidedOptions
    rng : Generator
        Selects hyper-edges where there are too many.
    evaluated : int
        Evaluations of the search.
    later : bool
        Whether they are evaluated when they are asked for, unless the task has a deadline: a pose may decide alone.
    chance_samples : int
        Random hyper-edges whose mean weight is that by chance.
    deadline : Deadline
    **found
        Other fields of `SampledTensor`.
    """

    @cache
    def weighed() -> tuple[AffinityTensor, float, int]:
        """The tensor, which fraction of its hyper-edges was evaluated, and how many they are."""
        few = options
        if deadline.is_set:
            few = replace(options, edges=deadline.part(WEIGHED).affordable(options.edges, SECONDS_PER_EDGE))
        source, target, coverage = list_cluster_hyperedges(
            clusters(), task.shape, task.order, few, rng, deadline=deadline
        )
        deadline.record_cut(left_out=coverage < 1.0 and few.edges < options.edges)
        return tensor_of_hyperedges(task, source, target), coverage, len(source)

    def chance() -> float:
        """Mean weight of random hyper-edges."""
        weighed()  # draws first, whoever asks first
        source, target = (distinct_tuples(rng, chance_samples, count, task.order) for count in task.shape)
        by_chance = cpu.residuals(task.tables, task.kind, source, target)
        # no sample is large enough to say that chance never agrees
        total = max(1.0, float(task.affinity.weights(by_chance[by_chance <= task.affinity.gate]).sum()))
        return total / chance_samples

    if later and not task.deadline.is_set:
        tensor: AffinityTensor = DeferredTensor.of(lambda: weighed()[0], task.shape)
        return SampledTensor(tensor, evaluated, lambda: weighed()[1], chance, partial=True, **found)
    try:
        tensor, coverage, count = weighed()
    except OutOfTime:  # what the search named is handed on, of which a pose may decide
        nothing = np.empty((0, task.order), np.int32)
        tensor, coverage, count = AffinityTensor.unchecked(nothing, np.empty(0), task.shape), 0.0, 0
    return SampledTensor(tensor, evaluated + count, coverage, chance, partial=True, **found)


def list_cluster_hyperedges(
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
    subsets, coverage = _draw_subsets(clusters, shape[0], order, options, rng)
    nothing = np.empty((0, order), np.int64)
    counts, counted = _count_hyperedges(lists, mask, subsets, deadline.part(COUNTED))
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


def _count_hyperedges(
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
        run_in_pieces(count, len(subsets))
    return counts, subsets[np.sort(order[:done])]


def _draw_subsets(
    clusters: HypothesisClusters, n: int, order: int, options: GuidedOptions, rng: np.random.Generator
) -> tuple[Integers, float]:
    """Subsets (S, d) of source points, ascending, and which fraction of all they are.

    Where there are more than ``options.subsets``, a random selection among the points of the clusters that are beyond
    chance (of the best cluster when none is).
    """
    maximum = options.subsets
    if math.comb(n, order) <= maximum:
        return every_subset(n, order), 1.0
    beyond_chance = max(1, int((clusters.evidence > clusters.false_alarm_level).sum()))
    points = np.flatnonzero((clusters.lists[:beyond_chance, :, 0] >= 0).any(axis=0))
    every = math.comb(len(points), order)
    if every <= maximum:
        return points[every_subset(len(points), order)], 1.0
    drawn = distinct_sets(rng, int(SURPLUS * maximum), len(points), order)
    # each once, by number: a row is a number to the base of how many points there are
    places = len(points) ** np.arange(order - 1, -1, -1)
    if every < 2**62:
        drawn = drawn[np.unique(drawn @ places, return_index=True)[1]]
    else:
        drawn = np.unique(drawn, axis=0)
    drawn = drawn[np.sort(rng.permutation(len(drawn))[:maximum])]
    return points[drawn], len(drawn) / every
