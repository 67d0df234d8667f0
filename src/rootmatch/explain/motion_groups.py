"""Several motions at once: groups of one motion each, packed from the tensor, and which motion each point belongs to.

If a solver finds groups, its groups are the labels; packing, the default for several motions, is such a solver. The
other solvers maximise one score over all points and know no groups. Only for these, and only if several motions are
requested, the assignment is clustered afterwards: points that no hyper-edge joins get different labels.
"""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.sampling import keep_affordable
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.rows import first_rows
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.samplers.base import SampledTensor
from rootmatch.samplers.guided.crowding import CROWDING
from rootmatch.solvers.base import Solution
from rootmatch.solvers.packing.fitted_groups import GroupFit
from rootmatch.solvers.packing.solver import GroupPacking

EXPECTED_WEIGHT = 0.15
"""Least mean weight of the hyper-edges of one motion. Not tuned: a round value between that of true hyper-edges, 0.5
for two degrees of freedom, and of false ones, a few hundredths."""


def label_motions(assignment: Integers, tensor: AffinityTensor, motions: int | str) -> Integers:
    """Motion of each source point, (n,): 0, 1, … by falling size, −1 where unmatched.

    Points are merged by the weight of the hyper-edges that hold both (average linkage). With ``"auto"`` the cut is
    taken where the weights within groups exceed `EXPECTED_WEIGHT` a hyper-edge by most in sum.
    """
    labels = np.full(len(assignment), -1, dtype=np.int64)
    matched = np.flatnonzero(assignment >= 0)
    if motions == 1 or len(matched) <= tensor.order:
        labels[matched] = 0
        return labels
    from scipy.cluster.hierarchy import fcluster, linkage  # slow to import, rarely needed
    from scipy.spatial.distance import squareform

    inside = tensor.inside(assignment)
    weights = inside.weights
    rank_of = np.full(len(assignment), -1)
    rank_of[matched] = np.arange(len(matched))
    points = rank_of[inside.indices // tensor.shape[1]]
    together = np.zeros((len(matched), len(matched)))
    for a, b in permutations(range(tensor.order), 2):
        np.add.at(together, (points[:, a], points[:, b]), weights)
    distance = 1.0 / (1.0 + together / max(float(np.median(together.max(axis=1))), 1e-300))
    np.fill_diagonal(distance, 0.0)
    tree = linkage(squareform(distance, checks=False), method="average")
    if motions == "auto":
        cuts = [fcluster(tree, count, criterion="maxclust") for count in range(1, len(matched) // tensor.order + 1)]
        groups = max(cuts, key=lambda cut: _excess_weight(cut, points, weights, tensor.order))
    else:
        groups = fcluster(tree, int(motions), criterion="maxclust")
    groups = _refine_groups(groups, points, weights, tensor.order)
    labels[matched] = relabel_by_size(groups)
    return labels


def relabel_by_size(labels: Integers) -> Integers:
    """Labels (n,) that count from the largest motion on; −1 stays."""
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    rank = np.argsort(np.argsort(-sizes, kind="stable"), kind="stable")
    return np.where(labels >= 0, rank[labels], -1)


def _excess_weight(groups: Integers, points: Integers, weights: Floats, order: int) -> float:
    """Weight within groups above what their number of hyper-edges must have."""
    labels = groups[points]
    same = (labels == labels[:, :1]).all(axis=1)
    tuples = sum(math.comb(int(size), order) for size in np.bincount(groups))
    return float(weights[same].sum()) - EXPECTED_WEIGHT * tuples


def _refine_groups(groups: Integers, points: Integers, weights: Floats, order: int) -> Integers:
    """Groups after each point has moved to where its hyper-edges exceed their expected weight most.

    Average linkage sometimes isolates a point that belongs to a group, or puts it into its second-best group.
    """
    groups = groups.copy()
    for _ in range(len(groups)):
        moved = False
        for point in range(len(groups)):
            holding = (points == point).any(axis=1)
            others = np.where(points[holding] == point, -1, groups[points[holding]])
            label = others.max(axis=1)
            pure = ((others == -1) | (others == label[:, None])).all(axis=1)
            inside_weights = weights[holding][pure]
            gain = np.bincount(label[pure], inside_weights, minlength=int(groups.max()) + 1).astype(np.float64)
            sizes = np.bincount(np.delete(groups, point), minlength=len(gain))
            gain -= EXPECTED_WEIGHT * np.array([math.comb(int(size), order - 1) for size in sizes])
            best = int(np.argmax(gain))
            if gain[best] > gain[groups[point]] + 1e-9:
                groups[point] = best
                moved = True
        if not moved:
            break
    return groups


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
    return GroupFit(groups, min(2.0 * math.pi * sigma**2 / area, 1.0))


def distinct_hyperedges(tensor: AffinityTensor) -> AffinityTensor:
    """Each hyper-edge once, with its first weight."""
    first = np.sort(first_rows(np.sort(tensor.indices, axis=1), math.prod(tensor.shape)))
    return AffinityTensor.unchecked(tensor.indices[first], tensor.weights[first], tensor.shape, tensor.unary)
