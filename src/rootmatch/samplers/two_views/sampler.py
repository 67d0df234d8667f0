"""The guided sampler of two views: search, then the hyper-edges among the correspondences of its hypotheses."""

from __future__ import annotations

from dataclasses import replace

from rootmatch.backends import cpu
from rootmatch.deadline import Deadline
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.exhaustive import given_tensor
from rootmatch.samplers.guided.candidate_hyperedges import hyperedges_among, random_hyperedges
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.two_views.search import PoseSearch

SEARCHED = 0.6
"""Share of the time that is left at a deadline which the search may take."""


def two_view_tensor(task: SamplingTask, options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that relative poses name; see `rootmatch.Guided`."""
    deadline = task.deadline.part(SEARCHED)
    if options.max_seconds is not None and options.max_seconds < deadline.left():
        deadline = Deadline(options.max_seconds)
    views = replace(options.views, budget=min(options.views.budget, options.budget))
    search = PoseSearch(task, views, deadline)
    with deadline.within():
        search.run()
    few = replace(options, edges=min(options.edges, options.views.edges))
    source, target, coverage = hyperedges_among(search.clusters(), task.shape, task.order, few, search.rng)
    tensor = given_tensor(task, source, target)
    drawn = random_hyperedges(task.shape, task.order, options.chance_samples, search.rng)
    by_chance = cpu.residuals(task.tables, task.kind, *drawn)
    total = max(1.0, float(task.affinity.weights(by_chance[by_chance <= task.affinity.gate]).sum()))
    evaluated = search.evaluated + len(source) + options.chance_samples
    single = task.motions == 1
    return SampledTensor(
        tensor, evaluated, coverage, total / options.chance_samples, search.conclusive,
        partial=True,
        assignments=search.assignments() if single else None,
        consensus=search.consensus() if single else None,
    )  # fmt: skip
