"""The random sampler: a seeded stream of hyper-edges into a tensor, as the paper draws them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends import cpu
from rootmatch.backends.strongest import Backend, Block, Progress
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.affinity import Affinity
from rootmatch.hypergraph.rows import sorted_rows
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems import residual_kinds


def random_tensor(
    tables: Any,
    kind: residual_kinds.Kind,
    affinity: Affinity,
    shape: tuple[int, int],
    order: int,
    samples: int,
    seed: int,
    *,
    candidates: NDArray[np.bool_] | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
) -> tuple[AffinityTensor, int]:
    """Tensor H_s of the first ``samples`` hyper-edges of the random stream (paper, section "Overall Algorithm").

    A hyper-edge has one residual, that with its source points in increasing order, as in `exhaustive_residuals`: H is
    symmetric, so the order in which the points were drawn plays no part, and a hyper-edge drawn twice is one entry. The
    tensors of growing samples tend to that of all hyper-edges.
    """
    n, n_target = shape
    stream = enumeration.random_hyperedges(n, n_target, order, samples, seed, mask=candidates)

    def blocks() -> Iterator[Block]:
        for source, target in stream:
            yield np.divmod(sorted_rows((source * n_target + target).astype(np.int32)), n_target)

    parts: list[tuple[NDArray[np.int32], NDArray[np.float64]]] = []
    done = 0
    for (source, target), residuals in backend.evaluated(tables, kind, blocks()):
        keep = residuals <= affinity.gate
        parts.append(((source[keep] * n_target + target[keep]).astype(np.int32), residuals[keep]))
        done += len(source)
        if progress is not None:
            progress(done, samples)
    indices = np.ascontiguousarray(np.concatenate([part[0] for part in parts]))
    weights = affinity.weights(np.concatenate([part[1] for part in parts]))
    return AffinityTensor.unchecked(indices, weights, shape).merged(), done
