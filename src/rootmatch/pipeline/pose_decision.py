"""The assessment of a clear search by the poses of its hypotheses alone: hyper-edges are weighed when asked for.

A conclusive search whose hypotheses are all one pose has no rivals to weigh against each other, and the fit of that
pose tells each match from clutter better than hyper-edges do. Those have to agree as well, of which a few are enough.
Where anything is in doubt the tensor is made, and solved or assessed as that of any other sampler.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.assignment import margin, one_hot
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.support import scores_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.on_demand import Once
from rootmatch.pipeline.assessment import (
    Assessment,
    does_not_fit,
    fits,
    hyperedges_agree,
    point_by_point,
    sure_beyond_chance,
)
from rootmatch.pipeline.confidence import of_one_pose
from rootmatch.pipeline.posterior import ranked
from rootmatch.pipeline.status import TRUST, judged
from rootmatch.pipeline.task import MatchingTask
from rootmatch.samplers.base import SampledTensor


def decided_by_pose(task: MatchingTask, sampled: SampledTensor) -> Assessment | None:
    """The assessment, its scores on demand; None where hyper-edges have to be weighed first."""
    tensor, named, options = sampled.tensor, sampled.assignments, task.options
    if not isinstance(tensor, DeferredTensor) or named is None or not len(named) or sampled.missed > TRUST.missed:
        return None
    if options.solver is not None or options.is_paper or tensor.unary is not None or task.points.normals is not None:
        return None
    if not fits(task, named[0]) or not of_one_pose(named[0], named).all():
        return None
    found = ranked(task, list(named), consensus=sampled.consensus)
    if not found.assignments or does_not_fit(found.misfit) or not sure_beyond_chance(task, found):
        return None
    kept = np.array(found.assignments[: TRUST.alternatives + 1])
    if not hyperedges_agree(task, kept[0]):
        return None

    @Once
    def scores() -> list[float]:
        """Of the assignment and its alternatives."""
        return [float(score) for score in scores_of(tensor, kept)]

    def alternatives() -> list[tuple[NDArray[np.int64], float]]:
        """The other assignments and their scores."""
        return list(zip(kept[1:], scores()[1:], strict=True))

    assessed = Assessment(
        assignment=kept[0],
        score=lambda: scores()[0],
        margin=lambda: margin(scores()[0], alternatives(), kept[0]),
        probability=found.probability,
        alternatives=alternatives,
        status=judged(np.inf, -np.inf, 1.0, found.probability),
        noise_factor=found.misfit.sigma,
    )
    return point_by_point(task, assessed, found, sampled)


def soft_of(tensor: AffinityTensor, assignment: NDArray[np.int64]) -> NDArray[np.float64]:
    """What supports each correspondence (n, n'), given an assignment, each row over its sum."""
    gains = np.maximum(tensor.contract(one_hot(assignment, tensor.shape[1])), 0.0)
    rows = gains.sum(axis=1, keepdims=True)
    return np.asarray(gains / np.where(rows > 0.0, rows, 1.0))
