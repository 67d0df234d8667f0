"""The guided sampler of two point sets: search, then the hyper-edges among the correspondences of its motions."""

from __future__ import annotations

from rootmatch.problems.points import PointClouds
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.candidate_hyperedges import sample_clusters
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.point_sets.motion_search import MotionSearch

SEARCHED = 0.7
"""Share of the time that is left at a deadline which the search may take."""
CHANCE_SAMPLES = 100_000
"""Random hyper-edges that estimate the mean weight by chance: three constraints agree far more rarely than one."""


def sample_point_sets(task: SamplingTask, clouds: PointClouds, options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that motions name; see `rootmatch.Guided`."""
    deadline = task.deadline.part(SEARCHED).at_most(options.max_seconds)
    search = MotionSearch(task, clouds, deadline)
    with deadline.within():
        search.run(options.budget)
    sampled = sample_clusters(
        task, search.clusters, options, search.rng, search.evaluated,
        later=task.motions == 1,
        chance_samples=CHANCE_SAMPLES,
        conclusive=search.conclusive,
        assignments=search.assignments() if task.motions == 1 else None,
        missed=search.missed,
    )  # fmt: skip
    return sampled._replace(evaluated=sampled.evaluated + CHANCE_SAMPLES)
