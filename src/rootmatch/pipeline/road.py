"""From points to a tensor: the choice of hyper-edges, and their residuals as weights."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.backends import cpu, selection
from rootmatch.backends.dask import Cluster
from rootmatch.backends.strongest import Progress
from rootmatch.hypergraph import enumeration as edges
from rootmatch.hypergraph.affinity import Affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.pipeline.sampling import Way, build
from rootmatch.problems import residual_kinds
from rootmatch.problems.base import Problem
from rootmatch.samplers.base import SampledTensor, Sampler, SamplingTask


@dataclass(frozen=True)
class Road:
    """What was asked for, checked, as far as the tensor depends on it."""

    problem: Problem
    points: NDArray[np.float64]
    pixels: NDArray[np.float64]
    noise: ArrayLike
    weigh: Affinity
    normals: NDArray[np.float64] | None = None
    allowed: NDArray[np.bool_] | None = None
    unary: NDArray[np.float64] | None = None
    motions: int | Literal["auto"] = 1
    max_hyperedges: int = 5_000_000
    limit: int | None = None
    seed: int = 0
    progress: Progress | None = None
    backend: selection.Name = "auto"
    scheduler: str | None = None
    as_given: bool = False
    """Whether the source points are asked for in the caller's order, as the paper's residuals take them."""

    @property
    def shape(self) -> tuple[int, int]:
        """Source and target points."""
        return len(self.points), len(self.pixels)

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """In which the source points are asked for, (n,)."""
        return np.arange(len(self.points)) if self.as_given else edges.wide_first(self.points)

    def request(self) -> SamplingTask:
        """What a choice of hyper-edges is asked for, the source points in their order."""
        return SamplingTask(
            self._prepare(), self.weigh.residual.kernel_kind(self.problem.pair_count), self.weigh, self.shape,
            self.problem.order, self.seed, self.motions,
            None if self.allowed is None else self.allowed[self.order], self.progress,
        )  # fmt: skip

    def tensor(self, way: Way | Sampler, samples: int | None) -> SampledTensor:
        """Hyper-edges chosen in some way, weighed; ``samples`` is how many random ones."""
        request = self.request()
        weighed, evaluator = build(
            request, way=way, samples=samples, backend=self.backend,
            cluster=None if self.scheduler is None else Cluster(self.scheduler, self._prepare),
            max_hyperedges=self.max_hyperedges, limit=self.limit,
        )  # fmt: skip
        tensor = weighed.tensor
        if self.problem.small_baseline > 0.0:
            tensor = self._near(tensor, request.tables)
        return weighed._replace(tensor=selection.placed(_restored(tensor, self.order, self.unary), evaluator))

    @property
    def _prepare(self) -> partial[Any]:
        """The problem's tables; by itself, so that a cluster's workers make their own."""
        facing = None if self.normals is None else self.normals[self.order]
        return partial(self.problem.prepare, self.points[self.order], self.pixels, self.noise, facing)

    def _near(self, tensor: AffinityTensor, tables: Any) -> AffinityTensor:
        """The tensor with the prior of views from nearly one place."""
        source, target = np.divmod(tensor.indices.astype(np.int64), self.shape[1])
        raw = cpu.residuals(tables, residual_kinds.QR(), source, target)
        weights = tensor.weights * np.exp(-raw / self.problem.small_baseline)
        keep = weights >= math.exp(-0.5 * self.weigh.gate**2)
        return AffinityTensor.unchecked(tensor.indices[keep], weights[keep], tensor.shape)


def _restored(tensor: AffinityTensor, order: NDArray[np.int64], unary: NDArray[np.float64] | None) -> AffinityTensor:
    """The tensor with source points in the caller's order again, and the prior."""
    n_target = tensor.shape[1]
    source, target = np.divmod(tensor.indices, np.int32(n_target))
    indices = (order.astype(np.int32)[source] * np.int32(n_target) + target).astype(np.int32)
    return AffinityTensor.unchecked(indices, tensor.weights, tensor.shape, unary)
