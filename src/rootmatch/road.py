"""From points to a tensor: the choice of hyper-edges, and their residuals as weights."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch import hyperedges as edges
from rootmatch.affinity import Affinity, Progress
from rootmatch.backends import choice, cpu
from rootmatch.backends.cluster import Cluster
from rootmatch.building import Way, build
from rootmatch.guided import Choice, Weighed
from rootmatch.kernels import kinds
from rootmatch.problems.problem import Problem
from rootmatch.tensor import AffinityTensor


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
    backend: choice.Name = "auto"
    scheduler: str | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Source and target points."""
        return len(self.points), len(self.pixels)

    def tensor(self, way: Way | Choice, samples: int | None) -> Weighed:
        """Hyper-edges chosen in some way, weighed; ``samples`` is how many random ones."""
        order = edges.wide_first(self.points)
        facing = None if self.normals is None else self.normals[order]
        prepare = partial(self.problem.prepare, self.points[order], self.pixels, self.noise, facing)
        tables = prepare()
        weighed, evaluator = build(
            tables, self.weigh.residual.kernel_kind(self.problem.pair_count), self.weigh, self.shape,
            self.problem.order, way=way, samples=samples, seed=self.seed, motions=self.motions,
            candidates=None if self.allowed is None else self.allowed[order], backend=self.backend,
            cluster=None if self.scheduler is None else Cluster(self.scheduler, prepare),
            max_hyperedges=self.max_hyperedges, limit=self.limit, progress=self.progress,
        )  # fmt: skip
        tensor = weighed.tensor
        if self.problem.small_baseline > 0.0:
            tensor = self._near(tensor, tables)
        return weighed._replace(tensor=choice.placed(_restored(tensor, order, self.unary), evaluator))

    def _near(self, tensor: AffinityTensor, tables: Any) -> AffinityTensor:
        """The tensor with the prior of views from nearly one place."""
        source, target = np.divmod(tensor.indices.astype(np.int64), self.shape[1])
        raw = cpu.residuals(tables, kinds.QR(), source, target)
        weights = tensor.weights * np.exp(-raw / self.problem.small_baseline)
        keep = weights >= math.exp(-0.5 * self.weigh.gate**2)
        return AffinityTensor.unchecked(tensor.indices[keep], weights[keep], tensor.shape)


def _restored(tensor: AffinityTensor, order: NDArray[np.int64], unary: NDArray[np.float64] | None) -> AffinityTensor:
    """The tensor with source points in the caller's order again, and the prior."""
    n_target = tensor.shape[1]
    source, target = np.divmod(tensor.indices, np.int32(n_target))
    indices = (order.astype(np.int32)[source] * np.int32(n_target) + target).astype(np.int32)
    return AffinityTensor.unchecked(indices, tensor.weights, tensor.shape, unary)
