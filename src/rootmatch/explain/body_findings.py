"""Findings of several bodies: from some detections to all of them, and from single bodies to the whole."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import Facts
from rootmatch.explain.finding import Finding, empty_tensor
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.modes import as_objects


def joined(task: MatchingTask, bodies: list[tuple[Label, Integers, Finding]], evaluated: int) -> Finding:
    """The finding of all bodies by label, rows and finding: the sum of their scores, the lead of the least sure one."""
    n, n_target = task.row_shape
    assignment, labels = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    indices, weights = [], []
    parts: dict[Label, Finding] = {}
    for k, (label, rows, found) in enumerate(bodies):
        parts[label] = found
        assignment[rows] = found.assignment
        labels[rows] = np.where(found.assignment >= 0, k, -1)
        if found.tensor.size:
            i, j = np.divmod(found.tensor.indices.astype(np.int64), max(n_target, 1))
            indices.append((rows[i] * n_target + j).astype(np.int32))
            weights.append(np.asarray(found.tensor.weights))
    if not indices:
        nothing = empty_tensor(task)
        indices, weights = [nothing.indices], [nothing.weights]
    every = list(parts.values())
    return Finding(
        task=task,
        assignment=assignment,
        others=[],
        facts=Facts(lead=min(found.margin for found in every)),
        tensor=AffinityTensor.unchecked(
            np.concatenate(indices), np.concatenate(weights), task.row_shape, task.row_weights
        ),
        scores=[_total([found.score for found in every])],
        labels=labels,
        converged=all(found.converged for found in every),
        evaluated=evaluated,
        parts=parts,
    )


def _total(scores: list[float]) -> float:
    """The sum of the scores that are known; NaN if none is."""
    known = [score for score in scores if not math.isnan(score)]
    return sum(known) if known else math.nan


def among_all(found: Finding, task: MatchingTask, columns: Integers) -> Finding:
    """A finding among some detections as one among all of them."""
    n, n_target = task.row_shape
    i, j = np.divmod(found.tensor.indices, np.int32(len(columns)))
    indices = (i * np.int32(n_target) + columns.astype(np.int32)[j]).astype(np.int32)
    soft = np.zeros((n, n_target))
    soft[:, columns] = found.soft_assignment

    def of_all(assignment: Integers) -> Integers:
        return np.where(assignment >= 0, columns[assignment], -1)

    told = found.posterior
    if told is not None:
        modes = told.modes._replace(
            assignments=of_all(told.modes.assignments),
            near=as_objects([(of_all(changed), *rest) for changed, *rest in told.modes.near]),
        )
        told = replace(told, modes=modes)
    return replace(
        found,
        task=replace(task, noise=found.task.noise),
        posterior=told,
        assignment=of_all(found.assignment),
        others=[of_all(other) for other in found.others],
        other_probabilities=found.every_other_probability,
        named=[of_all(one) for one in found.named],
        scores=found.every_score,
        soft=soft,
        tensor=AffinityTensor.unchecked(indices, np.asarray(found.tensor.weights), task.row_shape, task.row_weights),
    )
