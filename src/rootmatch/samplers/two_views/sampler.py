"""The guided sampler of two views: search, then the hyper-edges among the correspondences of its hypotheses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from rootmatch.backends import cpu
from rootmatch.deadline import Deadline
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.exhaustive import given_tensor
from rootmatch.samplers.guided.candidate_hyperedges import hyperedges_among, random_hyperedges
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.two_views.search import PoseSearch

SEARCHED, RESERVE = 0.6, 0.3
"""Share of the time left at a deadline that the search may take, and seconds that suffice for its hyper-edges."""


def two_view_tensor(task: SamplingTask, options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that relative poses name; see `rootmatch.Guided`."""
    deadline = task.deadline.part(SEARCHED, RESERVE)
    if options.max_seconds is not None and options.max_seconds < deadline.left():
        deadline = Deadline(options.max_seconds)
    views = replace(options.views, budget=min(options.views.budget, options.budget))
    search = PoseSearch(task, views, deadline)
    with deadline.within():
        search.run()
    few = replace(options, edges=min(options.edges, options.views.edges))

    @cache
    def weighed() -> tuple[AffinityTensor, float, int]:
        """The tensor, which fraction of its hyper-edges was evaluated, and how many they are."""
        source, target, coverage = hyperedges_among(search.clusters(), task.shape, task.order, few, search.rng)
        return given_tensor(task, source, target), coverage, len(source)

    def chance() -> float:
        """Mean weight of random hyper-edges."""
        weighed()  # draws first, whoever asks first
        drawn = random_hyperedges(task.shape, task.order, options.chance_samples, search.rng)
        by_chance = cpu.residuals(task.tables, task.kind, *drawn)
        total = max(1.0, float(task.affinity.weights(by_chance[by_chance <= task.affinity.gate]).sum()))
        return total / options.chance_samples

    tensor: AffinityTensor
    if task.later and task.motions == 1 and search.hypotheses and not task.deadline.is_set:
        # the poses are judged by themselves, and nobody may ask for hyper-edges
        tensor, evaluated = DeferredTensor.of(lambda: weighed()[0], task.shape), search.evaluated
    else:
        tensor, evaluated = weighed()[0], search.evaluated + weighed()[2]
    single = task.motions == 1
    return SampledTensor(
        tensor, evaluated, lambda: weighed()[1], chance, search.conclusive,
        partial=True,
        assignments=search.assignments() if single else None,
        consensus=search.consensus() if single else None,
    )  # fmt: skip
