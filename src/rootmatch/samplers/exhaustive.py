"""All hyper-edges of a problem, evaluated block by block into a tensor, the strongest kept."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends import cpu
from rootmatch.backends.strongest import Backend, Enumeration
from rootmatch.backends.strongest import Progress as Progress
from rootmatch.hypergraph.affinity import Affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems import residual_kinds


def exhaustive_residuals(
    tables: Any,
    kind: residual_kinds.Kind,
    gate: float,
    shape: tuple[int, int],
    order: int,
    *,
    max_hyperedges: int = 5_000_000,
    candidates: NDArray[np.bool_] | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float64], int]:
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
        Bounds the memory: 24 bytes each at order 4, 40 for a moment.
    candidates : (n, n') bool array, optional
        Correspondences that are possible; others are never evaluated.
    backend : Backend
        What evaluates.
    progress : callable, optional
        Called with (slabs done, slabs in all).

    Returns
    -------
    indices : (E, d) int32 array
        Flat correspondences, increasing in the source points.
    residuals : (E,) array
    evaluated : int
        How many hyper-edges were looked at.
    """
    work = Enumeration.of(tables, kind, shape, order, candidates)
    found = backend.strongest(work, 0, work.ranks, gate, max_hyperedges, progress)
    indices = cpu.decode(found.codes, work.bases, work.arrangements, shape[1], shape[0])
    return indices, found.residuals, found.evaluated


def exhaustive_tensor(
    tables: Any,
    kind: residual_kinds.Kind,
    weigh: Affinity,
    shape: tuple[int, int],
    order: int,
    *,
    max_hyperedges: int = 5_000_000,
    candidates: NDArray[np.bool_] | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
) -> tuple[AffinityTensor, int]:
    """Tensor of `exhaustive_residuals`, and how many hyper-edges were looked at."""
    indices, residuals, evaluated = exhaustive_residuals(
        tables, kind, weigh.gate, shape, order,
        max_hyperedges=max_hyperedges, candidates=candidates, backend=backend, progress=progress,
    )  # fmt: skip
    return AffinityTensor.unchecked(indices, weigh.weights(residuals), shape), evaluated


def given_tensor(
    tables: Any,
    kind: residual_kinds.Kind,
    weigh: Affinity,
    shape: tuple[int, int],
    source: NDArray[np.int64],
    target: NDArray[np.int64],
) -> AffinityTensor:
    """Tensor of those of the given hyper-edges (E, d), (E, d) whose residual is below the gate, in their order."""
    residuals = cpu.residuals(tables, kind, source, target)
    keep = residuals <= weigh.gate
    indices = (source[keep] * shape[1] + target[keep]).astype(np.int32)
    return AffinityTensor.unchecked(indices, weigh.weights(residuals[keep]), shape)
