"""From points to a tensor: the choice of hyper-edges, and their residuals as weights."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch import arguments
from rootmatch import hyperedges as edges
from rootmatch.affinity import Affinity, Progress, exhaustive_tensor, random_tensor
from rootmatch.backends import cpu
from rootmatch.guided import Choice, Guided, Weighed, pays
from rootmatch.kernels import kinds
from rootmatch.problems.problem import Problem
from rootmatch.tensor import AffinityTensor

Ways = Literal["auto", "exhaustive", "random", "guided"]


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
    limit: int = 4_000_000_000
    seed: int = 0
    progress: Progress | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Source and target points."""
        return len(self.points), len(self.pixels)

    def tensor(self, way: Ways | Choice, samples: int) -> Weighed:
        """Hyper-edges chosen in some way, weighed; ``samples`` is how many random ones."""
        shape, order_of = self.shape, self.problem.order
        order = edges.wide_first(self.points)
        facing = None if self.normals is None else self.normals[order]
        tables = self.problem.prepare(self.points[order], self.pixels, self.noise, facing)
        mask = None if self.allowed is None else self.allowed[order]
        kind = self.weigh.residual.kernel_kind(self.problem.pair_count)
        if way == "auto" and pays(tables, shape, order_of, self.motions, mask):
            way = "guided"
        if way == "guided":
            way = Guided()
        share, chance = 1.0, None
        if callable(way):
            tensor, evaluated, share, chance = way(
                tables, kind, self.weigh, shape, order_of,
                seed=self.seed, motions=self.motions, candidates=mask, progress=self.progress,
            )  # fmt: skip
        elif way == "random":
            tensor, evaluated = random_tensor(
                tables, kind, self.weigh, shape, order_of, samples, self.seed, candidates=mask, progress=self.progress
            )
            # a random sample sees each hyper-edge with this probability
            share = -math.expm1(-evaluated / edges.exhaustive_count(*shape, order_of))
        else:
            arguments.check_size(*shape, order_of, self.limit, mask)
            tensor, evaluated = exhaustive_tensor(
                tables, kind, self.weigh, shape, order_of,
                max_hyperedges=self.max_hyperedges, candidates=mask, progress=self.progress,
            )  # fmt: skip
        if self.problem.small_baseline > 0.0:
            tensor = self._near(tensor, tables)
        return Weighed(_restored(tensor, order, self.unary), evaluated, share, chance)

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
