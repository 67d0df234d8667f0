"""The guided sampler of two point sets: search, then the hyper-edges among the correspondences of its motions."""

from __future__ import annotations

from rootmatch.backends import cpu
from rootmatch.deadline import Deadline
from rootmatch.problems.points import PointClouds
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.exhaustive import given_tensor
from rootmatch.samplers.guided.candidate_hyperedges import hyperedges_among, random_hyperedges
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.point_sets.search import MotionSearch

SEARCHED = 0.7
"""Share of the time that is left at a deadline which the search may take. A round value."""


def point_set_tensor(task: SamplingTask, clouds: PointClouds, options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that motions name; see `rootmatch.Guided`."""
    deadline = task.deadline.part(SEARCHED)
    if options.max_seconds is not None and options.max_seconds < deadline.left():
        deadline = Deadline(options.max_seconds)
    search = MotionSearch(task, clouds, options.point_sets, deadline)
    with deadline.within():
        search.run(options.budget)
    source, target, coverage = hyperedges_among(search.clusters(), task.shape, task.order, options, search.rng)
    tensor = given_tensor(task, source, target)
    samples = options.point_sets.chance_samples
    drawn = random_hyperedges(task.shape, task.order, samples, search.rng)
    by_chance = cpu.residuals(task.tables, task.kind, *drawn)
    total = max(1.0, float(task.affinity.weights(by_chance[by_chance <= task.affinity.gate]).sum()))
    return SampledTensor(
        tensor,
        search.evaluated + len(source) + samples,
        coverage,
        total / samples,
        search.conclusive,
        partial=True,
        assignments=search.assignments() if task.motions == 1 else None,
    )
