"""The exhaustive sampler: all hyper-edges, evaluated block by block into a tensor, the strongest kept."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.backends import cpu
from rootmatch.backends.strongest import Backend, Enumeration, Progress
from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph.affinity import Affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems import residual_kinds
from rootmatch.samplers.base import SamplingTask


def exhaustive_residuals(
    tables: Any,
    kind: residual_kinds.Kind,
    gate: float,
    shape: tuple[int, int],
    order: int,
    *,
    max_hyperedges: int = 5_000_000,
    candidates: Bools | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
    deadline: Deadline = NEVER,
) -> tuple[NDArray[np.int32], Floats, int]:
    """All hyper-edges whose residual is below the gate, at most ``max_hyperedges`` of them, the strongest.

    Parameters
    ----------
    tables
        Of `Problem.prepare`; the source points in an order that begins with points far apart is best.
    kind : Kind
    gate : float
        Residual above which a hyper-edge is dropped.
    shape : (n, n')
    order : int
    max_hyperedges : int
        Bounds the memory: 24 bytes each at order 4, briefly 40.
    candidates : (n, n') bool array, optional
        Possible correspondences; others are never evaluated.
    backend : Backend
        Evaluates the hyper-edges.
    progress : callable, optional
        Called with (slabs done, slabs in all).
    deadline : Deadline
        When to return what was found until then.

    Returns
    -------
    indices : (E, d) int32 array
        Flat correspondences, increasing in the source points.
    residuals : (E,) array
    evaluated : int
        Number of hyper-edges evaluated.
    """
    work = Enumeration.of(tables, kind, shape, order, candidates)
    found = backend.strongest(work, 0, work.ranks, gate, max_hyperedges, progress=progress, deadline=deadline)
    return cpu.decode(work, found.codes), found.residuals, found.evaluated


def exhaustive_tensor(
    tables: Any, kind: residual_kinds.Kind, affinity: Affinity, shape: tuple[int, int], order: int, **options: Any
) -> tuple[AffinityTensor, int]:
    """Tensor of `exhaustive_residuals`, which takes the ``options``, and the number of hyper-edges evaluated."""
    indices, residuals, evaluated = exhaustive_residuals(tables, kind, affinity.gate, shape, order, **options)
    return AffinityTensor.unchecked(indices, affinity.weights(residuals), shape), evaluated


def tensor_of_hyperedges(task: SamplingTask, source: Integers, target: Integers) -> AffinityTensor:
    """Tensor of those of the given hyper-edges (E, d), (E, d) whose residual is below the gate, in their order."""
    residuals = cpu.residuals(task.tables, task.kind, source, target)
    keep = residuals <= task.affinity.gate
    indices = (source[keep] * task.shape[1] + target[keep]).astype(np.int32)
    return AffinityTensor.unchecked(indices, task.affinity.weights(residuals[keep]), task.shape)
