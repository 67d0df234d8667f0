"""Findings of several bodies: from some detections to all of them, and from single bodies to the whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.explain.decide import Facts
from rootmatch.explain.finding import Finding, empty_tensor, make_empty_finding
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.hypergraph.deferred_tensor import DeferredTensor, concatenate_tensors, renumber_tensor
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.modes import object_array


def join_findings(task: MatchingTask, found: Sequence[Finding], evaluated: int) -> Finding:
    """The finding of all bodies by that of each, in order: the sum of their scores, the lead of the least sure one."""
    assert task.bodies is not None
    assignment, labels = np.full(task.rows, -1, np.int64), np.full(task.rows, -1, np.int64)
    bodies = [(task.sighting_rows(task.bodies.points_of(k)), one) for k, one in enumerate(found)]
    for k, (rows, one) in enumerate(bodies):
        assignment[rows] = one.assignment
        labels[rows] = np.where(one.assignment >= 0, k, -1)
    return Finding(
        task=task,
        assignment=assignment,
        others=[],
        facts=Facts(),
        tensor=DeferredTensor.of(lambda: join_hyperedges(task, bodies), task.row_shape, task.row_weights),
        labels=labels,
        converged=all(one.converged for one in found),
        evaluated=evaluated,
        parts=dict(zip(task.bodies.names, found, strict=True)),
    )


def find_no_body(task: MatchingTask, reason: str) -> Finding:
    """The finding of a task that leaves nothing to match, and that of each of its bodies."""
    nothing = make_empty_finding(task, reason)
    if task.bodies is None:
        return nothing
    each = zip(task.bodies.names, task.each_body, strict=True)
    parts = {label: make_empty_finding(part, reason) for label, part in each}
    return copy_with(nothing, parts=parts)


def join_hyperedges(task: MatchingTask, bodies: list[tuple[Integers, Finding]]) -> AffinityTensor:
    """The hyper-edges of all bodies, or of several motions, by the rows and the finding of each.

    A body that was found by pairs under a vertical that is known has hyper-edges of another order: as one that was
    found without any, by a prediction, it has no part in them.
    """
    shape, targets = task.row_shape, np.arange(task.shape[1])
    every = [(rows, found.tensor) for rows, found in bodies]
    some = [(rows, tensor) for rows, tensor in every if tensor.size and tensor.order == task.problem.order]
    parts = [empty_tensor(task), *(renumber_tensor(tensor, (rows, targets), shape) for rows, tensor in some)]
    return concatenate_tensors(parts, shape, task.row_weights, task.options.max_hyperedges)


def restore_columns(found: Finding, task: MatchingTask, columns: Integers) -> Finding:
    """A finding among some detections as one among all of them."""
    n, n_target = task.row_shape
    soft = None
    if found.soft is not None:
        soft = np.zeros((n, n_target))
        soft[:, columns] = found.soft

    def of_all(assignment: Integers) -> Integers:
        return np.where(assignment >= 0, columns[assignment], -1)

    told = found.posterior
    if told is not None:
        modes = told.modes._replace(
            assignments=of_all(told.modes.assignments),
            near=object_array([(of_all(changed), *rest) for changed, *rest in told.modes.near]),
        )
        told = copy_with(told, modes=modes)
    return copy_with(
        found,
        task=copy_with(task, noise=found.task.noise),
        posterior=told,
        assignment=of_all(found.assignment),
        others=[of_all(other) for other in found.others],
        other_probabilities=found.alternative_probabilities,
        named=[of_all(one) for one in found.named],
        mirrored=[of_all(one) for one in found.mirrored],
        labellings=None,
        soft=soft,
        tensor=DeferredTensor.of(
            lambda: renumber_tensor(found.tensor, (np.arange(n), columns), task.row_shape),
            task.row_shape,
            task.row_weights,
        ),
    )
