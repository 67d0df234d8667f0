"""Match frame after frame against one set of source points, as a tracker does."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.backends import cpu
from rootmatch.errors import InputError
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.threads import at_most
from rootmatch.match import Match, match
from rootmatch.problems.base import Problem
from rootmatch.problems.checks import check_points
from rootmatch.problems.padding import padded
from rootmatch.samplers.base import SampledTensor, SamplingTask

SMALL = 100_000
"""Hyper-edges up to which one thread looks at all of them in a millisecond."""
FIRST_CAPACITY = 1_024
"""Hyper-edges below the gate that there is room for at first."""


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
        (n, n_target), order, kind, weigh = task.shape, task.order, task.kind, task.affinity
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
                    tables, kind, bases, 0, total, arrangements, weigh.gate, allowed, self.capacity, n_target, n, 1
                )
                if counts[0] <= self.capacity:
                    break
                self.capacity = 2 * int(counts[0])
        indices = cpu.decode(codes[0, : counts[0]], bases, arrangements, n_target, n)
        weights = weigh.weights(residuals[0, : counts[0]])
        return SampledTensor(AffinityTensor.unchecked(indices, weights, task.shape), int(looked[0]))


class Matcher:
    """`rootmatch.match` for many images of the same source points.

    The source is checked once, the enumerations of a small problem are kept from frame to frame, and nothing waits for
    other threads where one is enough: five markers against eight detections take little more than a millisecond.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space in any frame and unit, or pixels of the first image.
    problem : Problem
    noise : float or (n',) array
        Standard deviation of a pixel coordinate, in pixels, where `match` is not told otherwise.
    **options
        Of `rootmatch.match`: normals, seed, residual, solver, hyperedges, motions, and so on.

    Raises
    ------
    InputError
        If the source cannot be used.
    """

    def __init__(self, source: ArrayLike, problem: Problem, *, noise: ArrayLike = 1.0, **options: Any) -> None:
        for name in ("target", "candidates"):
            if name in options:
                raise InputError(f"Matcher: {name} belongs to a frame; give it to match()")
        self.source = check_points(source, problem.source_dimension, "source", problem.order).copy()
        self.problem = problem
        self.noise = noise
        self.options = options
        self._sweep = SmallSweep()

    def match(self, target: ArrayLike, *, noise: ArrayLike | None = None, candidates: ArrayLike | None = None) -> Match:
        """The match of one frame.

        Parameters
        ----------
        target : (n', 2) array
            Pixels, in any order, clutter among them; n' may change from frame to frame.
        noise : float or (n',) array, optional
            Of this frame.
        candidates : (n, n') array, optional
            Possible correspondences or prior weights, say from the frame before.

        Raises
        ------
        InputError
            As `rootmatch.match`.
        """
        options = self.options
        if self._is_small(np.shape(target)) and not {"hyperedges", "preset", "samples"} & options.keys():
            options = {**options, "hyperedges": self._sweep}
        sigma = self.noise if noise is None else noise
        return match(self.source, target, self.problem, noise=sigma, candidates=candidates, **options)

    def _is_small(self, shape: tuple[int, ...]) -> bool:
        return len(shape) == 2 and enumeration.exhaustive_count(len(self.source), shape[0], self.problem.order) <= SMALL
