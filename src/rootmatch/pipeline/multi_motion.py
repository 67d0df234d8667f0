"""Several motions: groups packed from the tensor, what is left looked at in full, and packed again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.hypergraph.enumeration import exhaustive_count
from rootmatch.hypergraph.rows import first_rows, sorted_rows
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.pipeline.road import Road
from rootmatch.pipeline.sampling import Way
from rootmatch.problems.checks import check_noise
from rootmatch.samplers.base import SampledTensor, Sampler
from rootmatch.samplers.clutter import CROWDING
from rootmatch.samplers.completion import Completion
from rootmatch.solvers.base import Solution
from rootmatch.solvers.packing.fitted_groups import GroupFit
from rootmatch.solvers.packing.solver import GroupPacking

REST = 50_000_000
"""Most hyper-edges among what is left that are looked at one by one."""


def several(road: Road, weighed: SampledTensor) -> tuple[Solution, SampledTensor]:
    """Groups of one motion each, and the tensor that they were found in.

    A guided search may never have proposed a small motion. Where it leaves points and detections unexplained, all
    hyper-edges among those are looked at and the packing is made again.
    """
    solution = _packed(road, weighed)
    if not weighed.partial or solution.groups is None:
        return solution, weighed
    sizes = np.bincount(solution.groups[solution.groups >= 0], minlength=1)
    firm = (solution.groups >= 0) & (sizes[solution.groups] >= road.problem.order + 2)
    points = np.flatnonzero(~firm)
    pixels = np.setdiff1d(np.arange(road.shape[1]), solution.assignment[firm])
    order = road.problem.order
    if min(len(points), len(pixels)) <= order:
        return solution, weighed
    rest = replace(
        road, points=road.points[points], pixels=road.pixels[pixels],
        noise=_of_some(road.noise, pixels, road.shape[1]),
        normals=None if road.normals is None else road.normals[points],
        allowed=None if road.allowed is None else np.ascontiguousarray(road.allowed[np.ix_(points, pixels)]),
        unary=None, progress=None, scheduler=None,
    )  # fmt: skip
    way: Way | Sampler = "exhaustive"
    if exhaustive_count(*rest.shape, order) > REST:
        way = Completion()
        if not way.pays(rest.request()):
            return solution, weighed
    more = rest.tensor(way, 0)
    source, target = np.divmod(more.tensor.indices, np.int32(len(pixels)))
    indices = (points[source] * road.shape[1] + pixels[target]).astype(np.int32)
    tensor = AffinityTensor.unchecked(
        np.concatenate([weighed.tensor.indices, np.sort(indices, axis=1)]),
        np.concatenate([weighed.tensor.weights, more.tensor.weights]),
        road.shape, road.unary,
    )  # fmt: skip
    joined = weighed._replace(tensor=_distinct(tensor), evaluated=weighed.evaluated + more.evaluated)
    return _packed(road, joined), joined


def log10_by_chance(solution: Solution, shape: tuple[int, int]) -> float:
    """Decimal logarithm of how many sets of groups as good chance is expected to find.

    The ways to divide the points into such groups, over the exponential of the evidence, which has paid for the ways
    to match them.
    """
    if solution.groups is None or not (solution.groups >= 0).any():
        return math.inf
    sizes = np.bincount(solution.groups[solution.groups >= 0])
    left = shape[0] - int(sizes.sum())
    ways = math.lgamma(shape[0] + 1) - math.lgamma(left + 1) - math.lgamma(len(sizes) + 1)
    ways -= sum(math.lgamma(int(size) + 1) for size in sizes)
    return (ways - solution.statistics["evidence"]) / math.log(10.0)


def _packed(road: Road, weighed: SampledTensor) -> Solution:
    tensor = weighed.tensor
    chance = weighed.chance_weight
    if chance is None:
        chance = max(float(tensor.weights.sum()), 1.0) / max(weighed.evaluated, 1)
    return GroupPacking(motions=road.motions, chance=chance, fit=_fit(road))(tensor, seed=road.seed)


def _fit(road: Road) -> GroupFit | None:
    """How well whole groups fit, where the problem can tell."""
    if not road.problem.fits_groups:
        return None
    tables = _tables(road)
    sigma = float(np.median(check_noise(road.noise, road.shape[1])))
    area = max(float(np.prod(np.ptp(road.pixels, axis=0))), 1e-300) / CROWDING

    def chi2(groups: NDArray[np.int64]) -> NDArray[np.float64]:
        return road.problem.group_chi2(tables, groups)

    def grown(groups: NDArray[np.int64]) -> NDArray[np.int64]:
        return road.problem.group_grown(tables, groups, road.allowed)

    def extended(groups: NDArray[np.int64]) -> NDArray[np.int64]:
        return road.problem.group_extended(tables, groups, road.allowed)

    return GroupFit(chi2, grown, extended, min(2.0 * math.pi * sigma**2 / area, 1.0))


def _tables(road: Road) -> Any:
    return road.problem.prepare(road.points, road.pixels, road.noise, road.normals)


def _of_some(noise: ArrayLike, pixels: NDArray[np.int64], count: int) -> ArrayLike:
    """The noise of some of the target points; a pair holds for source and target apart."""
    if isinstance(noise, tuple | list) and len(noise) == 2:
        return noise
    return check_noise(noise, count)[pixels]


def _distinct(tensor: AffinityTensor) -> AffinityTensor:
    """Each hyper-edge once, with the weight that it had first."""
    first = np.sort(first_rows(sorted_rows(tensor.indices), math.prod(tensor.shape)))
    return AffinityTensor.unchecked(tensor.indices[first], tensor.weights[first], tensor.shape, tensor.unary)
