"""The guided sampler of two views: search, then the hyper-edges among the correspondences of its hypotheses."""

from __future__ import annotations

from dataclasses import replace

from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.candidate_hyperedges import sample_clusters
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.two_views.pose_search import PoseSearch

SEARCHED, RESERVE = 0.6, 0.3
"""Share of the time left at a deadline that the search may take, and seconds that suffice for its hyper-edges."""
EDGES = 60_000
"""Most hyper-edges that are evaluated."""


def sample_two_views(task: SamplingTask, options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that relative poses name; see `rootmatch.Guided`."""
    deadline = task.deadline.part(SEARCHED, RESERVE).at_most(options.max_seconds)
    search = PoseSearch(task, deadline, options.budget)
    with deadline.within():
        search.run()
    single = task.motions == 1
    return sample_clusters(
        task, search.clusters, replace(options, edges=min(options.edges, EDGES)), search.rng, search.evaluated,
        # the poses are judged by themselves, and nobody may ask for hyper-edges
        later=single and bool(search.hypotheses),
        conclusive=search.conclusive,
        missed=search.missed if single else 0.0,
        repeated=single and search.repeated,
        assignments=search.assignments() if single else None,
        consensus=search.consensus() if single else None,
    )  # fmt: skip
