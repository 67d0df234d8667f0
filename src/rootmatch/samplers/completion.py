"""All hyper-edges that agree, found by completing minimal sets: far fewer evaluations than there are hyper-edges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.rows import first_rows, sorted_rows
from rootmatch.jit.threads import in_threads
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.completion_kernels import Completions, can_complete
from rootmatch.samplers.exhaustive import given_tensor
from rootmatch.samplers.guided.minimal_sets import width

Integers = NDArray[np.int64]

DEARER = 10
"""What a predicted point costs, in hyper-edges of a sweep over all of them."""
AFFORDABLE = 100_000_000
"""Predicted points, some seconds of two cores."""
AT_ONCE = 64
"""Minimal sets between two looks at the progress."""


def completion_count(shape: tuple[int, int], order: int, bases: int) -> int:
    """Most points that are predicted for one root of each minimal set."""
    return math.comb(shape[0], order) * min(bases, order) * math.perm(shape[1], order - 1)


@dataclass(frozen=True)
class Completion:
    """Hyper-edges of order d, each found from d − 1 of its correspondences, whose solution predicts the last.

    A sweep over all hyper-edges has n' − d + 1 candidates for the last image; here the one that is predicted is looked
    for among the detections, which costs about as much as ten of them. Nothing that agrees is left out but where a
    minimal set is so badly conditioned that its linearised prediction is wrong; therefore each hyper-edge is looked for
    from more than one of them, the widest.

    Parameters
    ----------
    gate : float
        Deviations from its prediction within which a detection completes a hyper-edge; the residual decides then.
    bases : int
        Of the d minimal sets of a hyper-edge's source points, how many predict.
    """

    gate: float = 4.0
    bases: int = 2

    def __post_init__(self) -> None:
        if not self.gate > 0.0 or self.bases < 1:
            raise InputError(f"Completion: gate {self.gate!r} and bases {self.bases!r} given; give positive numbers")

    def pays(self, task: SamplingTask) -> bool:
        """Whether it is possible, affordable, and cheaper than to look at all hyper-edges."""
        count = completion_count(task.shape, task.order, self.bases)
        return (
            can_complete(type(task.tables))
            and count <= AFFORDABLE
            and DEARER * count <= enumeration.exhaustive_count(*task.shape, task.order)
        )

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """Tensor of the hyper-edges that agree, all of them; nothing here is random.

        Raises
        ------
        InputError
            If the problem has no predictions.
        """
        tables, shape, order = task.tables, task.shape, task.order
        if not can_complete(type(tables)):
            raise InputError('hyperedges: this problem predicts no points; use "exhaustive" or "random"')
        images = enumeration.target_arrangements(shape[1], order - 1).astype(np.int64)
        tasks = self._tasks(tables, shape[0], order)
        results: list[tuple[Integers, int]] = [(np.empty((0, 2 * order), np.int64), 0)] * len(tasks)

        def work(first: int, last: int) -> None:
            completions = Completions(tables, images, self.gate**2, task.allowed)
            for number in range(first, last):
                base, others = tasks[number]
                found, evaluated = completions.of(base, others)
                source = np.concatenate([np.tile(base, (len(found), 1)), found[:, :1]], axis=1)
                results[number] = np.concatenate([source, found[:, 1:]], axis=1), evaluated

        threads = int(numba.get_num_threads())
        for done in range(0, len(tasks), AT_ONCE * threads):
            few = min(AT_ONCE * threads, len(tasks) - done)
            in_threads(lambda first, last, done=done: work(done + first, done + last), few, threads, 4)  # type: ignore[misc]
            if task.progress is not None:
                task.progress(done + few, len(tasks))
        evaluated = sum(number for _, number in results)
        found = _distinct(np.concatenate([rows for rows, _ in results]), shape)
        source, target = np.ascontiguousarray(found[:, :order]), np.ascontiguousarray(found[:, order:])
        tensor = given_tensor(tables, task.kind, task.affinity, shape, source, target)
        chance = max(1.0, float(tensor.weights.sum())) / max(task.hyperedge_count, 1.0)
        return SampledTensor(tensor, evaluated + len(found), 1.0, chance)

    def _tasks(self, tables: Any, n: int, order: int) -> list[tuple[Integers, Integers]]:
        """Minimal sets of source points, each with the others that it is one of the widest to predict."""
        subsets = np.array(list(combinations(range(n), order)), np.int64).reshape(-1, order)
        bases = np.array(list(combinations(range(order), order - 1)), np.int64)
        last = np.array([np.setdiff1d(np.arange(order), base)[0] for base in bases])
        places = np.ascontiguousarray(tables.points.T)
        wide = np.stack([width(places, subsets[:, base]) for base in bases], axis=1)
        ranked = np.argsort(-wide, axis=1, kind="stable")[:, : self.bases]
        rows = np.arange(len(subsets))
        base = np.concatenate([subsets[rows[:, None], bases[choice]] for choice in ranked.T])
        other = np.concatenate([subsets[rows, last[choice]] for choice in ranked.T])
        sets, which = np.unique(base, axis=0, return_inverse=True)
        order_of = np.argsort(which.reshape(-1), kind="stable")
        cuts = np.searchsorted(which.reshape(-1)[order_of], np.arange(len(sets) + 1))
        return [(one, other[order_of[cuts[number] : cuts[number + 1]]]) for number, one in enumerate(sets)]


def _distinct(found: Integers, shape: tuple[int, int]) -> Integers:
    """Each hyper-edge (source, target: 2 d columns) once."""
    order = found.shape[1] // 2
    flat = (found[:, :order] * shape[1] + found[:, order:]).astype(np.int32)
    return found[np.sort(first_rows(sorted_rows(flat), math.prod(shape)))]
