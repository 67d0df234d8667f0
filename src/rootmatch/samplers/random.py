"""The random sampler: a seeded stream of hyper-edges into a tensor, as the paper draws them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats
from rootmatch.backends import cpu
from rootmatch.backends.strongest import Backend, Block, Progress
from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.affinity import NOISE_KINDS, Affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems import residual_kinds

BLOCK, SMALL_BLOCK = 65_536, 8_192
"""Hyper-edges drawn at once, and where there is a deadline: a few milliseconds. The stream does not depend on it."""

SECONDS_TO_MERGE = 5e-7
"""That a hyper-edge which was kept takes at the end, to be sorted among the others."""


def random_tensor(
    tables: Any,
    kind: residual_kinds.Kind,
    affinity: Affinity,
    shape: tuple[int, int],
    order: int,
    samples: int,
    seed: int,
    *,
    candidates: Bools | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
    deadline: Deadline = NEVER,
) -> tuple[AffinityTensor, int]:
    """Tensor H_s of the first ``samples`` hyper-edges of the random stream (paper, section "Overall Algorithm").

    A residual of the paper is that of the sample as it was drawn: the order of its points says which minimal sets are
    compared. H is symmetric, so a hyper-edge that is drawn again, in whatever order, is the same entry; the least of
    its residuals counts. One in units of the noise is worked out with the source points in increasing order, as
    `exhaustive_residuals` does.
    """
    n, n_target = shape
    increasing = affinity.residual.kind in NOISE_KINDS
    block = SMALL_BLOCK if deadline.is_set else BLOCK
    stream = enumeration.random_hyperedges(n, n_target, order, samples, seed, block=block, mask=candidates)

    def blocks() -> Iterator[Block]:
        for source, target in stream:
            if increasing:
                source, target = np.divmod(np.sort((source * n_target + target).astype(np.int32), axis=1), n_target)
            yield source, target

    parts: list[tuple[NDArray[np.int32], Floats]] = []
    done = kept = 0
    for (source, target), residuals in backend.evaluated(tables, kind, blocks()):
        keep = residuals <= affinity.gate
        parts.append(((source[keep] * n_target + target[keep]).astype(np.int32), residuals[keep]))
        done += len(source)
        kept += len(parts[-1][1])
        if progress is not None:
            progress(done, samples)
        if done < samples and deadline.left() <= SECONDS_TO_MERGE * kept:
            deadline.record_cut(left_out=True)
            break
    indices = np.ascontiguousarray(np.concatenate([part[0] for part in parts]))
    weights = affinity.weights(np.concatenate([part[1] for part in parts]))
    return AffinityTensor.unchecked(indices, weights, shape).merged(), done
