"""The completion sampler: all hyper-edges that agree, from minimal sets and the detections that they predict."""

from __future__ import annotations

import math
from itertools import combinations
from threading import Event
from typing import Any

import numba
import numpy as np

from rootmatch.arrays import Integers
from rootmatch.deadline import Pace, checkpoint
from rootmatch.errors import InputError
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.rows import first_rows
from rootmatch.jit.threads import LONGEST, run_in_threads
from rootmatch.problems.capabilities import Capability
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.completion_kernels import Completions, can_complete
from rootmatch.samplers.exhaustive import tensor_of_hyperedges
from rootmatch.samplers.guided.minimal_sets import width

SEARCHED = 0.6
"""Share of a deadline after which the hyper-edges found so far are evaluated."""
AT_ONCE = 64
"""Minimal sets between two progress reports; changes no result."""
MAX_LISTED = 5_000_000
"""Sets of source points that are listed with their minimal sets, which takes two gigabytes."""
BASES = 2
"""How many of the d minimal sets of a hyper-edge predict. One is not enough near double roots; motions in
benchmarks/matches.py, benchmarks/accuracy.py."""
GATE = 4.0
"""Distance from a prediction, in standard deviations, within which a detection completes a hyper-edge; the residual
decides then. Wider than that of the residual, 3.5, for what linearisation loses."""
COST = 10.0
"""Cost of a predicted point, in hyper-edges of an exhaustive sweep: 52 ns for a prediction (benchmarks/matches.py,
docs/notebook/performance.md) against 4 ns for a hyper-edge of up2p (benchmarks/kernels.py)."""
MAX_PREDICTED = 100_000_000
"""Predicted points up to which completion pays: some seconds of two cores."""
SECONDS_PER_SET = 4e-6
"""That this takes."""
SECONDS_PER_LOOKUP = 5e-9
"""That a detection takes for each point that an image of a minimal set predicts, at all of its roots."""


def completion_count(shape: tuple[int, int], order: int) -> int:
    """Maximum number of points that are predicted for one root of each minimal set."""
    return math.comb(shape[0], order) * min(BASES, order) * math.perm(shape[1], order - 1)


class Completion:
    """Sampler of all hyper-edges that agree: each of order d is found from d − 1 of its correspondences.

    An exhaustive sweep tries n' − d + 1 candidates for the last image. Here the minimal set of the others predicts it,
    and the detections near the prediction are looked up, which costs about as much as ten candidates. A hyper-edge is
    missed only where its minimal set is so badly conditioned that the linearised prediction is wrong; therefore each is
    predicted from more than one minimal set, the widest.
    """

    def pays(self, task: SamplingTask) -> bool:
        """Whether completion is possible, affordable, and cheaper than an exhaustive sweep."""
        count = completion_count(task.shape, task.order)
        return (
            can_complete(task.tables)
            and count <= MAX_PREDICTED
            and COST * count <= enumeration.exhaustive_count(*task.shape, task.order)
        )

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """Tensor of all hyper-edges that agree; nothing here is random.

        Raises
        ------
        InputError
            If the problem's minimal sets predict no points.
        """
        tables, shape, order = task.tables, task.shape, task.order
        Capability.COMPLETION.require(can_complete(tables), task.problem)
        listed = math.comb(shape[0], order)
        if listed > MAX_LISTED:
            raise InputError(
                f"completion: {listed:.3g} sets of {order} source points are more than the {MAX_LISTED:,} that are "
                'listed; use sampler="guided"'
            )
        checkpoint(SECONDS_PER_SET * listed)
        arrangements = enumeration.target_arrangements(shape[1], order - 1)
        checkpoint()
        images = arrangements.astype(np.int64)
        tasks = self._tasks_of_sets(tables, shape[0], order)
        results: list[tuple[Integers, int]] = [(np.empty((0, 2 * order), np.int64), 0)] * len(tasks)

        # so many images of a minimal set between two looks at the time and for signals
        maximum = max(int(LONGEST / (SECONDS_PER_LOOKUP * shape[1] * shape[0])), 1)
        slices = [images[first : first + maximum] for first in range(0, len(images), maximum)]
        deadline, stopped = task.deadline.part(SEARCHED), Event()

        def work(first: int, last: int) -> None:
            completions = Completions(tables, images, GATE**2, task.allowed)
            for number in range(first, last):
                base, others = tasks[number]
                parts = []
                for completions.images in slices:
                    parts.append(completions.of(base, others))
                    if stopped.is_set() or deadline.passed():
                        break
                found = np.concatenate([rows for rows, _ in parts])
                source = np.concatenate([np.tile(base, (len(found), 1)), found[:, :1]], axis=1)
                results[number] = np.concatenate([source, found[:, 1:]], axis=1), sum(count for _, count in parts)

        threads = int(numba.get_num_threads())
        pace, done = Pace(deadline), 0
        while done < len(tasks) and (few := pace.block(min(AT_ONCE * threads, len(tasks) - done))):
            run_in_threads(
                lambda first, last, done=done: work(done + first, done + last),  # type: ignore[misc]
                few, threads, 4, stopped=stopped,
            )  # fmt: skip
            done += few
            if task.progress is not None:
                task.progress(done, len(tasks))
        evaluated = sum(number for _, number in results)
        found = _unique_hyperedges(np.concatenate([rows for rows, _ in results]), shape)
        source, target = np.ascontiguousarray(found[:, :order]), np.ascontiguousarray(found[:, order:])
        tensor = tensor_of_hyperedges(task, source, target)
        every = enumeration.estimated_count(*shape, order, task.candidates)
        chance = max(1.0, float(tensor.weights.sum())) / max(every, 1.0)
        return SampledTensor(tensor, evaluated + len(found), 1.0, chance)

    def _tasks_of_sets(self, tables: Any, n: int, order: int) -> list[tuple[Integers, Integers]]:
        """Minimal sets of source points, each with the other points for which it is among the widest."""
        subsets = enumeration.subsets(n, order)
        bases = np.array(list(combinations(range(order), order - 1)), np.int64)
        last = np.array([np.setdiff1d(np.arange(order), base)[0] for base in bases])
        positions = np.ascontiguousarray(tables.points.T)
        wide = np.stack([width(positions, subsets[:, base]) for base in bases], axis=1)
        ranked = np.argsort(-wide, axis=1, kind="stable")[:, :BASES]
        rows = np.arange(len(subsets))
        base = np.concatenate([subsets[rows[:, None], bases[choice]] for choice in ranked.T])
        other = np.concatenate([subsets[rows, last[choice]] for choice in ranked.T])
        sets, which = np.unique(base, axis=0, return_inverse=True)
        order_of = np.argsort(which.reshape(-1), kind="stable")
        cuts = np.searchsorted(which.reshape(-1)[order_of], np.arange(len(sets) + 1))
        return [(one, other[order_of[cuts[number] : cuts[number + 1]]]) for number, one in enumerate(sets)]


def _unique_hyperedges(found: Integers, shape: tuple[int, int]) -> Integers:
    """Each hyper-edge (source, target: 2 d columns) once."""
    order = found.shape[1] // 2
    flat = (found[:, :order] * shape[1] + found[:, order:]).astype(np.int32)
    return found[np.sort(first_rows(np.sort(flat, axis=1), math.prod(shape)))]
