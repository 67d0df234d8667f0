"""All hyper-edges of a small problem, frame after frame, with what is the same for every frame kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends import cpu
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.threads import at_most
from rootmatch.problems.padding import padded
from rootmatch.samplers.base import SampledTensor, SamplingTask

SMALL = 100_000
"""Hyper-edges up to which one thread evaluates all of them in a millisecond (`benchmarks/matches.py --only small`)."""
FIRST_CAPACITY = 1_024
"""Hyper-edges below the gate that are allocated for at first."""


class SmallSweep:
    """All hyper-edges of a small problem, on the calling thread, with enumerations that are made once.

    What it finds is what `rootmatch.samplers.exhaustive.exhaustive_tensor` finds, in the same order.
    """

    def __init__(self) -> None:
        self.bases: dict[tuple[int, int], NDArray[np.int64]] = {}
        self.arrangements: dict[tuple[int, int], NDArray[np.int32]] = {}
        self.capacity = FIRST_CAPACITY

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """Tensor of all hyper-edges below the gate."""
        (n, n_target), order, kind, affinity = task.shape, task.order, task.kind, task.affinity
        tables, allowed = padded(task.tables, n_target), task.allowed
        if (n, order) not in self.bases:
            self.bases[n, order] = enumeration.source_bases(n, order)
        if (n_target, order) not in self.arrangements:
            self.arrangements[n_target, order] = enumeration.target_arrangements(n_target, order - 1)
        bases, arrangements = self.bases[n, order], self.arrangements[n_target, order]
        total = len(bases) * len(arrangements)
        with at_most(1):
            while True:
                codes, residuals, counts, looked = cpu.sweep(
                    tables=tables,
                    kind=kind,
                    bases=bases,
                    first_rank=0,
                    last_rank=total,
                    arrangements=arrangements,
                    gate=affinity.gate,
                    allowed=allowed,
                    capacity=self.capacity,
                    targets=n_target,
                    points=n,
                    chunks=1,
                )
                if counts[0] <= self.capacity:
                    break
                self.capacity = 2 * int(counts[0])
        indices = cpu.decode(codes[0, : counts[0]], bases, arrangements, n_target, n)
        weights = affinity.weights(residuals[0, : counts[0]])
        return SampledTensor(AffinityTensor.unchecked(indices, weights, task.shape), int(looked[0]))
