"""The assessment of a clear search by the poses of its hypotheses alone: hyper-edges are weighed when asked for.

A conclusive search whose hypotheses are all one pose has no rivals to weigh against each other, and the fit of that
pose tells each match from clutter better than hyper-edges do. Those have to agree as well, of which a few are enough.
Where anything is in doubt the tensor is made, and solved or assessed as that of any other sampler.
"""

from __future__ import annotations

from rootmatch.explain.agreement import hyperedges_agree
from rootmatch.explain.assessment import (
    does_not_fit,
    fits,
    point_by_point,
    sure_beyond_chance,
)
from rootmatch.explain.assignment_posterior import ranked
from rootmatch.explain.confidence import of_one_pose
from rootmatch.explain.decide import TRUST, Facts
from rootmatch.explain.finding import Finding
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.samplers.base import SampledTensor


def decided_by_pose(task: MatchingTask, sampled: SampledTensor) -> Finding | None:
    """The finding, its scores on demand; None if hyper-edges have to be weighed first."""
    tensor, named, options = sampled.tensor, sampled.assignments, task.options
    if not isinstance(tensor, DeferredTensor) or named is None or not len(named) or sampled.missed > TRUST.missed:
        return None
    if options.solver is not None or options.is_paper or tensor.unary is not None or task.points.normals is not None:
        return None
    if not fits(task, named[0]) or not of_one_pose(named[0], named).all():
        return None
    found = ranked(task, list(named), consensus=sampled.consensus)
    if not found.assignments or does_not_fit(found.misfit) or not sure_beyond_chance(found):
        return None
    best, *others = found.assignments[: TRUST.alternatives + 1]
    if not hyperedges_agree(task, best):
        return None
    decided = Finding(
        task=task,
        assignment=best,
        others=others,
        facts=Facts(probability=found.probability, min_probability=options.least_probability(TRUST.probability)),
        tensor=tensor,
        evaluated=sampled.evaluated,
        noise_factor=found.misfit.sigma,
    )
    return point_by_point(task, decided, found, sampled)
