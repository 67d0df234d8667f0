"""Multi-motion: groups packed from the tensor, the rest swept exhaustively, and packed again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from rootmatch.deadline import Deadline
from rootmatch.explain.sampling import keep_affordable, sample
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.deferred_tensor import concatenate_tensors, renumber_tensor
from rootmatch.hypergraph.enumeration import exhaustive_count
from rootmatch.hypergraph.rows import first_rows, sorted_rows
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.samplers.base import SampledTensor, Sampler
from rootmatch.samplers.completion import Completion
from rootmatch.samplers.guided.crowding import CROWDING
from rootmatch.solvers.base import Solution
from rootmatch.solvers.packing.fitted_groups import GroupFit
from rootmatch.solvers.packing.solver import GroupPacking

REST = 50_000_000
"""Most hyper-edges among the rest that are swept exhaustively (benchmarks/matches.py --only motions)."""

FIRST_PACKING = 0.5
"""Share of the time left at a deadline for the first packing."""


def pack_motions(task: MatchingTask, sampled: SampledTensor) -> tuple[Solution, SampledTensor]:
    """Groups of one motion each, and the tensor that they were found in.

    A guided search may miss a small motion. If points and detections remain unexplained, all hyper-edges among those
    are evaluated and packed again.
    """
    solution = _pack(task, sampled, task.deadline.part(FIRST_PACKING))
    if not sampled.partial or solution.groups is None or task.deadline.passed():
        return solution, sampled
    order = task.problem.order
    sizes = np.bincount(solution.groups[solution.groups >= 0], minlength=1)
    firm = (solution.groups >= 0) & (sizes[solution.groups] >= order + 2)
    points = np.flatnonzero(~firm)
    pixels = np.setdiff1d(np.arange(task.shape[1]), solution.assignment[firm])
    if min(len(points), len(pixels)) <= order:
        return solution, sampled
    rest = task.subset(points, pixels)
    sampler: Literal["exhaustive"] | Sampler = "exhaustive"
    if exhaustive_count(*rest.shape, order) > REST:
        sampler = Completion()
        if not sampler.pays(rest.sampling_task):
            return solution, sampled
    more = sample(replace(rest, options=replace(rest.options, sampler=sampler)))
    added = renumber_tensor(more.tensor, (points, pixels), task.shape)
    added = AffinityTensor.unchecked(np.sort(added.indices, axis=1), added.weights, task.shape)
    tensor = concatenate_tensors([sampled.tensor, added], task.shape, task.weights, task.options.max_hyperedges)
    joined = sampled._replace(tensor=distinct_hyperedges(tensor), evaluated=sampled.evaluated + more.evaluated)
    return _pack(task, joined, task.deadline), joined


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


def _pack(task: MatchingTask, sampled: SampledTensor, deadline: Deadline) -> Solution:
    tensor = keep_affordable(sampled.tensor, deadline)
    chance = sampled.chance
    if chance is None:
        chance = max(float(tensor.weights.sum()), 1.0) / max(sampled.evaluated, 1)
    solver = GroupPacking(motions=task.options.motions, chance_weight=chance, fit=_group_fit(task))
    return solver(tensor, seed=task.options.seed, deadline=deadline)


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
