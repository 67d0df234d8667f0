"""Several motions at once: groups packed from the tensor, and what they are worth against chance."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.explain.sampling import keep_affordable
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.rows import first_rows, sorted_rows
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.samplers.base import SampledTensor
from rootmatch.samplers.guided.crowding import CROWDING
from rootmatch.solvers.base import Solution
from rootmatch.solvers.packing.fitted_groups import GroupFit
from rootmatch.solvers.packing.solver import GroupPacking


def pack_motions(task: MatchingTask, sampled: SampledTensor) -> Solution:
    """Groups of one motion each among sampled hyper-edges."""
    tensor = keep_affordable(sampled.tensor, task.deadline)
    chance = sampled.chance
    if chance is None:
        chance = max(float(tensor.weights.sum()), 1.0) / max(sampled.evaluated, 1)
    solver = GroupPacking(motions=task.options.motions, chance_weight=chance, fit=_group_fit(task))
    return solver(tensor, seed=task.options.seed, deadline=task.deadline)


def log10_false_alarms_of_groups(solution: Solution, shape: tuple[int, int]) -> float:
    """Decimal logarithm of the expected number of false alarms among sets of groups.

    The ways to divide the points into such groups, over the exponential of the evidence, which has paid for the ways
    to match them.
    """
    if solution.groups is None or not (solution.groups >= 0).any():
        return math.inf
    if "against_chance" in solution.statistics:  # the evidence has paid for the choice of the points too
        return -solution.statistics["evidence"] / math.log(10.0)
    sizes = np.bincount(solution.groups[solution.groups >= 0])
    left = shape[0] - int(sizes.sum())
    ways = math.lgamma(shape[0] + 1) - math.lgamma(left + 1) - math.lgamma(len(sizes) + 1)
    ways -= sum(math.lgamma(int(size) + 1) for size in sizes)
    return (ways - solution.statistics["evidence"]) / math.log(10.0)


def _group_fit(task: MatchingTask) -> GroupFit | None:
    """The fit of whole groups by one motion; None if the problem has none."""
    groups = task.problem.groups(task.points, task.allowed)
    if groups is None:
        return None
    image, noise = task.image
    sigma = float(np.median(noise))
    area = max(float(np.prod(np.ptp(image, axis=0))), 1e-300) / CROWDING
    return GroupFit(groups.chi2, groups.grown, groups.extended, min(2.0 * math.pi * sigma**2 / area, 1.0))


def distinct_hyperedges(tensor: AffinityTensor) -> AffinityTensor:
    """Each hyper-edge once, with its first weight."""
    first = np.sort(first_rows(sorted_rows(tensor.indices), math.prod(tensor.shape)))
    return AffinityTensor.unchecked(tensor.indices[first], tensor.weights[first], tensor.shape, tensor.unary)
